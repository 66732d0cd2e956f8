"""Frames that tell no noise: processed ones, and the same picture saved twice."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import convolve, zoom

import standoff
from calibration.errors import NoiseError
from tests.calibration.poisson_frames import GAIN_E_PER_DN, TOP_DN, frames_dn

SHAPE = (96, 128)
ELECTRONS = (300.0, 900.0, 1800.0, 3000.0)
Frames = NDArray[np.uint16]


def drawn(electrons: float, seed: int, count: int = 4) -> Frames:
    rng = np.random.default_rng(seed)
    return frames_dn(rng, electrons, shape=SHAPE, frames=count).astype(np.uint16)


DARKS = drawn(0.0, 1)
FLATS = [drawn(electrons, 10 + index) for index, electrons in enumerate(ELECTRONS)]


def smoothed(frames: Frames, kernel: NDArray[np.float64]) -> Frames:
    done = [convolve(frame.astype(float), kernel, mode="reflect") for frame in frames]
    return np.rint(done).astype(np.uint16)


def of_one_channel_in_four(frames: Frames) -> Frames:
    """What bilinear demosaicing makes of every second row and column of a sensor."""
    return np.rint([zoom(frame[::2, ::2].astype(float), 2, order=1) for frame in frames]).astype(
        np.uint16
    )


@pytest.mark.parametrize(
    "processed",
    [
        lambda frames: smoothed(frames, np.outer([1, 2, 1], [1, 2, 1]) / 16),
        of_one_channel_in_four,
    ],
    ids=["smoothed", "demosaiced"],
)
def test_flats_of_demosaiced_or_smoothed_frames_give_no_gain(
    processed: Callable[[Frames], Frames],
) -> None:
    """Grey pictures of a colour camera, or of one that reduces noise: a gain 7 times too large."""
    with pytest.raises(NoiseError, match="neighbouring pixels is correlated"):
        standoff.measure_noise(
            darks=processed(DARKS), flats=[processed(each) for each in FLATS], white_level=TOP_DN
        )


def test_a_little_that_pixels_hand_to_their_neighbours_is_a_note() -> None:
    """A sensor whose pixels couple by 2 % measures, and is told of."""
    coupled = np.array([[0, 0.02, 0], [0.02, 0.92, 0.02], [0, 0.02, 0]])
    noise = standoff.measure_noise(
        darks=DARKS, flats=[smoothed(each, coupled) for each in FLATS], white_level=TOP_DN
    )
    (note,) = [each for each in noise.calibration.notes if "is correlated" in each]
    assert "too large by" in note


def test_noise_that_rows_share_is_no_smoothing() -> None:
    """Rows of many sensors have a noise of their own from frame to frame."""
    rng = np.random.default_rng(5)
    flats = [
        np.clip(each + np.rint(rng.normal(0, 4, (len(each), SHAPE[0], 1))), 0, TOP_DN).astype(
            np.uint16
        )
        for each in FLATS
    ]
    noise = standoff.measure_noise(darks=DARKS, flats=flats, white_level=TOP_DN)
    assert not [each for each in noise.calibration.notes if "is correlated" in each]


def test_sound_frames_are_measured_as_before() -> None:
    noise = standoff.measure_noise(darks=DARKS, flats=FLATS, white_level=TOP_DN)
    assert noise.calibration.gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=0.05)
    assert not [each for each in noise.calibration.notes if "is correlated" in each]


@pytest.mark.parametrize("kind", ["darks", "flats"])
def test_a_frame_that_was_saved_twice_is_named(kind: str) -> None:
    """A grab loop that fetches faster than the camera delivers writes pictures twice."""
    darks, flats = DARKS.copy(), [each.copy() for each in FLATS]
    (darks if kind == "darks" else flats[1])[3] = (darks if kind == "darks" else flats[1])[1]
    with pytest.raises(NoiseError, match="frames 2 and 4 are identical, bit for bit"):
        standoff.measure_noise(darks=darks, flats=flats, white_level=TOP_DN)


def test_frames_that_are_all_the_same_are_called_that() -> None:
    flats = [np.repeat(each[:1], 3, axis=0) for each in FLATS]
    with pytest.raises(NoiseError, match="frames 1 and 2 are identical, bit for bit"):
        standoff.measure_noise(darks=DARKS, flats=flats, white_level=TOP_DN)


def test_saturated_flats_and_darks_without_noise_may_be_equal() -> None:
    flats = [*FLATS, np.full((3, *SHAPE), TOP_DN, dtype=np.uint16)]
    noise = standoff.measure_noise(darks=DARKS, flats=flats, white_level=TOP_DN)
    assert noise.calibration.saturation_is_reached


def with_exif(folder: Path, frames: Frames, exposure_s: float) -> None:
    folder.mkdir(exist_ok=True)
    exif = Image.Exif()
    exif[0x8769] = {0x829A: exposure_s, 0x8827: 100}
    for index, frame in enumerate(frames):
        Image.fromarray(frame).save(folder / f"{exposure_s:.6f}_{index}.png", exif=exif)


@pytest.mark.parametrize(
    ("speeds", "is_noted"),
    [((1 / 125, 1 / 60, 1 / 30, 1 / 15), True), ((0.002, 0.004, 0.008, 0.016), False)],
)
def test_the_names_of_shutter_speeds_are_no_exposures(
    speeds: tuple[float, ...], is_noted: bool, tmp_path: Path
) -> None:
    """A photographic camera writes 1/60 s and exposes 1/64 s: a linear sensor looked bent."""
    for speed, frames in zip(speeds, FLATS, strict=True):
        with_exif(tmp_path / "flats", frames, speed)
    with_exif(tmp_path / "darks", DARKS, speeds[0])
    noise = standoff.measure_noise(
        darks=tmp_path / "darks", flats=tmp_path / "flats", white_level=TOP_DN
    )
    named = [each for each in noise.calibration.notes if "shutter speeds" in each]
    assert bool(named) is is_noted
    if is_noted:
        assert "off by 4.2 %" in named[0]
