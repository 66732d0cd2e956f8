from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.geometry.pupil import HEIGHT_FLOOR_MM, SeriesDistances, fit_pupil, height_outlier
from simulation.arrays import FloatArray

HEIGHTS = np.array([180.0, 220.0, 275.0, 340.0, 430.0, 500.0])


def distances(
    heights_mm: FloatArray,
    log_distances: FloatArray,
    series: Sequence[int] | None = None,
    covariance: FloatArray | None = None,
) -> SeriesDistances:
    """One series, good to 1e-5, unless it is said."""
    count = len(heights_mm)
    return SeriesDistances(
        heights_mm=heights_mm,
        series=np.array([0] * count if series is None else series),
        log_distances=log_distances,
        covariance=np.eye(count) * 1e-10 if covariance is None else covariance,
    )


def test_two_heights_give_the_pupil_in_closed_form() -> None:
    # z = (h2 + p) / (h1 + p) = 1.5 with heights 100 and 160: p = (160 - 150) / 0.5 = 20.
    fit = fit_pupil(
        distances(np.array([100.0, 160.0]), np.log([1.0, 1.5]), covariance=np.diag([0.0, 1e-8]))
    )
    assert fit.pupil_offset_mm == pytest.approx(20.0, abs=1e-9)
    # dp = (h1 + p)^2 / (h2 - h1) dz = 240 * 1.5e-4, and the heights' floor on both.
    assert fit.pupil_offset_err_mm == pytest.approx(240 * 1.5e-4, rel=0.01)
    assert fit.degrees_of_freedom == 0
    assert fit.zoom(100.0, 160.0)[0] == pytest.approx(1.5, abs=1e-9)


@given(
    pupil=st.floats(-50, 80),
    unit=st.floats(-5, 5),
    shift=st.floats(-30, 30),
    order=st.permutations(range(len(HEIGHTS))),
)
def test_units_order_and_height_zero_do_not_matter(
    pupil: float, unit: float, shift: float, order: list[int]
) -> None:
    rng = np.random.default_rng(0)
    wobble = rng.normal(0, 1e-5, len(HEIGHTS))
    log_distances = np.log(HEIGHTS + pupil) + wobble
    first = fit_pupil(distances(HEIGHTS, log_distances))
    second = fit_pupil(distances((HEIGHTS + shift)[order], (log_distances + unit)[order]))
    assert second.pupil_offset_mm + shift == pytest.approx(first.pupil_offset_mm, abs=1e-6)
    assert second.pupil_offset_err_mm == pytest.approx(first.pupil_offset_err_mm, rel=1e-3)


def test_heights_that_scatter_get_an_error_of_their_own() -> None:
    rng = np.random.default_rng(1)
    within, scatters = 0, []
    for _ in range(100):
        read = HEIGHTS + rng.normal(0, 0.05, len(HEIGHTS))
        fit = fit_pupil(distances(read, np.log(HEIGHTS + 12.5)))
        scatters.append(fit.scatter_mm)
        reach = fit.interval_factor * fit.pupil_offset_err_mm
        within += abs(fit.pupil_offset_mm - 12.5) < reach
    # Four degrees of freedom: the rms of the scatters is right to 0.05 / sqrt(8 * 100).
    assert np.sqrt(np.mean(np.square(scatters))) == pytest.approx(0.05, rel=0.1)
    assert within / 100 == pytest.approx(0.95, abs=0.06)


def test_exact_heights_get_the_floor() -> None:
    fit = fit_pupil(distances(HEIGHTS, np.log(HEIGHTS + 12.5)))
    assert fit.scatter_mm == HEIGHT_FLOOR_MM
    assert fit.pupil_offset_mm == pytest.approx(12.5, abs=1e-6)


@pytest.mark.parametrize("bad", [0, 2, 5])
def test_a_height_that_was_not_reached_is_found(bad: int) -> None:
    rng = np.random.default_rng(2)
    log_distances = np.log(HEIGHTS + 12.5) + rng.normal(0, 1e-5, 6)
    read = HEIGHTS.copy()
    read[bad] += 0.4
    found = height_outlier(distances(read, log_distances))
    assert found is not None
    assert found[0] == bad
    assert found[1] == pytest.approx(HEIGHTS[bad], abs=0.05)


def test_consistent_heights_have_no_outlier() -> None:
    rng = np.random.default_rng(3)
    for _ in range(15):
        read = HEIGHTS + rng.normal(0, 0.02, 6)
        assert height_outlier(distances(read, np.log(HEIGHTS + 12.5))) is None


def test_two_series_share_the_pupil_and_not_the_unit() -> None:
    heights = np.concatenate([HEIGHTS, HEIGHTS[:3]])
    logs = np.concatenate([np.log(HEIGHTS + 12.5) + 1.0, np.log(HEIGHTS[:3] + 12.5) - 2.0])
    fit = fit_pupil(distances(heights, logs, [0] * 6 + [1] * 3))
    assert fit.pupil_offset_mm == pytest.approx(12.5, abs=1e-6)
    np.testing.assert_allclose(fit.log_units, [1.0, -2.0], atol=1e-8)


def test_a_stage_that_counts_downwards_is_refused() -> None:
    with pytest.raises(ValueError):
        fit_pupil(distances(HEIGHTS, -np.log(HEIGHTS)))
