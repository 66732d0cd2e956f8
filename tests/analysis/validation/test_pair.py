"""Reduced chi-squared of pairs whose errors are known, rendered in closed form."""

from math import inf, log10

import numpy as np
import pytest

from analysis.choices import ValidationModel
from analysis.validation._kernels import ModelInputs
from analysis.validation._metrics import ImageMetrics
from analysis.validation._pair import (
    AlignedPair,
    Expectation,
    PairErrors,
    PairMetrics,
    compare_pair,
)
from analysis.validation._session import mean_metrics
from calibration.registration import DistortedPose, Registration, register_images
from simulation import MODELS, GaussianPsf, zoom_out_on_grid
from simulation.arrays import FloatArray
from simulation.sampling_grid import simulate_at
from tests.analysis.bench_session import PSF, SHAPE, texture_dn
from tests.simulation.wave_scene import WaveScene

PHOTOGRAPH_SHAPE, ZOOM, SIGMA_PX, NOISE_DN = (200, 240), 1.5, 0.8, 1.0


def pair_of(seed: int, off_px2: float = 0.0) -> AlignedPair:
    """A reference and a follow-up whose PSF's variance is off by so much."""
    rng, scene = np.random.default_rng(seed), WaveScene(seed)
    y, x = np.mgrid[0 : PHOTOGRAPH_SHAPE[0], 0 : PHOTOGRAPH_SHAPE[1]].astype(np.float64)
    round_blur = np.array([1.0, 0.0, 1.0])
    middle = np.array([(PHOTOGRAPH_SHAPE[1] - 1) / 2, (PHOTOGRAPH_SHAPE[0] - 1) / 2])
    shift = middle - ZOOM * middle + 0.3
    near = scene.photographed(
        x, y, np.broadcast_to(SIGMA_PX**2 * round_blur, (*PHOTOGRAPH_SHAPE, 3))
    )
    blur = ZOOM**2 * (SIGMA_PX**2 + off_px2) * round_blur
    far = scene.photographed(
        ZOOM * x + shift[0], ZOOM * y + shift[1], np.broadcast_to(blur, (*PHOTOGRAPH_SHAPE, 3))
    )
    matrix = np.array([[ZOOM, 0.0, shift[0]], [0.0, ZOOM, shift[1]], [0.0, 0.0, 1.0]])
    # Less light in the follow-up, and a corner in the shade.
    light = 0.93 - 0.02 * (x / PHOTOGRAPH_SHAPE[1]) ** 2
    return AlignedPair(
        reference=near + NOISE_DN * rng.normal(size=PHOTOGRAPH_SHAPE),
        followup=light * far + 3.0 + NOISE_DN * rng.normal(size=PHOTOGRAPH_SHAPE),
        pose=DistortedPose(
            matrix=matrix, k1=0.0, reference_shape=PHOTOGRAPH_SHAPE, followup_shape=PHOTOGRAPH_SHAPE
        ),
    )


def errors(place_err_px: float = 0.0, noise_dn: float = NOISE_DN) -> PairErrors:
    variance = np.full(PHOTOGRAPH_SHAPE, noise_dn**2)
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
        PHOTOGRAPH_SHAPE,
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


def inputs(*models: ValidationModel) -> ModelInputs:
    return ModelInputs(psf=PSF, kernels=dict.fromkeys(models or MODELS))


def aligned(reference: np.ndarray, followup: np.ndarray) -> tuple[AlignedPair, Registration]:
    found = register_images(reference, followup, PSF)
    return AlignedPair(reference=reference, followup=followup, pose=found.pose), found


def compared(reference: np.ndarray, followup: np.ndarray, *models: ValidationModel) -> PairMetrics:
    pair, found = aligned(reference, followup)
    return compare_pair(pair, found.feature_matrix, inputs(*models))


def agreements(found: PairMetrics) -> dict[ValidationModel, ImageMetrics]:
    """On the follow-up's grid."""
    return {one.model: one.agreement for one in found.models if one.alignment == "followup-grid"}


@pytest.mark.slow
@pytest.mark.parametrize("zoom", [1.5, 2.0])
def test_the_better_the_physics_the_smaller_the_error(zoom: float) -> None:
    found = agreements(compared(texture_dn(1.0), texture_dn(zoom)))
    errors = {model: metrics.mse_dn2 for model, metrics in found.items()}
    assert errors["matched"] < errors["paper"] < errors["bicubic"]
    # Without noise matched sampling is left with what the reference aliases: below 1 of 255.
    assert errors["matched"] < 1.0
    assert found["matched"].correlation > found["bicubic"].correlation


@pytest.mark.slow
def test_captured_and_simulated_lie_on_one_grid() -> None:
    pair, found = aligned(texture_dn(1.0), texture_dn(1.5))
    assert found.zoom == pytest.approx(1.5, rel=1e-4)
    made = pair.on_followup_grid(inputs("matched"), "matched")
    assert made.followup.shape == made.captured.shape
    # Two thirds of the follow-up's sides show what the reference shows, and half of that is left.
    rows, cols = made.captured.shape
    assert rows == pytest.approx(SHAPE[0] / 1.5 / 2, abs=1)
    assert cols == pytest.approx(SHAPE[1] / 1.5 / 2, abs=1)


@pytest.mark.slow
def test_gain_and_offset_of_the_followup_do_not_count() -> None:
    reference, followup = texture_dn(1.0), texture_dn(1.5)
    plain = agreements(compared(reference, followup, "matched"))
    dimmed = agreements(compared(reference, 0.7 * followup + 90.0, "matched"))
    # The registration fits both; what differs is where its descent stops.
    assert dimmed["matched"].mse_dn2 == pytest.approx(plain["matched"].mse_dn2, rel=0.01)


METRICS = ImageMetrics(
    correlation=0.9, mse_dn2=4.0, nmi=1.2, psnr_db=42.0, ssim=0.8, data_range_dn=255.0
)


def test_the_mean_of_psnr_is_not_the_psnr_of_the_mean() -> None:
    other = METRICS.model_copy(
        update={"correlation": 0.7, "mse_dn2": 16.0, "nmi": 1.4, "psnr_db": 36.0, "ssim": 0.6}
    )
    mean = mean_metrics([METRICS, other])
    assert (mean.correlation, mean.nmi, mean.ssim) == pytest.approx((0.8, 1.3, 0.7))
    assert (mean.mse_dn2, mean.pairs) == (10.0, 2)
    assert mean.psnr_db == 39.0
    assert mean.psnr_of_mean_db == pytest.approx(10 * log10(255**2 / 10))


def test_a_perfect_prediction_has_an_infinite_psnr() -> None:
    mean = mean_metrics([METRICS.model_copy(update={"mse_dn2": 0.0, "psnr_db": inf})])
    assert mean.psnr_of_mean_db == inf


def test_the_mean_of_no_pairs_is_refused() -> None:
    with pytest.raises(ValueError):
        mean_metrics([])


@pytest.mark.slow
def test_the_inputs_are_left_as_they_were() -> None:
    reference, followup = texture_dn(1.0), texture_dn(1.5)
    copies = reference.copy(), followup.copy()
    compared(reference, followup, "matched")
    np.testing.assert_array_equal(reference, copies[0])
    np.testing.assert_array_equal(followup, copies[1])
