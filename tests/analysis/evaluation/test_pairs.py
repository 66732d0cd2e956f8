"""Pairs: where a change is seen, what is alike in both, and that a pair is the same bits again."""

import numpy as np
import pytest

from analysis.errors import RefusedPhotographError
from analysis.evaluation import (
    Condition,
    EvaluationTask,
    LaterScene,
    PairMaker,
    Patch,
    Spot,
    refocused,
)
from simulation import GaussianPsf
from simulation.arrays import FloatArray

PSF = GaussianPsf(sigma_px=0.8)
SIGMA_PX = 3.0


def task(**more: object) -> EvaluationTask:
    known: dict[str, object] = {
        **{"zooms": (1.0, 1.3, 2.0), "noises_dn": (0.0,), "contrasts_dn": (10.0,)},
        **{"change": Spot(sigma_px=SIGMA_PX), "crop_px": 96, "crops": 2, "model": "matched"},
        **more,
    }
    return EvaluationTask(**known)  # type: ignore[arg-type]


def maker(image: FloatArray, asked: EvaluationTask, later: LaterScene | None = None) -> PairMaker:
    return PairMaker(levels_dn=image, digest="a1b2c3d4e5f60718", task=asked, psf=PSF, later=later)


def textured(side_px: int = 256) -> FloatArray:
    return 500 + 40 * np.random.default_rng(2).standard_normal((side_px, side_px))


@pytest.mark.parametrize(
    ("zoom", "tilt_deg"), [(1.0, 0.0), (1.3, 0.0), (2.0, 0.0), (1.3, 12.0), (2.0, -9.0)]
)
def test_a_spot_is_seen_at_its_place_with_the_width_that_the_lens_adds(
    zoom: float, tilt_deg: float
) -> None:
    # Closed form: a Gaussian of variance s^2 / z^2 + Sigma (1 - 1 / z^2) follow-up px^2.
    asked = task(tilts_deg=(0.0, tilt_deg) if tilt_deg else (0.0,), focal_length_px=900.0)
    image = np.full((256, 256), 500.0)
    condition = Condition(zoom=zoom, tilt_deg=tilt_deg, noise_dn=0.0, contrast_dn=10.0)
    for crop in range(2):
        without, with_change = maker(image, asked).pairs(crop, condition)
        assert without.place is None
        place = with_change.place
        assert place is not None
        assert np.array_equal(without.reference, with_change.reference)
        assert without.followup == pytest.approx(500.0, abs=0.05)
        added = with_change.followup.astype(np.float64) - without.followup
        y, x = np.indices(added.shape)
        mass = added.sum()
        assert (x * added).sum() / mass == pytest.approx(place.x_px, abs=0.05)
        assert (y * added).sum() / mass == pytest.approx(place.y_px, abs=0.05)
        variance = SIGMA_PX**2 / zoom**2 + 0.8**2 * (1 - 1 / zoom**2)
        if tilt_deg == 0:
            peak = 10.0 * (SIGMA_PX / zoom) ** 2 / variance
            assert mass / (2 * np.pi) == pytest.approx(peak * variance, rel=0.02)


def test_the_homography_takes_the_follow_ups_pixels_to_the_reference() -> None:
    # A ramp keeps its levels wherever it is seen: each pixel of the follow-up says where it looks.
    y, x = np.indices((256, 256), dtype=np.float64)
    asked = task(tilts_deg=(0.0, 10.0), focal_length_px=900.0)
    for tilt_deg in asked.tilts_deg:
        condition = Condition(zoom=1.3, tilt_deg=tilt_deg, noise_dn=0.0, contrast_dn=10.0)
        for axis, ramp in enumerate((x, y)):
            pair = next(maker(500 + ramp, asked).pairs(0, condition))
            at = np.indices(pair.followup.shape, dtype=np.float64)[::-1].reshape(2, -1)
            seen = pair.homography @ np.vstack([at, np.ones(at.shape[1])])
            seen = (seen[:2] / seen[2]).reshape(2, *pair.followup.shape)
            first = float(pair.reference[0, 0])
            inner = np.s_[8:-8, 8:-8]
            assert pair.followup[inner] == pytest.approx(first + seen[axis][inner], abs=0.05)


def test_a_pair_is_the_same_again_and_another_crop_is_another_pair() -> None:
    asked = task(noises_dn=(2.0,), focus_scatter_px2=0.05, light_scatter=0.02)
    condition = asked.conditions[1]
    first, again = (list(maker(textured(), asked).pairs(0, condition)) for _ in range(2))
    other = list(maker(textured(), asked).pairs(1, condition))
    for one, same, unlike in zip(first, again, other, strict=True):
        assert np.array_equal(one.followup, same.followup)
        assert np.array_equal(one.reference, same.reference)
        assert not np.array_equal(one.followup, unlike.followup)


def test_noise_is_that_of_the_task_in_both_photographs() -> None:
    condition = Condition(zoom=1.3, tilt_deg=0.0, noise_dn=2.0, contrast_dn=10.0)
    pair = next(maker(np.full((256, 256), 500.0), task(noises_dn=(2.0,))).pairs(0, condition))
    assert float(pair.reference.std()) == pytest.approx(2.0, rel=0.05)
    assert float(pair.followup.std()) == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("added_px2", [-0.2, 0.0, 0.5])
def test_another_focus_is_a_gaussian_more_or_less(added_px2: float) -> None:
    y, x = np.indices((64, 64)) - 31.3
    wide = 4.0 + added_px2
    spot, blurred = (np.exp(-(x**2 + y**2) / (2 * v)) / v for v in (4.0, wide))
    assert refocused(spot, added_px2) == pytest.approx(blurred, abs=1e-9)


def test_a_patch_covers_as_far_as_its_alpha_says() -> None:
    levels, alpha = np.full((9, 9), 100.0), np.zeros((9, 9))
    alpha[2:7, 2:7] = 1.0
    alpha[4, 4] = 0.5
    patch = Patch(levels_dn=levels, alpha=alpha)
    painted = patch.painted(np.full((40, 40), 500.0), (20.0, 18.0), 1.0)
    expected = np.full((40, 40), 500.0)
    expected[16:21, 18:23] = 100.0
    expected[18, 20] = 300.0
    assert painted == pytest.approx(expected)
    # Between pixels its sum stays what it is.
    shifted = patch.painted(np.full((40, 40), 500.0), (20.4, 18.7), 1.0)
    assert shifted.sum() == pytest.approx(expected.sum())


def test_what_changed_later_is_taken_where_the_mask_says() -> None:
    before, after = textured(), textured() + 30
    mask = np.zeros(before.shape, np.bool_)
    mask[120:130, 100:116] = True
    condition = Condition(zoom=1.0, tilt_deg=0.0, noise_dn=0.0, contrast_dn=1.0)
    without, with_change = maker(
        before, task(contrasts_dn=(1.0,)), LaterScene(after_dn=after, mask=mask)
    ).pairs(0, condition)
    added = with_change.followup.astype(np.float64) - without.followup
    assert np.count_nonzero(np.abs(added) > 15) == 160
    assert with_change.place is not None
    y, x = np.nonzero(np.abs(added) > 15)
    assert (x.mean(), y.mean()) == pytest.approx((with_change.place.x_px, with_change.place.y_px))


def test_photographs_that_are_too_small_are_refused_with_the_size_they_need() -> None:
    with pytest.raises(RefusedPhotographError, match=r"need 1\d\d px a side"):
        maker(textured(100), task())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"zooms": (1.5, 1.2)}, "zooms: expected rising"),
        ({"tilts_deg": (5.0,)}, "focal length"),
        ({"tilts_deg": (5.0,), "focal_length_px": 900.0, "model": "bicubic"}, "a tilt needs model"),
        ({"zooms": (1.0, 8.0)}, "leaves a follow-up of 12 px"),
        ({"change": Spot(sigma_px=12.0)}, "does not fit"),
        ({"noises_dn": (-1.0,)}, "noises_dn: expected a number from 0"),
    ],
)
def test_tasks_that_cannot_be_done_say_why(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        task(**wrong)
