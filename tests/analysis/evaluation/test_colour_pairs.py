"""Pairs in colour: what a detector that takes colours is given, and what only it can see."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

import standoff
from acquisition.photographs import luma_plane
from analysis.evaluation import EvaluationTask, LaterScene, PairMaker, Patch, Spot
from simulation import GaussianPsf
from simulation.arrays import Float32Array, FloatArray

PSF = GaussianPsf(sigma_px=0.8)
WEIGHTS = np.array([0.299, 0.587, 0.114])
"""Of the luma, Rec. 601."""

RED, GREEN = np.array([300.0, 100.0, 100.0]), np.array([100.0, 0.0, 100.0])
GREEN[1] = (RED @ WEIGHTS - GREEN @ WEIGHTS) / WEIGHTS[1]
"""Of the same luma as red."""


def scene(seed: int, side_px: int = 140) -> FloatArray:
    """A red wall with texture of its own in each channel."""
    rng = np.random.default_rng(seed)
    return RED + 2.0 * rng.standard_normal((side_px, side_px, 3))


def green_patch() -> Patch:
    """A disc that is green, of the wall's luma."""
    y, x = np.indices((13, 13)) - 6
    levels = np.broadcast_to(GREEN, (13, 13, 3)).copy()
    return Patch(levels_dn=levels, alpha=(np.hypot(x, y) < 5.5).astype(np.float64))


def task(change: Patch | Spot, **more: object) -> EvaluationTask:
    known: dict[str, object] = {
        **{"zooms": (1.3,), "noises_dn": (2.0,), "contrasts_dn": (1.0,), "change": change},
        **{"crop_px": 56, "crops": 6, "model": "matched"},
        **more,
    }
    return EvaluationTask(**known)  # type: ignore[arg-type]


def pairs(
    levels_dn: FloatArray, asked: EvaluationTask, later: LaterScene | None = None
) -> list[tuple[Float32Array, Float32Array]]:
    made = PairMaker(
        levels_dn=levels_dn, digest="a1b2c3d4e5f60718", task=asked, psf=PSF, later=later
    )
    return [(one.reference, one.followup) for one in made.pairs(0, asked.conditions[0])]


SEEN: list[tuple[tuple[int, ...], tuple[int, ...]]] = []


class Colours:
    """The largest difference of the channels from the wall's, on the follow-up alone."""

    colour = True

    def __call__(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray
    ) -> Float32Array:
        SEEN.append((reference.shape, followup.shape))
        blurred = np.asarray(cv2.GaussianBlur(followup, (0, 0), 1.5))
        return np.asarray(np.abs(blurred - reference.mean((0, 1))).max(axis=2))


def greys(reference: Float32Array, followup: Float32Array, homography: FloatArray) -> Float32Array:
    """The same of grey levels."""
    SEEN.append((reference.shape, followup.shape))
    blurred = np.asarray(cv2.GaussianBlur(followup, (0, 0), 1.5))
    return np.asarray(np.abs(blurred - reference.mean()))


@pytest.fixture(autouse=True)
def _nothing_seen() -> None:
    SEEN.clear()


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    folder = tmp_path / "photographs"
    folder.mkdir()
    for number in range(3):
        tifffile.imwrite(
            folder / f"wall-{number}.tif", scene(number).astype(np.float32), photometric="rgb"
        )
    return folder


def auc(detector: Callable[..., Float32Array], photographs: Path, change: Patch | Spot) -> float:
    found = standoff.evaluate(detector, photographs, PSF, task(change)).evaluation
    assert found is not None
    return found.curves[0].auc_all_pairs[0]


def test_a_change_of_hue_at_one_luma_is_seen_in_colour_and_not_in_grey(photographs: Path) -> None:
    # Worked example: 36 pairs; the disc changes red by 200 DN and the luma by nothing.
    assert pytest.approx(RED @ WEIGHTS, rel=1e-12) == GREEN @ WEIGHTS
    assert auc(Colours(), photographs, green_patch()) == 1.0
    assert {len(shape) for one in SEEN for shape in one} == {3}
    assert {shape[2] for one in SEEN for shape in one} == {3}
    SEEN.clear()
    # Of 18 scores of each kind that differ by chance alone, AUC scatters by 0.1.
    assert auc(greys, photographs, green_patch()) == pytest.approx(0.5, abs=0.35)
    assert {len(shape) for one in SEEN for shape in one} == {2}


@pytest.mark.slow
def test_the_built_in_difference_of_colours_sees_it_too(photographs: Path) -> None:
    change = green_patch()
    in_colour, in_grey = (
        standoff.evaluate(name, photographs, PSF, task(change)).evaluation
        for name in ("colour-difference", "absolute-difference")
    )
    assert in_colour is not None
    assert in_grey is not None
    assert in_colour.curves[0].auc_all_pairs == [1.0]
    assert in_grey.curves[0].auc_all_pairs[0] < 0.9
    assert (in_colour.colour_photographs, in_grey.colour_photographs) == (3, 0)


@pytest.mark.slow
def test_a_grey_detector_is_given_what_it_is_of_grey_photographs(
    photographs: Path, tmp_path: Path
) -> None:
    # The luma of the file, with the noise that is asked for: no mean of three noises.
    spot = Spot(sigma_px=2.0)
    grey = tmp_path / "grey"
    grey.mkdir()
    for path in photographs.iterdir():
        tifffile.imwrite(grey / path.name, luma_plane(tifffile.imread(path)))
    asked = task(spot, contrasts_dn=(8.0,))
    made = PairMaker(levels_dn=luma_plane(scene(0)), digest="1", task=asked, psf=PSF).pairs(
        0, asked.conditions[0]
    )
    assert all(one.followup.ndim == 2 for one in made)
    found = standoff.evaluate("absolute-difference", photographs, PSF, asked)
    assert found.evaluation is not None
    assert found.evaluation.colour_photographs == 0
    assert found.evaluation.curves[0].dprime_bound[0] is not None


def test_a_bound_for_grey_levels_is_not_given_for_pairs_in_colour(photographs: Path) -> None:
    asked = task(Spot(sigma_px=2.0), contrasts_dn=(8.0,))
    found = standoff.evaluate(Colours(), photographs, PSF, asked)
    assert found.evaluation is not None
    assert found.evaluation.curves[0].dprime_bound == [None]
    assert any("no bound" in note for note in found.notes)


def test_a_detector_of_colours_gets_a_grey_photograph_three_times(tmp_path: Path) -> None:
    image = luma_plane(scene(3)).astype(np.float32)
    tifffile.imwrite(tmp_path / "grey.tif", image)
    given: list[Float32Array] = []

    class Kept:
        colour = True

        def __call__(
            self, reference: Float32Array, followup: Float32Array, homography: FloatArray
        ) -> float:
            given.extend([reference, followup])
            return 0.0

    standoff.evaluate(Kept(), tmp_path / "grey.tif", PSF, task(Spot(), contrasts_dn=(8.0,)))
    for one in given:
        assert one.shape[2] == 3
        np.testing.assert_array_equal(one[:, :, 0], one[:, :, 1])
        np.testing.assert_array_equal(one[:, :, 0], one[:, :, 2])


@pytest.mark.parametrize("tilt_deg", [0.0, 10.0])
def test_each_channel_of_a_pair_is_seen_as_a_grey_photograph_is(tilt_deg: float) -> None:
    asked = task(
        Spot(sigma_px=2.0),
        noises_dn=(0.0,),
        contrasts_dn=(20.0,),
        tilts_deg=(tilt_deg,),
        focal_length_px=900.0,
        focus_scatter_px2=0.2,
        light_scatter=0.1,
    )
    image = scene(4)
    whole = pairs(image, asked)
    for channel in range(3):
        for one, alone in zip(whole, pairs(image[:, :, channel], asked), strict=True):
            for both in zip(one, alone, strict=True):
                np.testing.assert_allclose(both[0][:, :, channel], both[1], rtol=1e-5)


def test_a_patch_in_colour_covers_a_grey_scene_by_its_luma_and_a_grey_one_all_channels() -> None:
    patch, grey = green_patch(), np.full((40, 40), 50.0)
    on_grey = patch.painted(grey, (20.0, 20.0), 1.0)
    assert on_grey[20, 20] == pytest.approx(GREEN @ WEIGHTS, rel=1e-12)
    plain = Patch(levels_dn=np.full((5, 5), 90.0), alpha=np.ones((5, 5)))
    on_colours = plain.painted(np.broadcast_to(RED, (40, 40, 3)).copy(), (20.0, 20.0), 1.0)
    assert on_colours[20, 20].tolist() == [90.0, 90.0, 90.0]
    assert on_colours[5, 5].tolist() == RED.tolist()


def test_a_later_photograph_in_colour_changes_what_its_mask_marks() -> None:
    before = scene(5)
    after, mask = before.copy(), np.zeros(before.shape[:2], np.bool_)
    mask[66:74, 66:74] = True
    after[mask] = GREEN
    later = LaterScene(after_dn=after, mask=mask)
    asked = task(Spot(sigma_px=2.0), noises_dn=(0.0,), zooms=(1.0,))
    (_, plain), (_, changed) = pairs(before, asked, later)
    added = changed - plain
    assert added[:, :, 0].min() == pytest.approx(GREEN[0] - RED[0], rel=0.1)
    assert np.abs(luma_plane(added)).max() < 5  # the texture of the wall, which is gone
    grey = later.in_grey
    assert grey.after_dn.ndim == 2
    assert len(pairs(luma_plane(before), asked, grey)) == 2
