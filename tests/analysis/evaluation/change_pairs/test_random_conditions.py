"""Pairs under random conditions: their masks in closed form, their ranges, and the same bits."""

import numpy as np
import pytest

from analysis.errors import RefusedPhotographError
from analysis.evaluation.change_pairs import ChangePairsTask, LabelledPair, labelled_pairs
from simulation import GaussianPsf
from simulation.arrays import FloatArray

PSF_PX = 0.8
DIGEST = "a1b2c3d4e5f60718"


def made(task: ChangePairsTask, image: FloatArray | None = None) -> list[LabelledPair]:
    scene = np.full((220, 240), 100.0) if image is None else image
    return list(labelled_pairs(scene, DIGEST, task, GaussianPsf(sigma_px=PSF_PX)))


def task(**more: object) -> ChangePairsTask:
    known: dict[str, object] = {"pairs": 6, "crop_px": 64, "zooms": (1.0, 2.0), **more}
    return ChangePairsTask.model_validate(known)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["matched", "lmmse"])
def test_the_mask_is_the_disc_in_which_the_spot_adds_more_than_half_of_its_peak(
    model: str,
) -> None:
    # Closed form: the follow-up shows a Gaussian of variance s^2/z^2 + Sigma (1 - 1/z^2), which is
    # above half of its peak within sqrt(2 ln 2) standard deviations. Noise leaves it as it is.
    asked = task(model=model, sigmas_px=(2.5, 3.5), noises_dn=(5.0, 9.0))
    image = 100 + 20 * np.sin(np.indices((220, 240)).sum(0) / 9)
    for pair in made(asked, image):
        if not pair.is_changed:
            assert not pair.mask.any()
            continue
        zoom = pair.condition.zoom
        variance = pair.sigma_px**2 / zoom**2 + PSF_PX**2 * (1 - 1 / zoom**2)
        area_px = 2 * np.pi * np.log(2) * variance
        # A disc on a grid: its area is known to about its rim's half pixel in sqrt(rim) places.
        assert pair.mask.sum() == pytest.approx(area_px, abs=0.5 * np.sqrt(area_px) + 2)
        y, x = np.nonzero(pair.mask)
        radius = np.hypot(y - y.mean(), x - x.mean()).max()
        assert radius <= np.sqrt(area_px / np.pi) + 1


def test_the_mask_lies_where_the_photographs_differ() -> None:
    for pair in made(task(noises_dn=(0.0, 0.0), model="matched")):
        moved = np.abs(pair.followup - np.median(pair.followup))
        if pair.is_changed:
            sign = np.sign(pair.condition.contrast_dn)
            added = sign * (pair.followup - np.median(pair.followup))
            assert np.array_equal(pair.mask, added > 0.5 * added.max())
        else:
            assert moved.max() < 1e-3


@pytest.mark.slow
def test_conditions_lie_in_their_ranges_and_differ_from_crop_to_crop() -> None:
    asked = task(
        pairs=30,
        model="matched",
        tilts_deg=(0.0, 15.0),
        focal_length_px=500.0,
        noises_dn=(1.0, 2.0),
        contrasts_dn=(5.0, 9.0),
    )
    pairs = made(asked)
    assert [one.is_changed for one in pairs] == 30 * [False, True]
    for name, (low, high) in (
        ("zoom", asked.zooms),
        ("tilt_deg", asked.tilts_deg),
        ("noise_dn", asked.noises_dn),
    ):
        values = [getattr(one.condition, name) for one in pairs[::2]]
        assert low <= min(values) < max(values) <= high
        assert len(set(values)) == 30
    contrasts = np.array([one.condition.contrast_dn for one in pairs[::2]])
    assert np.all((np.abs(contrasts) >= 5) & (np.abs(contrasts) <= 9))
    assert (contrasts > 0).any()
    assert (contrasts < 0).any()


@pytest.mark.parametrize(("changes", "sign"), [("brighter", 1), ("darker", -1)])
def test_changes_of_one_sign_are_made_on_demand(changes: str, sign: int) -> None:
    pairs = made(task(changes=changes, model="bicubic"))
    assert all(sign * one.condition.contrast_dn > 0 for one in pairs)


def test_the_same_photograph_gives_the_same_bits_and_another_seed_others() -> None:
    first, again = made(task(model="matched")), made(task(model="matched"))
    other = made(task(model="matched", seed=1))
    for one, two in zip(first, again, strict=True):
        for name in ("reference", "followup", "mask", "homography"):
            assert np.array_equal(getattr(one, name), getattr(two, name))
    assert first[0].condition != other[0].condition


def test_a_photograph_too_small_for_the_widest_pair_is_refused() -> None:
    with pytest.raises(RefusedPhotographError, match="need"):
        made(task(), np.full((70, 300), 100.0))


@pytest.mark.parametrize(
    "wrong",
    [
        {"zooms": (2.0, 1.0)},
        {"zooms": (0.5, 2.0)},
        {"zooms": (1.0, 9.0)},
        {"noises_dn": (-1.0, 2.0)},
        {"contrasts_dn": (0.0, 2.0)},
        {"sigmas_px": (1.0, 40.0)},
        {"tilts_deg": (0.0, 5.0)},
        {"pairs": 0},
        {"contrast": (1.0, 2.0)},
    ],
)
def test_ranges_that_no_pair_fits_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong)).split("_")[0][:4]):
        task(**wrong)
