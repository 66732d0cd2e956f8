"""What calibrations say of their own errors, for the interval of a d'."""

from math import sqrt
from os import PathLike
from pathlib import Path

import numpy as np

from analysis.detectability import STATED, ErrorSources, student_factor
from calibration.files import read_noise
from calibration.noise import NoiseCalibration
from calibration.psf import PsfCalibration, capture_of
from simulation.arrays import FloatArray
from standoff.library.inputs import NoiseLike, PsfLike
from standoff.library.psf import calibration_of


def known_errors(
    psf: PsfLike | None,
    *,
    focus_scatter_px2: float | None = None,
    registration_err_px: float | None = None,
) -> ErrorSources:
    """Return what is known of the errors of a camera.

    Parameters
    ----------
    psf
        A calibration, or the path of one, says how sure it is and how its captures scattered; a
        bare PSF says nothing.
    focus_scatter_px2, registration_err_px
        As stated; the scatter instead of the calibration's. It holds for the captures of a
        calibration that cannot tell it as well.

    Returns
    -------
    ErrorSources
        With a noise that is taken as stated; that of a noise.json has an error of its own.
    """
    stored = None if psf is None else calibration_of(psf)
    variance_err_px2: float | None = None
    psf_focus_share = 0.0
    freedom: float | None = None
    focus_from = None if focus_scatter_px2 is None else STATED
    if stored is not None:
        variance_err_px2 = _variance_err_px2(stored)
        psf_focus_share = _focus_share(stored)
        focus = stored.focus
        if focus_scatter_px2 is None and focus is not None:
            focus_scatter_px2 = focus.scatter_px2
            focus_from = f"{focus.captures} captures of the calibration"
            freedom = focus.freedom or focus.captures - 1
    return ErrorSources(
        psf_variance_err_px2=variance_err_px2,
        psf_focus_share=psf_focus_share,
        focus_scatter_px2=focus_scatter_px2,
        focus_from=focus_from,
        focus_freedom=freedom,
        noise_relative_err=0.0,
        registration_err_px=registration_err_px,
    )


def noise_relative_err(noise: NoiseLike, levels_dn: FloatArray) -> float | None:
    """Return the standard error of a camera's noise at levels, over that noise; None if unknown.

    Parameters
    ----------
    noise
        A noise.json, or what it says; a bare noise does not know its errors.
    levels_dn
        Mean levels of the photographs.
    """
    known = read_noise(Path(noise)) if isinstance(noise, str | PathLike) else noise
    return known.relative_err(levels_dn) if isinstance(known, NoiseCalibration) else None


def _variance_err_px2(psf: PsfCalibration) -> float | None:
    """Standard error of the mean of the variances along x and y, as normal quantiles need it."""
    widths = psf.sigma_x_px, psf.sigma_y_px
    if widths[0] is None or widths[1] is None or psf.estimate_covariance is None:
        return None
    slope = np.array(widths, dtype=np.float64)
    among = np.array(psf.estimate_covariance)[:2, :2]
    variance_px4 = max(float(slope @ among @ slope), 0.0)
    if psf.focus is not None:
        # The part that captures share is known with as many degrees of freedom as there are.
        shared_px4 = min(psf.focus.mean_err_px2**2, variance_px4)
        freedom = psf.focus.freedom or psf.focus.captures - 1
        variance_px4 += shared_px4 * (student_factor(freedom) ** 2 - 1)
    return sqrt(variance_px4)


def _focus_share(psf: PsfCalibration) -> float:
    """Standard error of the PSF's variance by the focus of its captures, over their scatter.

    Of two distances the mean variance is ``(z^2 far - near) / (z^2 - 1)``, and focus adds to both.
    """
    if psf.focus is not None:
        return 0.0
    if not psf.pairs:
        return 1 / sqrt(max(len({capture_of(edge) for edge in psf.edges_used}), 1))
    of_photograph: dict[str, float] = {}
    for pair in psf.pairs:
        z2 = pair.zoom**2
        for name, share in ((pair.far, z2 / (z2 - 1)), (pair.near, -1 / (z2 - 1))):
            of_photograph[name] = of_photograph.get(name, 0.0) + share / len(psf.pairs)
    return sqrt(sum(share**2 for share in of_photograph.values()))
