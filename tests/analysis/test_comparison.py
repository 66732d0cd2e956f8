from dataclasses import replace
from math import inf, log10

import numpy as np
import pytest

from analysis.comparison import compare_pair, mean_metrics
from analysis.errors import AnalysisError
from analysis.validation.metrics import ImageMetrics
from tests.analysis.bench_session import PSF, SHAPE, texture_dn


@pytest.mark.parametrize("zoom", [1.5, 2.0])
def test_the_better_the_physics_the_smaller_the_error(zoom: float) -> None:
    pair = compare_pair(texture_dn(1.0), texture_dn(zoom), PSF)
    errors = {model: metrics.mse_dn2 for model, metrics in pair.metrics.items()}
    assert errors["matched"] < errors["paper"] < errors["bicubic"]
    # Without noise matched sampling is left with what the reference aliases: below 1 of 255.
    assert errors["matched"] < 1.0
    assert pair.metrics["matched"].correlation > pair.metrics["bicubic"].correlation
    assert pair.registration.zoom == pytest.approx(zoom, rel=1e-4)


def test_captured_and_simulated_lie_on_one_grid() -> None:
    pair = compare_pair(texture_dn(1.0), texture_dn(1.5), PSF, models=("matched",))
    assert list(pair.simulated) == ["matched"]
    assert pair.simulated["matched"].shape == pair.captured.shape
    # Two thirds of the follow-up's sides show what the reference shows, and half of that is left.
    rows, cols = pair.captured.shape
    assert rows == pytest.approx(SHAPE[0] / 1.5 / 2, abs=1)
    assert cols == pytest.approx(SHAPE[1] / 1.5 / 2, abs=1)


def test_gain_and_offset_of_the_followup_do_not_count() -> None:
    reference, followup = texture_dn(1.0), texture_dn(1.5)
    plain = compare_pair(reference, followup, PSF, models=("matched",))
    dimmed = compare_pair(reference, 0.7 * followup + 90.0, PSF, models=("matched",))
    # The registration fits both; what differs is where its descent stops.
    assert dimmed.metrics["matched"].mse_dn2 == pytest.approx(
        plain.metrics["matched"].mse_dn2, rel=0.01
    )


def test_a_pair_of_different_targets_is_refused_with_a_reason() -> None:
    with pytest.raises(AnalysisError, match="the captures cannot be aligned: "):
        compare_pair(texture_dn(1.0), texture_dn(1.5, seed=77), PSF)


def test_a_followup_that_is_nearer_is_refused_with_a_reason() -> None:
    with pytest.raises(AnalysisError, match="nearer than the reference"):
        compare_pair(texture_dn(1.5), texture_dn(1.0), PSF)


METRICS = ImageMetrics(
    correlation=0.9, mse_dn2=4.0, nmi=1.2, psnr_db=42.0, ssim=0.8, data_range_dn=255.0
)


def test_the_mean_of_psnr_is_not_the_psnr_of_the_mean() -> None:
    other = replace(METRICS, correlation=0.7, mse_dn2=16.0, nmi=1.4, psnr_db=36.0, ssim=0.6)
    mean = mean_metrics([METRICS, other])
    assert (mean.correlation, mean.nmi, mean.ssim) == pytest.approx((0.8, 1.3, 0.7))
    assert (mean.mse_dn2, mean.pairs) == (10.0, 2)
    assert mean.psnr_db == 39.0
    assert mean.psnr_of_mean_db == pytest.approx(10 * log10(255**2 / 10))


def test_a_perfect_prediction_has_an_infinite_psnr() -> None:
    mean = mean_metrics([replace(METRICS, mse_dn2=0.0, psnr_db=inf)])
    assert mean.psnr_of_mean_db == inf


def test_the_mean_of_no_pairs_is_refused() -> None:
    with pytest.raises(ValueError, match="no pairs"):
        mean_metrics([])


def test_the_inputs_are_left_as_they_were() -> None:
    reference, followup = texture_dn(1.0), texture_dn(1.5)
    copies = reference.copy(), followup.copy()
    compare_pair(reference, followup, PSF, models=("matched",))
    np.testing.assert_array_equal(reference, copies[0])
    np.testing.assert_array_equal(followup, copies[1])
