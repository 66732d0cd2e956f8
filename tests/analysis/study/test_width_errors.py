"""Errors of the PSF's widths, against closed forms and against the calibration's own errors."""

from math import sqrt

import numpy as np
import pytest

from analysis.study import sigma_err_px, width_errors
from calibration.psf import fit_covariance
from tests.analysis.study.sessions import LEVELS, covariance, planned

SIGMA_PX = 0.8
ROUND = covariance(SIGMA_PX, SIGMA_PX)


def test_equal_edges_across_one_axis_average() -> None:
    errors = width_errors(planned([90.0] * 9), ROUND)
    alone = sigma_err_px(SIGMA_PX, 100.0, LEVELS, 4)
    assert sqrt(errors.total[0, 0]) == pytest.approx(alone / 3)
    assert errors.is_determined == (True, False, False)


def test_the_errors_are_those_that_the_calibration_gives_to_such_edges() -> None:
    angles, psf = [5.0, 50.0, 95.0, 140.0, 20.0], covariance(0.9, 0.7, 0.2)
    session = planned(angles)
    errors = width_errors(session, psf)
    fit = fit_covariance(np.array(angles), session.widths_px(psf), session.width_errs_px(psf))
    assert fit.estimate_covariance is not None
    np.testing.assert_allclose(errors.total, fit.estimate_covariance, rtol=1e-6)
    assert errors.is_determined == (True, True, True)


def test_the_focus_of_captures_averages_over_captures_and_not_over_edges() -> None:
    # A change of the variance by s moves a width by s / (2 sigma).
    by_capture = 0.02 / (2 * SIGMA_PX)
    apart = width_errors(planned([90.0] * 8, focus_scatter_px2=0.02), ROUND)
    together = width_errors(planned([90.0] * 8, per_capture=4, focus_scatter_px2=0.02), ROUND)
    assert sqrt(apart.focus[0, 0]) == pytest.approx(by_capture / sqrt(8))
    assert sqrt(together.focus[0, 0]) == pytest.approx(by_capture / sqrt(2))


def test_two_directions_give_no_correlation() -> None:
    errors = width_errors(planned([0.0, 90.0, 90.0]), covariance(0.9, 0.7))
    assert errors.is_determined == (True, True, False)
    assert errors.total[2, 2] == 0
    assert errors.total[0, 1] == pytest.approx(0, abs=1e-20)
