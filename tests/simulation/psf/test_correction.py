"""The pupil's transfer against an integral of its own, its derivatives, and the correction."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from simulation.psf.lens import (
    CORRECTION_KNOTS_CY_PER_PX,
    CORRECTION_SPLINES,
    LensOtf,
    OtfCorrection,
    correction_harmonics,
    correction_roughness,
    correction_splines,
    pupil_otf,
    pupil_slopes,
)
from tests.calibration.lens_edges import pupil_transfer

NU = np.linspace(0.0, 1.2, 61)


@pytest.mark.parametrize("waves", [0.0, 0.3, 1.0, 2.5])
def test_the_pupils_transfer_is_hopkins_integral(waves: float) -> None:
    np.testing.assert_allclose(pupil_otf(NU, waves), pupil_transfer(NU, waves), atol=1e-8)


@pytest.mark.parametrize("waves", [0.0, 0.3, 1.0, 2.0, 5.0])
def test_the_slopes_are_differences_of_the_transfer(waves: float) -> None:
    slopes = pupil_slopes(NU, np.array([waves**2]))
    np.testing.assert_allclose(slopes.otf, pupil_otf(NU, waves), atol=3e-5)
    # At 0 and at the cut-off the curve has a corner or a half power: differences straddle it.
    inner = (NU > 0.01) & (abs(NU - 1) > 0.01)
    step = 1e-4
    by_freq = (pupil_otf(NU + step, waves) - pupil_otf(abs(NU - step), waves)) / (2 * step)
    np.testing.assert_allclose(slopes.by_freq[inner], by_freq[inner], atol=1e-3)
    above, below = waves**2 + step, max(waves**2 - step, 0.0)
    change = pupil_otf(NU, float(np.sqrt(above))) - pupil_otf(NU, float(np.sqrt(below)))
    by_defocus = change / (above - below)
    # One-sided at 0, where the second derivative is of the order of 10: hence 1e-3.
    np.testing.assert_allclose(slopes.by_defocus_waves2, by_defocus, atol=1e-3)


coefficients = st.lists(
    st.lists(st.floats(-1, 1), min_size=CORRECTION_SPLINES, max_size=CORRECTION_SPLINES),
    min_size=1,
    max_size=5,
).filter(lambda rows: len(rows) in (1, 3, 5))


@settings(max_examples=50)
@given(rows=coefficients, fx=st.floats(-2, 2), fy=st.floats(-2, 2))
def test_a_correction_is_even_and_nothing_at_0_and_beyond_the_last_knot(
    rows: list[list[float]], fx: float, fy: float
) -> None:
    lens = LensOtf(correction=OtfCorrection(coefficients=tuple(tuple(row) for row in rows)))
    x, y = np.array([fx, -fx, 0.0, 1.3]), np.array([fy, -fy, 0.0, 0.2])
    there, mirrored, at_zero, beyond = lens(x, y).tolist()
    assert there == pytest.approx(mirrored, abs=1e-12)
    assert at_zero == 1.0
    assert beyond == 1.0


def test_the_roughness_is_the_integral_of_the_squared_second_derivative() -> None:
    freq = np.linspace(0.0, 1.3, 13_001)
    weights = np.sin(np.arange(CORRECTION_SPLINES))
    curve = correction_splines(freq) @ weights
    bend = np.diff(curve, 2) / np.diff(freq)[0] ** 2
    expected = np.sum(bend**2) * np.diff(freq)[0]
    assert weights @ correction_roughness() @ weights == pytest.approx(
        expected, rel=3e-3
    )  # a sum of 13 000 steps


def test_the_splines_reach_the_last_knot_smoothly() -> None:
    end = float(CORRECTION_KNOTS_CY_PER_PX[-1])
    near = correction_splines(np.array([end - 1e-3]))
    assert np.abs(near).max() < 1e-6  # the cube of 1e-3 / 0.1


def test_harmonics_are_of_even_order() -> None:
    angle = np.array([0.3, 0.3 + np.pi])
    first, turned = correction_harmonics(angle, 5)
    np.testing.assert_allclose(first, turned, atol=1e-14)
    assert first[[1, 4]].tolist() == pytest.approx([np.cos(0.6), np.sin(1.2)])


@pytest.mark.parametrize(
    "rows", [((0.0,) * CORRECTION_SPLINES,) * 2, ((0.0,) * 3,), ((np.nan,) * CORRECTION_SPLINES,)]
)
def test_a_correction_that_cannot_be_is_refused(rows: tuple[tuple[float, ...], ...]) -> None:
    with pytest.raises(ValueError, match="correction"):
        OtfCorrection(coefficients=rows)
