"""What is left between a captured and a simulated follow-up, over what is expected to be left.

Expected are the noise of both captures, what the errors of PSF and focus change, what the model
`lmmse` states of itself, and the error of the place to which the two were aligned. All models of a
pair are measured by the same expectation, so that their figures compare.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter

from acquisition.session import CaptureImages
from analysis.validation.pair import AlignedPair
from analysis.validation.processing import crop_centre_half, subtract_background
from calibration.psf import PsfCalibration, focus_scatter_px2, psf_steps
from simulation import PoseOptions, Psf
from simulation.arrays import FloatArray
from simulation.uncertainty import KnownErrors, SimulatedView, pixel_uncertainty

_ROUNDING_DN2 = 1 / 12
_LIGHT_TERMS = 7
"""A gain of second order over the frame, and an offset."""


def noise_variance(capture: CaptureImages) -> FloatArray | None:
    """Variance of each pixel of a capture's mean; None if it has a single frame.

    A straight line over the level, through what the frames scattered: the variance of a few frames
    is itself too uncertain to divide by.
    """
    if capture.variance_dn2 is None:
        return None
    level = np.asarray(capture.mean_dn, dtype=np.float64)
    variance = np.asarray(capture.variance_dn2, dtype=np.float64) / capture.record.frames_used
    slope, start = np.polyfit(level.ravel(), variance.ravel(), 1)
    least = _ROUNDING_DN2 / capture.record.frames_used
    return np.asarray(np.maximum(start + slope * level, least))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairErrors:
    """What is known of the errors of a pair.

    Parameters
    ----------
    reference_dn2, followup_dn2
        Variance of the noise in each pixel of the two captures.
    place_err_px
        Standard error of the place to which the follow-up was aligned, along either axis.
    psf, calibration
        The PSF that is simulated with, and the calibration that states its errors; None if there
        is none.
    """

    reference_dn2: FloatArray
    followup_dn2: FloatArray
    place_err_px: float
    psf: Psf
    calibration: PsfCalibration | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expectation:
    """Expected square of captured minus simulated, in the middle of a pair's window.

    ``captured`` is the window of the captured follow-up, ``variance_dn2`` has the shape of its
    middle half.
    """

    captured: FloatArray = field(repr=False)
    variance_dn2: FloatArray = field(repr=False)

    @classmethod
    def of(cls, pair: AlignedPair, errors: PairErrors) -> "Expectation":
        """Propagate the errors of a pair's inputs to the middle half of its window."""
        window = pair.window
        rows, cols = window.y_px.shape
        top, left = window.rows.start + rows // 4, window.cols.start + cols // 4
        middle = np.s_[top : top + rows // 2, left : left + cols // 2]
        shift = np.array([[1.0, 0.0, left], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
        shape = pair.reference.shape[0], pair.reference.shape[1]
        view = SimulatedView.of_pose(
            shape,
            pair.pose.matrix @ shift,
            (cols // 2, rows // 2),
            PoseOptions(distortion_k1=pair.pose.k1, origin_px=(float(left), float(top))),
        )
        calibration = errors.calibration
        known = KnownErrors(
            noise_dn2=errors.reference_dn2,
            psf_steps=None
            if calibration is None
            else psf_steps(calibration, errors.psf, max(view.zoom, 1.0)),
            focus_scatter_px2=None if calibration is None else focus_scatter_px2(calibration),
        )
        own = pixel_uncertainty(view, pair.reference, errors.psf, known).err
        assert own is not None  # the model states an error of its own
        captured = np.asarray(pair.followup, dtype=np.float64)
        slopes = np.gradient(gaussian_filter(captured, 0.5))
        place = errors.place_err_px**2 * (slopes[0] ** 2 + slopes[1] ** 2)[middle]
        return cls(
            captured=captured[window.rows, window.cols],
            variance_dn2=own**2 + errors.followup_dn2[middle] + place,
        )

    def chi2_reduced(self, made: FloatArray) -> float:
        """Return the mean square of captured minus simulated over what is expected.

        The light of the two is matched by a gain of second order over the window and an offset,
        and what varies slowly is subtracted, as for the metrics.

        Parameters
        ----------
        made
            The simulated follow-up, of the window's shape.
        """
        rows, cols = made.shape
        y, x = np.mgrid[-1.0 : 1.0 : rows * 1j, -1.0 : 1.0 : cols * 1j]
        terms = (np.ones_like(made), x, y, x * x, x * y, y * y)
        design = np.stack([*(made * term for term in terms), terms[0]], axis=-1)
        flat = design.reshape(-1, _LIGHT_TERMS)
        # Levels of thousands and their offset: on a common scale.
        scale = np.linalg.norm(flat, axis=0)
        light = np.linalg.lstsq(flat / scale, self.captured.ravel(), rcond=None)[0] / scale
        left = crop_centre_half(subtract_background(self.captured - design @ light))
        return float(np.mean(left**2 / self.variance_dn2))
