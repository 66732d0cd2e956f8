"""Predicted errors of edges, against closed forms, and against fits and sessions carried out."""

from dataclasses import replace
from math import exp, pi, sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import ndtr

import standoff
from analysis.study import (
    EdgeLevels,
    KnownTransfer,
    TransferModel,
    sigma_err_px,
    transfer_errors,
    white_noise_sigma_err_px,
    width_errors,
)
from benchmarks.truth.study_sessions import StudiedSession, calibrated
from calibration.edges import EdgeImage, edges_of_image
from calibration.noise import LevelNoise
from calibration.psf import _calibration, fit_covariance
from tests.analysis.study.sessions import LEVELS, covariance, planned


def white(noise_dn: float) -> LevelNoise:
    """The same noise at all levels."""
    return LevelNoise(offset_dn2=noise_dn**2, slope_dn=0.0, floor_dn2=noise_dn**2)


def levels(noise: LevelNoise) -> EdgeLevels:
    return EdgeLevels(low_dn=100.0, high_dn=2100.0, frame_noise=noise)


@pytest.mark.parametrize("sigma_px", [0.5, 0.8, 1.5])
def test_white_noise_gives_the_closed_form_within_what_the_levels_cost(sigma_px: float) -> None:
    found = sigma_err_px(sigma_px, 200.0, levels(white(40.0)), 4)
    closed = white_noise_sigma_err_px(sigma_px, 200.0, snr=2000.0 / 20.0)
    # The two levels share the band of 4 sigma and 5 px or so with the rise: some per cent.
    assert closed < found < 1.12 * closed


@given(st.floats(0.4, 4.0), st.floats(20.0, 900.0), st.integers(2, 400))
def test_four_times_the_frames_or_the_length_halve_the_error(
    sigma_px: float, length_px: float, frames: int
) -> None:
    noise = LevelNoise(offset_dn2=5.0, slope_dn=0.2, floor_dn2=2.0)
    once = sigma_err_px(sigma_px, length_px, levels(noise), frames)
    assert sigma_err_px(sigma_px, length_px, levels(noise), 4 * frames) == pytest.approx(once / 2)
    assert sigma_err_px(sigma_px, 4 * length_px, levels(noise), frames) == pytest.approx(once / 2)


@given(st.floats(0.4, 3.0), st.floats(0.5, 80.0))
def test_the_unit_of_the_levels_does_not_matter(sigma_px: float, factor: float) -> None:
    noise = LevelNoise(offset_dn2=30.0, slope_dn=0.3, floor_dn2=4.0)
    scaled = EdgeLevels(
        low_dn=100.0 * factor,
        high_dn=2100.0 * factor,
        frame_noise=LevelNoise(
            offset_dn2=30.0 * factor**2, slope_dn=0.3 * factor, floor_dn2=4.0 * factor**2
        ),
    )
    assert sigma_err_px(sigma_px, 90.0, scaled, 3) == pytest.approx(
        sigma_err_px(sigma_px, 90.0, levels(noise), 3)
    )


def test_levels_that_do_not_rise_are_refused() -> None:
    with pytest.raises(ValueError, match="must rise"):
        EdgeLevels(low_dn=10.0, high_dn=10.0, frame_noise=white(1.0))


def test_an_edge_fit_reports_the_error_that_was_predicted() -> None:
    sigma_px, noise = 0.7, LevelNoise(offset_dn2=-10.0, slope_dn=0.2, floor_dn2=6.0)
    y, x = np.mgrid[-50.0:50.0, -60.0:60.0]
    turn = np.deg2rad(8.0)
    edge = ndtr((x * np.cos(turn) + y * np.sin(turn)) / sigma_px)
    clean = 100.0 + 2000.0 * edge
    drawn = np.random.default_rng(4).normal(size=clean.shape)
    image = clean + drawn * np.sqrt(noise.variance_dn2(clean) / 5)
    photograph = EdgeImage(
        name="edge", image_dn=image, noise=noise.averaged(5), saturation_dn=4095.0
    )
    (found,) = edges_of_image(photograph)
    predicted = sigma_err_px(sigma_px, found.length_px, levels(noise), 5)
    # The fit scales its error by the scatter of 2000 pixels, known to 1 / sqrt(4000), 1.6 %.
    assert found.sigma_err_px == pytest.approx(predicted, rel=0.08)
    assert abs(found.sigma_px - sigma_px) < 4 * predicted


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


FREQ = 0.25
VALUE = exp(-2 * (pi * FREQ * SIGMA_PX) ** 2)
PSF = covariance(SIGMA_PX, SIGMA_PX)
ROUND_TRANSFER = TransferModel.of_gaussian(PSF)
FAN = [2.0, 47.0, 92.0, 137.0]


def test_a_gaussian_passes_on_the_error_of_its_width() -> None:
    session = planned(FAN)
    found = transfer_errors(session, ROUND_TRANSFER, (FREQ, 0.0), PSF)
    assert found.value == pytest.approx(VALUE)
    assert found.pixels is not None
    widths = width_errors(session, PSF)
    by_sigma = VALUE * (2 * pi * FREQ) ** 2 * SIGMA_PX * sqrt(widths.pixels[0, 0])
    # The band for the transfer is wider than that for the width: the levels cost less there.
    assert sqrt(found.pixels) == pytest.approx(by_sigma, rel=0.06)
    assert sqrt(found.pixels) < by_sigma


def test_the_focus_shifts_it_as_a_gaussian_of_its_variance() -> None:
    found = transfer_errors(
        planned([*FAN, *FAN], focus_scatter_px2=0.03), ROUND_TRANSFER, (FREQ, 0.0), PSF
    )
    assert found.focus is not None
    # Common to all captures it is 2 pi^2 f^2 H s; of the 8 here, each direction has two.
    common = 2 * (pi * FREQ) ** 2 * VALUE * 0.03
    assert common / sqrt(8) < sqrt(found.focus) < common / sqrt(2)
    together = planned([*FAN, *FAN], per_capture=8, focus_scatter_px2=0.03)
    of_one = transfer_errors(together, ROUND_TRANSFER, (FREQ, 0.0), PSF).focus
    assert of_one is not None
    assert sqrt(of_one) == pytest.approx(common, rel=1e-3)


def test_one_direction_does_not_determine_it() -> None:
    assert transfer_errors(planned([90.0, 90.0]), ROUND_TRANSFER, (FREQ, 0.0), PSF).pixels is None


def test_a_form_with_fitted_smoothness_scales_the_errors_that_are_known() -> None:
    before, planned_edges = planned(FAN), planned([*FAN, *FAN], focus_scatter_px2=0.03)
    known = KnownTransfer(
        err=lambda fx, fy: np.full_like(fx + fy, 0.01),
        scatter=2.25,
        information_per_px2=float(np.sum(before.width_errs_px(PSF) ** -2.0)),
    )
    found = transfer_errors(planned_edges, replace(ROUND_TRANSFER, known=known), (FREQ, 0.0), PSF)
    assert found.pixels is not None
    assert found.focus is not None
    # Twice the edges halve the variance; the scatter between edges is not of the pixels.
    assert found.pixels == pytest.approx(0.01**2 / 2.25 / 2)
    assert sqrt(found.focus) == pytest.approx(2 * (pi * FREQ) ** 2 * VALUE * 0.03 / sqrt(8))


REPETITIONS = 30
# A scatter of 30 results is known to 1 / sqrt(60), 13 %: three and a half times that.
WITHIN = 1.5


@pytest.mark.slow
@pytest.mark.parametrize("focus_scatter_px2", [0.0, 0.02])
def test_sigma_scatters_as_predicted(
    focus_scatter_px2: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = StudiedSession(
        name="small",
        plan={
            "frames_per_capture": 3,
            "targets": [
                {
                    "kind": "edge",
                    "target": "edge",
                    "orientations_deg": [6.0, 48.0, 96.0, 138.0],
                    "heights_mm": [250.0],
                }
            ],
        },
        bench={"width_px": 72, "height_px": 64},
        exposure_us=2000.0,
        focus_scatter_px2=focus_scatter_px2,
    )
    rng = np.random.default_rng(8)
    study = standoff.plan_study(
        session.capture_plan,
        session.config,
        calibrated(session, rng),
        focus_scatter_px2=focus_scatter_px2,
    )
    # The widths alone are looked at; what of the transfer takes most of the time is left out.
    monkeypatch.setattr(_calibration, "_transfer_2d", lambda *_: None)
    widths = [calibrated(session, rng).sigma_x_px for _ in range(REPETITIONS)]
    ratio = (study.of("sigma_x_px").err or 0.0) / float(np.std(np.array(widths), ddof=1))
    assert 1 / WITHIN < ratio < WITHIN
