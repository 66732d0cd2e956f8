"""Figures of edges whose profile and transfer are known in closed form."""

from collections.abc import Callable
from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from calibration.edges import EdgeImage, EdgeMeasurement, edges_of_image
from calibration.estimate import NORMAL_95
from calibration.sharpness import (
    EdgeFigures,
    MeasuredValue,
    edge_figures,
    median_figures,
    sharpening_of,
)
from simulation.arrays import FloatArray
from tests.calibration.diffraction import diffracted_edge
from tests.calibration.known import known
from tests.calibration.sharpness.edges import edge_of

SIGMA_PX, MASK_PX, AMOUNT = 0.7, 1.6, 0.5
LOW_DN, HIGH_DN = 500.0, 3000.0

Profile = Callable[[FloatArray], FloatArray]


def plain(distance_px: FloatArray) -> FloatArray:
    return np.asarray(ndtr(distance_px / SIGMA_PX))


def sharpened(distance_px: FloatArray) -> FloatArray:
    """The same edge after an unsharp mask: a share of what a wider blur takes away is added."""
    blurred = ndtr(distance_px / MASK_PX)
    return np.asarray((1 + AMOUNT) * ndtr(distance_px / SIGMA_PX) - AMOUNT * blurred)


def transfer(freq: float, amount: float) -> float:
    lens, mask = (np.exp(-2 * (np.pi * sigma * freq) ** 2) for sigma in (SIGMA_PX, MASK_PX))
    return float((1 + amount) * lens - amount * mask)


def edge(profile: Profile, noise_dn: float, seed: int = 0) -> EdgeMeasurement:
    y, x = np.mgrid[:120, :110].astype(np.float64)
    rng = np.random.default_rng(seed)
    normal = np.deg2rad(rng.uniform(4.0, 12.0))
    distance = np.cos(normal) * (x - 54.0 - rng.uniform()) + np.sin(normal) * (y - 59.5)
    return measured(LOW_DN + (HIGH_DN - LOW_DN) * profile(distance), noise_dn, rng)


def measured(levels_dn: FloatArray, noise_dn: float, rng: np.random.Generator) -> EdgeMeasurement:
    image = levels_dn + rng.normal(0, noise_dn, levels_dn.shape)
    [found] = edges_of_image(EdgeImage(name="edge.tif", image_dn=image))
    return found


def test_frequencies_of_a_gaussian_are_those_of_its_closed_form() -> None:
    figures = edge_figures(edge(plain, 0.0))
    assert known(figures.mtf50_cy_per_px).value == pytest.approx(falls_to(0.5), rel=1e-3)
    assert known(figures.mtf50p_cy_per_px).value == pytest.approx(falls_to(0.5), rel=1e-3)
    assert known(figures.mtf20_cy_per_px).value == pytest.approx(falls_to(0.2), rel=1e-3)
    assert known(figures.mtf10_cy_per_px).value == pytest.approx(falls_to(0.1), rel=2e-3)
    assert known(figures.mtf_at_nyquist).value == pytest.approx(transfer(0.5, 0.0), abs=1e-3)
    assert known(figures.mtf_at_half_nyquist).value == pytest.approx(transfer(0.25, 0.0), abs=1e-3)
    rise_px = SIGMA_PX * (ndtri(0.9) - ndtri(0.1))
    assert known(figures.rise_px).value == pytest.approx(rise_px, rel=2e-3)
    assert known(figures.overshoot).value == pytest.approx(0.0, abs=1e-3)
    assert known(figures.undershoot).value == pytest.approx(0.0, abs=1e-3)


def test_figures_of_an_unsharp_mask_are_those_of_its_closed_form() -> None:
    figures = edge_figures(edge(sharpened, 0.0))
    distance = np.linspace(0, 10, 100_001)
    over = float(sharpened(distance).max() - 1)
    assert known(figures.overshoot).value == pytest.approx(over, abs=1e-3)
    assert known(figures.undershoot).value == pytest.approx(over, abs=1e-3)
    freq = np.linspace(0, 0.6, 60_001)
    contrast = np.array([transfer(one, AMOUNT) for one in freq])
    half_of_peak = freq[np.flatnonzero(contrast >= contrast.max() / 2)[-1]]
    assert known(figures.mtf50p_cy_per_px).value == pytest.approx(half_of_peak, rel=3e-3)
    half = brentq(lambda one: transfer(one, AMOUNT) - 0.5, 0.2, 0.6)
    assert known(figures.mtf50_cy_per_px).value == pytest.approx(half, rel=3e-3)
    assert half > 1.02 * half_of_peak
    low, high = (brentq(lambda at, p=p: float(sharpened(np.array(at))) - p, -3, 3)
                 for p in (0.1, 0.9))  # fmt: skip
    assert known(figures.rise_px).value == pytest.approx(high - low, rel=5e-3)


def falls_to(level: float) -> float:
    """Frequency at which the contrast of the Gaussian has fallen to a level."""
    return float(np.sqrt(-np.log(level) / 2) / (np.pi * SIGMA_PX))


TRUTHS = {
    "mtf50_cy_per_px": falls_to(0.5),
    "mtf50p_cy_per_px": falls_to(0.5),
    "mtf20_cy_per_px": falls_to(0.2),
    "mtf10_cy_per_px": falls_to(0.1),
    "mtf_at_half_nyquist": transfer(0.25, 0.0),
    "mtf_at_nyquist": transfer(0.5, 0.0),
    "rise_px": SIGMA_PX * float(ndtri(0.9) - ndtri(0.1)),
}


@cache
def in_noise() -> tuple[EdgeFigures, ...]:
    return tuple(edge_figures(edge(plain, 40.0, seed)) for seed in range(80))


@pytest.mark.slow
@pytest.mark.parametrize("name", list(TRUTHS))
def test_intervals_hold_the_truth_in_noise_and_are_no_wider_than_that(name: str) -> None:
    found = [known(getattr(one, name)) for one in in_noise()]
    inside = np.mean([abs(one.value - TRUTHS[name]) < NORMAL_95 * one.err for one in found])
    assert inside > 0.87  # of 80: three standard errors below 95 %
    scatter = np.std([one.value for one in found], ddof=1)
    stated = np.sqrt(np.mean([one.err**2 for one in found]))
    # The scatter of 80 is known to 8 %.
    assert 0.6 < scatter / stated < 1.2


def test_sharpened_photographs_are_said_to_be_so() -> None:
    found = known(sharpening_of([edge(sharpened, 60.0, seed) for seed in range(4)]))
    assert found.is_found
    distance = np.linspace(0, 10, 100_001)
    assert found.overshoot.value == pytest.approx(float(sharpened(distance).max() - 1), abs=0.01)
    assert found.sentence.startswith("The photographs are sharpened")


@pytest.mark.slow
def test_an_unsharpened_edge_in_noise_is_not_said_to_be_sharpened() -> None:
    diffracted = diffracted_edge(0.9, 7.0)  # from 8000 to 52000 DN
    for seed, snr in product(range(12), (250.0, 40.0, 12.0)):
        rng = np.random.default_rng(seed)
        gaussian = edge(plain, (HIGH_DN - LOW_DN) / snr, seed)
        for one in (gaussian, measured(diffracted, 44_000.0 / snr, rng)):
            assert not known(sharpening_of([one])).is_found, (seed, snr)


def test_a_figure_that_an_edge_does_not_determine_is_none() -> None:
    assert sharpening_of([edge_of()]) is None
    sharp = edge_figures(edge(lambda distance: np.asarray(ndtr(distance / 0.25)), 0.0))
    assert sharp.mtf10_cy_per_px is None  # above a tenth at 1 cy/px


def test_without_an_esfr_all_figures_are_those_of_the_fitted_gaussian() -> None:
    sigma_px, half = 0.7, float(np.sqrt(np.log(2) / 2) / (np.pi * 0.7))
    figures = edge_figures(
        edge_of(
            sigma_px=sigma_px,
            sigma_err_px=0.007,
            optical_sigma_px=None,
            optical_sigma_err_px=None,
            mtf50_cy_per_px=half,
            mtf50_err_cy_per_px=0.01 * half,
        )
    )
    assert not figures.is_model_free
    assert figures.mtf50_cy_per_px == figures.mtf50p_cy_per_px
    fifth = known(figures.mtf20_cy_per_px)
    assert fifth.value == pytest.approx(np.sqrt(np.log(5) / np.log(2)) * half, rel=1e-4)
    assert fifth.err == pytest.approx(0.01 * fifth.value)
    at_nyquist = known(figures.mtf_at_nyquist)
    assert at_nyquist.value == pytest.approx(transfer(0.5, 0.0))
    # d ln C / d ln sigma = -4 pi^2 sigma^2 f^2.
    slope = 4 * (np.pi * sigma_px * 0.5) ** 2
    assert at_nyquist.err == pytest.approx(0.01 * slope * at_nyquist.value, rel=0.01)
    assert known(figures.rise_px).value == pytest.approx(2.5631 * sigma_px, rel=1e-4)
    assert figures.overshoot is None


def test_both_ways_agree_on_a_gaussian() -> None:
    measured_edge = edge(plain, 0.0)
    by_esfr = edge_figures(measured_edge)
    by_gaussian = edge_figures(
        measured_edge.model_copy(
            update={"esfr": None, "esfr_mtf50_cy_per_px": None, "esfr_mtf50_err_cy_per_px": None}
        )
    )
    for name in ("mtf20_cy_per_px", "mtf10_cy_per_px", "mtf_at_nyquist", "rise_px"):
        one, other = known(getattr(by_esfr, name)), known(getattr(by_gaussian, name))
        # The fit takes a pixel's square for granted, which these edges have not.
        assert one.value == pytest.approx(other.value, rel=0.03), name


def test_the_median_over_edges_counts_those_that_have_the_figure() -> None:
    values = [
        EdgeFigures(rise_px=MeasuredValue(value=1.0, err=0.2)),
        EdgeFigures(rise_px=MeasuredValue(value=2.0, err=0.2)),
        EdgeFigures(),
    ]
    found = median_figures(values)
    assert known(found.rise_px).value == 1.5
    assert known(found.rise_px).err == pytest.approx(0.2 / np.sqrt(2))
    assert found.mtf20_cy_per_px is None
