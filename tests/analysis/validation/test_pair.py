from math import inf, log10

import numpy as np
import pytest

from analysis.choices import ValidationModel
from analysis.validation.metrics import ImageMetrics
from analysis.validation.models import ModelInputs
from analysis.validation.pair import AlignedPair, PairMetrics, compare_pair
from analysis.validation.session import mean_metrics
from calibration.registration import Registration, register
from simulation import MODELS
from tests.analysis.bench_session import PSF, SHAPE, texture_dn


def inputs(*models: ValidationModel) -> ModelInputs:
    return ModelInputs(psf=PSF, kernels=dict.fromkeys(models or MODELS))


def aligned(reference: np.ndarray, followup: np.ndarray) -> tuple[AlignedPair, Registration]:
    found = register(reference, followup, PSF)
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
