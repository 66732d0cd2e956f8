"""Errors of the transfer at one frequency, against those of the widths of a Gaussian."""

from dataclasses import replace
from math import exp, pi, sqrt

import numpy as np
import pytest

from analysis.study import KnownTransfer, TransferModel, transfer_errors, width_errors
from tests.analysis.study.sessions import covariance, planned

FREQ = 0.25
SIGMA_PX = 0.8
VALUE = exp(-2 * (pi * FREQ * SIGMA_PX) ** 2)
PSF = covariance(SIGMA_PX, SIGMA_PX)
ROUND = TransferModel.of_gaussian(PSF)
FAN = [2.0, 47.0, 92.0, 137.0]


def test_a_gaussian_passes_on_the_error_of_its_width() -> None:
    session = planned(FAN)
    found = transfer_errors(session, ROUND, (FREQ, 0.0), PSF)
    assert found.value == pytest.approx(VALUE)
    assert found.pixels is not None
    widths = width_errors(session, PSF)
    by_sigma = VALUE * (2 * pi * FREQ) ** 2 * SIGMA_PX * sqrt(widths.pixels[0, 0])
    # The band for the transfer is wider than that for the width: the levels cost less there.
    assert sqrt(found.pixels) == pytest.approx(by_sigma, rel=0.06)
    assert sqrt(found.pixels) < by_sigma


def test_the_focus_shifts_it_as_a_gaussian_of_its_variance() -> None:
    found = transfer_errors(planned([*FAN, *FAN], focus_scatter_px2=0.03), ROUND, (FREQ, 0.0), PSF)
    assert found.focus is not None
    # Common to all captures it is 2 pi^2 f^2 H s; of the 8 here, each direction has two.
    common = 2 * (pi * FREQ) ** 2 * VALUE * 0.03
    assert common / sqrt(8) < sqrt(found.focus) < common / sqrt(2)
    together = planned([*FAN, *FAN], per_capture=8, focus_scatter_px2=0.03)
    of_one = transfer_errors(together, ROUND, (FREQ, 0.0), PSF).focus
    assert of_one is not None
    assert sqrt(of_one) == pytest.approx(common, rel=1e-3)


def test_one_direction_does_not_determine_it() -> None:
    assert transfer_errors(planned([90.0, 90.0]), ROUND, (FREQ, 0.0), PSF).pixels is None


def test_a_form_with_fitted_smoothness_scales_the_errors_that_are_known() -> None:
    before, planned_edges = planned(FAN), planned([*FAN, *FAN], focus_scatter_px2=0.03)
    known = KnownTransfer(
        err=lambda fx, fy: np.full_like(fx + fy, 0.01),
        scatter=2.25,
        information_per_px2=float(np.sum(before.width_errs_px(PSF) ** -2.0)),
    )
    found = transfer_errors(planned_edges, replace(ROUND, known=known), (FREQ, 0.0), PSF)
    assert found.pixels is not None
    assert found.focus is not None
    # Twice the edges halve the variance; the scatter between edges is not of the pixels.
    assert found.pixels == pytest.approx(0.01**2 / 2.25 / 2)
    assert sqrt(found.focus) == pytest.approx(2 * (pi * FREQ) ** 2 * VALUE * 0.03 / sqrt(8))
