"""Noise of frames of one's own: truth is the Poisson and Gaussian law that makes the frames."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

import standoff
from acquisition.averaging import AveragedFrames
from acquisition.photographs import Photograph, photograph_of
from acquisition.session._reader import Session
from acquisition.session._record import Take
from calibration.errors import NoiseError
from calibration.noise import NoiseCalibration, NoiseMeasurement
from standoff.errors import ArgumentError, ImageFileError
from tests.acquisition.fakes import SETTINGS, FakeUtc
from tests.acquisition.session_fixtures import plan_of, writer
from tests.calibration.poisson_frames import (
    BLACK_DN,
    GAIN_E_PER_DN,
    READ_NOISE_E,
    TOP_DN,
    frames_dn,
)
from tests.standoff.conftest import Command

SHAPE = (24, 40)
ELECTRONS_PER_US = 1.5
DARKS_US = (21.0, 4000.0, 8000.0)
FLATS_US = (1000.0, 2000.0, 4000.0, 6000.0, 8000.0)
EXPOSURE_TIME = 0x829A

Frames = NDArray[np.uint16]


def taken(
    exposures: tuple[float, ...], rate: float, *, seed: int = 1, count: int = 6
) -> dict[float, Frames]:
    """Frames by exposure, ``rate`` electrons a microsecond."""
    rng = np.random.default_rng(seed)
    return {
        us: frames_dn(rng, rate * us, shape=SHAPE, frames=count).astype(np.uint16)
        for us in exposures
    }


DARKS, FLATS = taken(DARKS_US, 0.0), taken(FLATS_US, ELECTRONS_PER_US, seed=2)


def written(
    folder: Path, frames: Frames, exposure_us: float | None = None, name: str = "f"
) -> Path:
    """A folder of TIFF files, one for each frame, with their exposure in Exif's tag."""
    folder.mkdir(parents=True, exist_ok=True)
    tags = []
    if exposure_us is not None:
        tags = [(EXPOSURE_TIME, "2I", 1, (round(exposure_us), 10**6), True)]
    for index, frame in enumerate(frames):
        tifffile.imwrite(folder / f"{name}{index}.tif", frame, extratags=tags)
    return folder


def session_of(path: Path, darks: dict[float, Frames], flats: dict[float, Frames]) -> Session:
    """A session whose captures are the means and variances of the frames, by numpy."""
    frames = {"dark": darks, "flat": flats}
    plan = plan_of(
        heights_mm=[100.0],
        targets=[
            {"kind": kind, "target": kind, "exposure_us": list(by_exposure)}
            for kind, by_exposure in frames.items()
        ],
    )
    now = FakeUtc()
    with writer(path, plan=plan) as session:
        for entry in session.entries:
            assert entry.exposure_us is not None
            stack = frames[entry.kind][entry.exposure_us]
            averaged = AveragedFrames(
                mean_dn=stack.mean(axis=0).astype(np.float32),
                variance_dn2=stack.var(axis=0, ddof=1).astype(np.float32),
                frames_used=len(stack),
                incomplete_frames=0,
                resent_packets=0,
                saturated_pixels=int(np.count_nonzero(stack.max(axis=0) >= TOP_DN)),
                min_dn=int(stack.min()),
                max_dn=int(stack.max()),
                first_timestamp_ns=1,
                last_timestamp_ns=2,
            )
            settings = replace(SETTINGS, exposure_us=entry.exposure_us)
            session.add_capture(
                entry,
                Take(
                    averaged=averaged,
                    settings=settings,
                    height_mm=100.0,
                    focus_value=None,
                    started=now(),
                    finished=now(),
                ),
            )
    return Session(path)


def figures(noise: NoiseMeasurement) -> dict[str, Any]:
    """What is measured, without names of captures, times and the camera."""
    known = noise.calibration.model_dump()
    for name in ("captured_utc", "camera_serial", "camera_model", "gain_db", "pixel_format"):
        del known[name]
    for name in ("provenance", "frames_averaged", "notes", "schema_name"):
        del known[name]
    for level in known["levels"]:
        del level["capture"], level["kind"]
    return known


def test_stacks_give_what_a_session_of_the_same_frames_gives(tmp_path: Path) -> None:
    flats = FLATS | taken((16000.0,), ELECTRONS_PER_US, seed=3)  # saturated
    session = standoff.measure_noise(session_of(tmp_path / "s", DARKS, flats))
    own = standoff.measure_noise(darks=DARKS, flats=flats, white_level=TOP_DN)
    expected, found = figures(session), figures(own)
    # numpy's and our exact sums agree to the rounding of float32.
    for one, other in zip(expected.pop("levels"), found.pop("levels"), strict=True):
        assert other == pytest.approx(one, rel=1e-6)
    assert {name for name, value in found.items() if value is None} == {"maps", "light_drift_per_s"}
    numbers = {name: value for name, value in expected.items() if value is not None}
    assert {name: found[name] for name in numbers} == pytest.approx(numbers, rel=1e-4, abs=1e-7)
    assert found["saturation_is_reached"]
    np.testing.assert_allclose(own.maps.response, session.maps.response, rtol=1e-5)
    np.testing.assert_allclose(own.maps.dark_dn, session.maps.dark_dn, rtol=1e-6)


def every_way(folder: Path) -> dict[str, tuple[Any, Any]]:
    """Darks and flats as people have them, all of the same frames with their exposures."""
    for kind, levels in (("darks", DARKS), ("flats", FLATS)):
        for us, frames in levels.items():
            written(folder / kind / f"{us:05.0f}", frames, us)
            written(folder / f"{kind} together", frames, us, f"{us:05.0f}_")
    darks, flats = folder / "darks", folder / "flats"
    return {
        "folders of folders": (darks, str(flats)),
        "folders of all": (folder / "darks together", folder / "flats together"),
        "a pattern": (darks / "*" / "*.tif", str(flats / "*/f?.tif")),
        "a list of folders": (sorted(darks.iterdir()), sorted(flats.iterdir())),
        "lists of files": (sorted(darks.rglob("*.tif")), sorted(flats.rglob("*.tif"))),
        "a mapping of folders": (
            {us: darks / f"{us:05.0f}" for us in DARKS},
            {us: flats / f"{us:05.0f}" for us in FLATS},
        ),
        "stacks": (DARKS, FLATS),
        "lists of frames": (
            {us: list(frames) for us, frames in DARKS.items()},
            {us: tuple(frames) for us, frames in FLATS.items()},
        ),
    }


def test_every_way_to_give_frames_gives_the_same_noise(tmp_path: Path) -> None:
    ways = every_way(tmp_path)
    expected = figures(standoff.measure_noise(darks=DARKS, flats=FLATS, white_level=TOP_DN))
    for way, (darks, flats) in ways.items():
        found = figures(standoff.measure_noise(darks=darks, flats=flats, white_level=TOP_DN))
        assert found == expected, way
    of_four_axes = standoff.measure_noise(
        darks=np.stack(list(DARKS.values())),
        flats=np.stack(list(FLATS.values())),
        dark_exposures_us=list(DARKS),
        flat_exposures_us=list(FLATS),
        white_level=TOP_DN,
    )
    assert figures(of_four_axes) == expected


def test_what_was_measured_is_taken_as_the_noise_of_a_capture(tmp_path: Path) -> None:
    measured = standoff.measure_noise(darks=DARKS, flats=FLATS, white_level=TOP_DN)
    standoff.write_noise(tmp_path / "noise.json", measured)
    scene = FLATS[4000.0][0]
    psf = standoff.GaussianPsf(sigma_x_px=0.7, sigma_y_px=0.7)
    ways = (
        tmp_path / "noise.json",
        measured,
        measured.calibration,
        standoff.read_noise(tmp_path / "noise.json"),
        measured.calibration.capture_noise,
    )
    expected, *others = (
        standoff.simulate(scene, zoom=1.5, psf=psf, model="lmmse", noise=way).image for way in ways
    )
    without = standoff.simulate(scene, zoom=1.5, psf=psf, model="lmmse").image
    assert np.abs(expected - without).max() > 0
    for found in others:
        np.testing.assert_array_equal(found, expected)


def test_the_truth_is_in_95_percent_intervals_of_19_draws_in_20() -> None:
    errors = []
    for seed in range(60):
        found = standoff.measure_noise(
            darks=taken((21.0,), 0.0, seed=1000 + seed, count=4),
            flats=taken(FLATS_US, ELECTRONS_PER_US, seed=2000 + seed, count=4),
            white_level=TOP_DN,
        ).transfer
        errors.append(
            (
                (found.gain_e_per_dn - GAIN_E_PER_DN) / found.gain_e_per_dn_err,
                (found.read_noise_e - READ_NOISE_E) / found.read_noise_e_err,
                (found.dark.black_level_dn - BLACK_DN) / found.dark.black_level_dn_err,
            )
        )
    inside = np.mean(np.abs(errors) < 1.96, axis=0)
    # 57 of 60 are expected; 52 is 3 standard deviations below.
    assert (inside >= 52 / 60).all(), inside
    assert (np.abs(np.mean(errors, axis=0)) < 4 / np.sqrt(60)).all()


def test_levels_in_the_upper_12_of_16_bits_are_rounded_by_16() -> None:
    # Of 3 e, 0.6 steps, a twelfth of a squared step is 11 % of the read noise.
    rng = np.random.default_rng(4)

    def frames(electrons: float) -> Frames:
        light = rng.poisson(electrons, (12, *SHAPE)) + rng.normal(0, 3.0, (12, *SHAPE))
        return (16 * np.round(64 + light / 5)).astype(np.uint16)

    flats = [frames(electrons) for electrons in (1000, 3000, 6000, 9000)]
    found = standoff.measure_noise(darks=[frames(0)], flats=flats)
    assert found.transfer.read_noise_e == pytest.approx(
        3.0, abs=4 * found.transfer.read_noise_e_err
    )
    assert found.transfer.gain_e_per_dn == pytest.approx(5 / 16, rel=0.03)
    assert found.transfer.saturation.level_dn == 65520
    assert any("step by 16 DN" in note for note in found.calibration.notes)


def test_where_a_camera_clips_is_asked_for_when_no_frame_shows_it() -> None:
    found = standoff.measure_noise(darks=DARKS, flats=FLATS)
    assert any("65535" in note and "white level" in note for note in found.calibration.notes)
    stated = standoff.measure_noise(darks=DARKS, flats=FLATS, white_level=TOP_DN)
    assert stated.calibration.saturation_dn == TOP_DN
    assert not any("white level" in note for note in stated.calibration.notes)


def fits_stack(path: Path, frames: Frames, exposure_s: float) -> Path:
    fits = pytest.importorskip("astropy.io.fits")
    unit = fits.PrimaryHDU(frames)
    unit.header["EXPTIME"] = exposure_s
    unit.header["INSTRUME"] = "C1"
    unit.writeto(path)
    return path


def test_fits_stacks_are_levels_at_the_exposure_of_their_headers(tmp_path: Path) -> None:
    darks, flats = (
        [
            fits_stack(tmp_path / f"{kind}{us:g}.fits", frames, us / 1e6)
            for us, frames in levels.items()
        ]
        for kind, levels in (("dark", DARKS), ("flat", FLATS))
    )
    found = standoff.measure_noise(darks=darks, flats=flats, white_level=TOP_DN)
    assert found.calibration.camera_model == "C1"
    expected = standoff.measure_noise(darks=DARKS, flats=FLATS, white_level=TOP_DN)
    assert figures(found) == figures(expected)


def test_of_a_raw_mosaic_a_green_plane_is_measured() -> None:
    colours = np.kron(np.ones((SHAPE[0], SHAPE[1])), np.array([[0.5, 1.0], [1.0, 0.3]]))
    rng = np.random.default_rng(5)

    def mosaics(electrons: float) -> list[Photograph]:
        frames = frames_dn(rng, electrons * colours, shape=colours.shape, frames=4)
        read = [photograph_of(frame.astype(np.uint16), "frame") for frame in frames]
        return [replace(one, pattern="RGGB") for one in read]

    found = standoff.measure_noise(
        darks=[mosaics(0)], flats=[mosaics(e) for e in (2000, 6000, 10000)], white_level=TOP_DN
    )
    assert found.maps.response.shape == SHAPE
    assert found.calibration.defect_pixels == 0
    error = abs(found.transfer.gain_e_per_dn - GAIN_E_PER_DN)
    assert error < 4 * found.transfer.gain_e_per_dn_err


def jpegs(folder: Path) -> Path:
    folder.mkdir()
    for index in range(2):
        Image.fromarray((FLATS[4000.0][index] >> 4).astype(np.uint8)).save(folder / f"{index}.jpg")
    return folder


def pngs(folder: Path) -> Path:
    folder.mkdir()
    for index in range(2):
        Image.fromarray((FLATS[4000.0][index] >> 4).astype(np.uint8)).save(folder / f"{index}.png")
    return folder


def two_exposures(folder: Path) -> list[object]:
    written(folder, FLATS[1000.0], 1000.0, "a")
    written(folder, FLATS[2000.0], 2000.0, "b")
    return [sorted(folder.iterdir()), FLATS[4000.0]]


REFUSED: dict[str, tuple[Callable[[Path], Any], str]] = {
    "one frame": (lambda _: [FLATS[1000.0][:1], FLATS[2000.0]], "a flat level needs at least 2"),
    "two sizes": (lambda _: {1: [*FLATS[1000.0], FLATS[1000.0][0, :20]]}, "40 x 24 and 40 x 20"),
    "levels of two sizes": (
        lambda _: [FLATS[1000.0][:, :20], FLATS[2000.0][:, :20]],
        "has frames of 40 x 24 pixels",
    ),
    "two exposures": (two_exposures, "a level has one exposure"),
    "JPEG": (lambda folder: jpegs(folder / "j"), "JPEG"),
    "sRGB": (lambda folder: pngs(folder / "p"), "taken as srgb"),
    "means": (lambda _: [each.astype(float) / 3 for each in FLATS.values()], "not whole numbers"),
    "colours": (
        lambda _: [[np.stack([f, f + 1, f], axis=2) for f in FLATS[1000.0]]] * 2,
        "frames are an array of",
    ),
    "two levels": (lambda _: [FLATS[1000.0], FLATS[2000.0]], "3 below 70% of saturation"),
    "no light": (lambda _: [*taken((1.0, 2.0, 3.0), 0.0, seed=9).values()], "not"),
    "nothing": (lambda _: [], "expected at least one frame"),
    "no files": (lambda folder: folder / "*.tif", "no image file has such a name"),
    "an empty folder": (lambda folder: folder, "no image files in this folder"),
    "a number": (lambda _: 3, "expected a folder"),
    "a mask": (lambda _: np.ma.masked_greater(FLATS[1000.0], 200), "masked"),
    "frames and levels": (lambda _: [FLATS[1000.0], FLATS[2000.0][0]], "one or the other"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_frames_that_cannot_be_are_refused_with_the_remedy(what: str, tmp_path: Path) -> None:
    make, said = REFUSED[what]
    flats = make(tmp_path)
    with pytest.raises((NoiseError, ArgumentError, ImageFileError)) as refused:
        standoff.measure_noise(darks=DARKS, flats=flats)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_darks_and_flats_that_are_exchanged_are_refused() -> None:
    with pytest.raises(NoiseError, match="have been swapped"):
        standoff.measure_noise(darks=FLATS, flats=DARKS, white_level=TOP_DN)
    lit = taken((16000.0,), ELECTRONS_PER_US)
    with pytest.raises(NoiseError, match="put the lens cap on"):
        standoff.measure_noise(darks=lit, flats=FLATS, white_level=TOP_DN)


def test_floats_that_do_not_tell_where_they_clip_need_a_white_level() -> None:
    darks, flats = ({us: f.astype(float) for us, f in levels.items()} for levels in (DARKS, FLATS))
    with pytest.raises(ArgumentError) as refused:
        standoff.measure_noise(darks=darks, flats=flats)
    assert refused.value.argument == "white_level"
    found = standoff.measure_noise(darks=darks, flats=flats, white_level=TOP_DN)
    exact = standoff.measure_noise(darks=DARKS, flats=FLATS, white_level=TOP_DN)
    assert found.transfer.gain_e_per_dn == pytest.approx(exact.transfer.gain_e_per_dn, rel=1e-6)


@pytest.mark.parametrize(
    ("given", "argument"),
    [
        ({}, "session"),
        ({"darks": DARKS}, "flats"),
        ({"flats": FLATS}, "darks"),
        ({"session": "s", "darks": DARKS, "flats": FLATS}, "session"),
        ({"darks": DARKS, "flats": [*FLATS.values()], "flat_exposures_us": [1.0]},
         "flat_exposures_us"),
        ({"darks": DARKS, "flats": FLATS, "flat_exposures_us": [*FLATS]}, "flat_exposures_us"),
        ({"darks": DARKS, "flats": {-5.0: FLATS[1000.0]}}, "exposure_us"),
    ],
)  # fmt: skip
def test_arguments_that_do_not_go_together_are_named(given: Any, argument: str) -> None:
    with pytest.raises(ArgumentError) as refused:
        standoff.measure_noise(**given)
    assert refused.value.argument == argument


def test_the_command_takes_folders_and_patterns(command: Command, tmp_path: Path) -> None:
    ways = every_way(tmp_path / "frames")
    darks, flats = ways["folders of folders"]
    out, page = tmp_path / "noise.json", tmp_path / "noise.html"
    command.done("noise", "--dark", darks, "--flat", flats, "--white-level", "4095",
                   "--out", out, "--report", page)  # fmt: skip
    expected = figures(standoff.measure_noise(darks=DARKS, flats=FLATS, white_level=TOP_DN))
    document = NoiseCalibration.model_validate_json(out.read_text())
    assert document.gain_e_per_dn == expected["gain_e_per_dn"]
    assert document.dark_current_e_per_s == expected["dark_current_e_per_s"]
    assert document.provenance is not None
    assert len(document.provenance.inputs) == 6 * (len(DARKS) + len(FLATS))
    assert "3 dark and 5 flat captures" in page.read_text("utf-8")


def test_the_command_takes_exposures_that_no_file_states(command: Command, tmp_path: Path) -> None:
    words: list[object] = []
    for kind, levels in (("dark", DARKS), ("flat", FLATS)):
        for us, frames in levels.items():
            words += [f"--{kind}", written(tmp_path / f"{kind}{us:05.0f}", frames)]
            words += [f"--{kind}-exposure-us", f"{us:g}"]
    out = tmp_path / "noise.json"
    command.done("noise", *words, "--white-level", "4095", "--out", out)
    document = NoiseCalibration.model_validate_json(out.read_text())
    expected = standoff.measure_noise(darks=DARKS, flats=FLATS, white_level=TOP_DN).calibration
    assert document.linearity_error == expected.linearity_error
    lacks = command("noise", "--flat", tmp_path / "flat01000", "--out", tmp_path / "n.json")
    assert lacks.status == 2
    assert "--dark" in lacks.err
