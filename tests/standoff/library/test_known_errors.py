"""What the focus of a calibration's own captures leaves in its PSF, where somebody states it."""

import numpy as np
import pytest

from calibration.psf import PairWidths, PsfCalibration
from standoff.library.detectability import known_errors

SCATTER_PX2 = 0.1
OWN_ERR_PX2 = 0.8 * 0.02 * 2**0.5


def calibration(*pairs: PairWidths) -> PsfCalibration:
    return PsfCalibration.model_validate(
        {
            **{"schema": "standoff.psf/1", "sigma_x_px": 0.8, "sigma_y_px": 0.8, "rho": 0.0},
            **{"sigma_x_err_px": 0.02, "sigma_y_err_px": 0.02, "rho_err": 0.01},
            "estimate_covariance": np.diag([0.02**2, 0.02**2, 1e-4]).tolist(),
            "pairs": [pair.model_dump() for pair in pairs],
        }
    )


def pair(near: str, far: str, zoom: float) -> PairWidths:
    widths = {"sigma_x_px": 0.8, "sigma_x_err_px": 0.02, "sigma_y_px": 0.8, "sigma_y_err_px": 0.02}
    return PairWidths(near=near, far=far, zoom=zoom, **widths)


def whole_err_px2(psf: PsfCalibration, scatter_px2: float | None) -> float | None:
    return known_errors(psf, focus_scatter_px2=scatter_px2).whole_psf_err_px2


def test_where_nothing_is_known_of_the_focus_the_error_is_the_calibrations_own() -> None:
    assert whole_err_px2(calibration(), None) == pytest.approx(OWN_ERR_PX2)


def test_one_capture_has_all_of_the_scatter() -> None:
    assert whole_err_px2(calibration(), SCATTER_PX2) == pytest.approx(
        np.hypot(OWN_ERR_PX2, SCATTER_PX2)
    )


def test_two_distances_have_the_scatter_of_both_photographs() -> None:
    # Worked example: z = 2, the variance is (4 far - near) / 3.
    assert whole_err_px2(calibration(pair("n", "f", 2.0)), SCATTER_PX2) == pytest.approx(
        np.hypot(OWN_ERR_PX2, SCATTER_PX2 * 17**0.5 / 3)
    )


def test_pairs_with_one_near_photograph_share_its_focus() -> None:
    # By drawing: the mean of both pairs' variances, with a focus of each of three photographs.
    near, far, further = np.random.default_rng(3).normal(0.0, SCATTER_PX2, (3, 200_000))
    of_pairs = [(z**2 * f - near) / (z**2 - 1) for z, f in ((1.5, far), (2.5, further))]
    drawn = float(np.std(np.mean(of_pairs, axis=0)))
    psf = calibration(pair("n", "f", 1.5), pair("n", "g", 2.5))
    assert whole_err_px2(psf, SCATTER_PX2) == pytest.approx(np.hypot(OWN_ERR_PX2, drawn), rel=0.01)
