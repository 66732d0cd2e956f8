"""Pairs of scenes with depth: planes as a limit, closed forms of a spot's place, what is hidden."""

from dataclasses import replace
from math import cos, radians

import numpy as np
import pytest

from analysis.errors import RefusedPhotographError
from analysis.evaluation import Condition, EvaluationTask, PairMaker
from analysis.evaluation.change_pairs import ChangePairsTask, labelled_pairs
from analysis.evaluation.pairs import filled
from simulation.arrays import FloatArray
from tests.analysis.evaluation.test_pairs import PSF, maker, task, textured

SIDE_PX = 256
FLAT = np.full((SIDE_PX, SIDE_PX), 700.0)
TILTED = Condition(zoom=1.3, tilt_deg=12.0, noise_dn=0.0, contrast_dn=10.0)


def with_depth(image: FloatArray, asked: EvaluationTask, depth: FloatArray) -> PairMaker:
    return replace(maker(image, asked), depth=depth)


def tilted_task(**more: object) -> EvaluationTask:
    return task(tilts_deg=(0.0, 12.0), focal_length_px=900.0, **more)


@pytest.mark.parametrize("tilt_deg", [0.0, 12.0])
def test_pairs_of_a_plane_are_those_of_a_flat_scene(tilt_deg: float) -> None:
    condition = replace(TILTED, tilt_deg=tilt_deg, noise_dn=3.0)
    asked = tilted_task(noises_dn=(3.0,), light_scatter=0.05)
    image = textured()
    flat = maker(image, asked).pairs(1, condition)
    deep = with_depth(image, asked, FLAT).pairs(1, condition)
    for one, other in zip(flat, deep, strict=True):
        assert np.array_equal(one.reference, other.reference)
        assert np.array_equal(one.homography, other.homography)
        # The same noise and light; on white noise of 40 DN, the kernels' ends make a difference.
        assert np.std(other.followup - one.followup) < 0.4
        if one.place is not None:
            assert other.place is not None
            assert other.place.x_px == pytest.approx(one.place.x_px, abs=0.51)
            assert other.place.y_px == pytest.approx(one.place.y_px, abs=0.51)


def test_a_change_on_something_nearer_is_seen_where_its_depth_puts_it() -> None:
    # The camera moves straight back from the plane at the middle to 1.3 times the distance: what
    # is at half of that distance goes to 1.6 times its own, and everything of it is there.
    condition = replace(TILTED, tilt_deg=0.0)
    asked = task()
    side_px = asked.scene_px(0.8)  # so that there is but one part
    depth = np.full((side_px, side_px), 350.0)
    middle = side_px // 2
    depth[middle - 2 : middle + 3, middle - 2 : middle + 3] = 700.0
    image = np.full(depth.shape, 500.0)
    flat = list(maker(image, asked).pairs(0, condition))[1]
    without, with_change = with_depth(image, asked, depth).pairs(0, condition)
    assert flat.place is not None
    assert with_change.place is not None
    added = with_change.followup.astype(np.float64) - without.followup
    y, x = np.indices(added.shape)
    mass = added.sum()
    middle = (added.shape[0] - 1) / 2
    for seen, flat_px, own_px in (
        ((x * added).sum() / mass, flat.place.x_px, with_change.place.x_px),
        ((y * added).sum() / mass, flat.place.y_px, with_change.place.y_px),
    ):
        assert seen - middle == pytest.approx((flat_px - middle) * 1.3 / 1.6, abs=0.1)
        assert own_px == pytest.approx(seen, abs=0.6)


def test_detectors_are_told_the_plane_and_see_the_rest_displaced() -> None:
    # Beams at 560 before the plane at 700, or behind the plane at 560, seen at 12 degrees.
    depth = FLAT.copy()
    depth[:, np.arange(SIDE_PX) // 24 % 2 == 0] = 560.0
    image = textured()
    asked = tilted_task()
    flat = next(maker(image, asked).pairs(0, TILTED))
    deep = next(with_depth(image, asked, depth).pairs(0, TILTED))
    assert np.array_equal(flat.homography, deep.homography)
    apart = np.abs(deep.followup - flat.followup)
    assert np.mean(apart < 0.5) > 0.1
    assert np.mean(apart > 10.0) > 0.1


def test_what_is_hidden_is_filled_from_around_it() -> None:
    image = np.full((40, 50), 300.0)
    image[:, 25:] = 500.0
    unseen = np.zeros(image.shape, dtype=np.bool_)
    unseen[10:20, 5:12] = True
    holed = np.where(unseen, 0.0, image)
    assert filled(holed, unseen) == pytest.approx(image, abs=1e-3)
    colours = np.stack([holed, 2 * holed, 3 * holed], axis=-1)
    assert filled(colours, unseen)[:, :, 2] == pytest.approx(3 * image, abs=1e-2)
    assert np.array_equal(filled(image, np.zeros_like(unseen)), image)


def test_no_pair_has_a_hole() -> None:
    rng = np.random.default_rng(5)
    cells = rng.uniform(500, 900, (16, 16))
    depth = np.repeat(np.repeat(cells, 16, 0), 16, 1)
    for pair in with_depth(textured(), tilted_task(), depth).pairs(1, TILTED):
        assert pair.followup.min() > 250


def test_a_hidden_change_is_labelled_as_none() -> None:
    # Beams as wide as they stand apart: half of what is behind them is hidden at a steep tilt.
    depth = FLAT.copy()
    for first in range(0, SIDE_PX, 32):
        depth[:, first : first + 16] = 400.0
    asked = ChangePairsTask(
        zooms=(1.0, 1.0), tilts_deg=(35.0, 35.0), focal_length_px=900.0, noises_dn=(1.0, 1.0)
    ).model_copy(update={"pairs": 8, "crop_px": 64, "sigmas_px": (0.8, 0.8)})
    made = list(
        labelled_pairs(textured(400)[:SIDE_PX, :SIDE_PX], "a1b2c3d4e5f6", asked, PSF, depth)
    )
    labels = [pair.is_changed for pair in made[1::2]]
    assert any(labels)
    assert not all(labels)
    for pair in made:
        assert pair.is_changed == bool(pair.mask.any())


@pytest.mark.parametrize(
    ("asked", "depth", "message"),
    [
        (task(), FLAT[:200], "depth map has a different size"),
        (task(reference_zoom=1.2), FLAT, "reference zoom 1"),
        (task(model="paper"), FLAT, "model matched or lmmse"),
    ],
)
def test_depth_that_does_not_fit_is_refused(
    asked: EvaluationTask, depth: FloatArray, message: str
) -> None:
    with pytest.raises(RefusedPhotographError, match=message):
        with_depth(textured(300)[:SIDE_PX, :SIDE_PX], asked, depth)


def test_a_crop_of_no_known_depth_is_refused() -> None:
    made = with_depth(textured(), task(), np.full((SIDE_PX, SIDE_PX), np.nan))
    with pytest.raises(RefusedPhotographError, match="not known"):
        next(made.pairs(0, replace(TILTED, tilt_deg=0.0)))


def test_a_tilt_foreshortens_by_the_distance_of_the_plane_alone() -> None:
    # Closed form at the middle: a plane parallel to the sensor, turned by t at the same distance,
    # is seen shorter by cos t along the tilt, whatever its depth.
    for depth in (FLAT, 3 * FLAT):
        pair = next(with_depth(textured(), tilted_task(), depth).pairs(0, TILTED))
        slopes = np.linalg.svd(pair.homography[:2, :2] / pair.homography[2, 2])[1]
        assert slopes[0] / slopes[1] == pytest.approx(1 / cos(radians(12.0)), rel=0.15)
