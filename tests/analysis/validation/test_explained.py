"""Reduced chi-squared of pairs whose errors are known, rendered in closed form."""

import numpy as np
import pytest

from analysis.validation.explained import Expectation, PairErrors
from analysis.validation.pair import AlignedPair
from calibration.registration import DistortedPose
from simulation import GaussianPsf, zoom_out_on_grid
from simulation.arrays import FloatArray
from simulation.sampling_grid import simulate_at
from tests.simulation.wave_scene import WaveScene

SHAPE, ZOOM, SIGMA_PX, NOISE_DN = (200, 240), 1.5, 0.8, 1.0


def pair_of(seed: int, off_px2: float = 0.0) -> AlignedPair:
    """A reference and a follow-up whose PSF's variance is off by so much."""
    rng, scene = np.random.default_rng(seed), WaveScene(seed)
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(np.float64)
    round_blur = np.array([1.0, 0.0, 1.0])
    middle = np.array([(SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2])
    shift = middle - ZOOM * middle + 0.3
    near = scene.photographed(x, y, np.broadcast_to(SIGMA_PX**2 * round_blur, (*SHAPE, 3)))
    blur = ZOOM**2 * (SIGMA_PX**2 + off_px2) * round_blur
    far = scene.photographed(
        ZOOM * x + shift[0], ZOOM * y + shift[1], np.broadcast_to(blur, (*SHAPE, 3))
    )
    matrix = np.array([[ZOOM, 0.0, shift[0]], [0.0, ZOOM, shift[1]], [0.0, 0.0, 1.0]])
    # Less light in the follow-up, and a corner in the shade.
    light = 0.93 - 0.02 * (x / SHAPE[1]) ** 2
    return AlignedPair(
        reference=near + NOISE_DN * rng.normal(size=SHAPE),
        followup=light * far + 3.0 + NOISE_DN * rng.normal(size=SHAPE),
        pose=DistortedPose(matrix=matrix, k1=0.0, reference_shape=SHAPE, followup_shape=SHAPE),
    )


def errors(place_err_px: float = 0.0, noise_dn: float = NOISE_DN) -> PairErrors:
    variance = np.full(SHAPE, noise_dn**2)
    return PairErrors(
        reference_dn2=variance,
        followup_dn2=variance,
        place_err_px=place_err_px,
        psf=GaussianPsf(sigma_px=SIGMA_PX),
    )


def made(pair: AlignedPair) -> FloatArray:
    window, psf = pair.window, GaussianPsf(sigma_px=SIGMA_PX)
    return simulate_at(
        lambda grid: zoom_out_on_grid(np.asarray(pair.reference), grid, psf, "lmmse"),
        SHAPE,
        ZOOM,
        window.y_px,
        window.x_px,
    )


@pytest.mark.slow
def test_noise_and_light_leave_a_chi_squared_of_1() -> None:
    found = []
    for seed in range(4):
        pair = pair_of(seed)
        found.append(Expectation.of(pair, errors()).chi2_reduced(made(pair)))
    # Some 5,000 pixels each, whose simulated half is correlated: 2 %; the model states a little.
    assert np.mean(found) == pytest.approx(1.0, abs=0.06)


@pytest.mark.slow
def test_a_focus_that_is_off_is_far_beyond_it() -> None:
    # Half a px^2 changes the waves at 0.1 cy/px by 20 %, several times the noise.
    pair = pair_of(1, off_px2=0.5)
    assert Expectation.of(pair, errors()).chi2_reduced(made(pair)) > 2.5


@pytest.mark.slow
def test_less_noise_than_there_is_and_a_place_that_is_not_known_count() -> None:
    pair = pair_of(2)
    simulated = made(pair)
    plain = Expectation.of(pair, errors()).chi2_reduced(simulated)
    assert Expectation.of(pair, errors(noise_dn=0.5)).chi2_reduced(simulated) > 3 * plain
    assert Expectation.of(pair, errors(place_err_px=0.1)).chi2_reduced(simulated) < 0.9 * plain
