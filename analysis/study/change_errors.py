"""What the errors of a study become in d' and in the allowed tilt.

Both follow from the PSF, the noise and the photographs of the scene. Their slopes are finite
differences of the curves that ``analysis.detectability`` computes; what the choice of photographs
leaves is the interval of those curves, which shrinks with the root of their number.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log, sqrt

import numpy as np

from analysis.detectability import DetectabilityCurve, DetectionTask, GaussianSignal, d_prime_curves
from analysis.errors import NotDetectableError
from analysis.pose import ViewingCamera, pose_limits
from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf, Psf

STUDIED_ZOOM = 1.5
"""Zoom of the d' that a study states."""

_ZOOMS = (1.0, 1.01, 1.1, 1.2, 1.35, STUDIED_ZOOM, 1.75, 2.0, 2.5)
_AT = _ZOOMS.index(STUDIED_ZOOM)
_CROP_PX = 256
_STEP = 0.01
_FOR_SLOPES = 6  # photographs: slopes differ little from one to the next
_INTERVAL_SIGMAS = 3.92
"""Standard errors from end to end of a 95 % interval."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudiedScene:
    """Scene, change and camera of the d' that is asked for.

    Parameters
    ----------
    photographs
        Levels, shape ``(rows, cols)`` each.
    planned_count
        Number of photographs of the scene that will be taken.
    noise_dn, noise_relative_err
        Noise of a pixel of either photograph, and how well it is known.
    contrast_dn, signal_sigma_px
        Peak and width of the change.
    min_d_prime
        Threshold of the allowed tilt.
    camera
        The camera; None where its frame is not known.
    """

    photographs: tuple[FloatArray, ...]
    planned_count: int
    noise_dn: float
    noise_relative_err: float
    contrast_dn: float
    signal_sigma_px: float
    min_d_prime: float
    camera: ViewingCamera | None

    @property
    def crops(self) -> list[FloatArray]:
        """The middle of each photograph, at most 256 px wide and high."""
        found = []
        for image in self.photographs:
            top, left = (max(size - _CROP_PX, 0) // 2 for size in image.shape)
            found.append(image[top : top + _CROP_PX, left : left + _CROP_PX])
        return found

    def curve(self, psf: Psf) -> DetectabilityCurve:
        """Curve of d' against zoom, of the ideal linear observer."""
        return self._curves(self.crops, psf, 1.0)[0]

    def slope_curves(self, psf: Psf, *noise_factors: float) -> list[DetectabilityCurve]:
        """Curves of a few of the photographs, by factors on the noise: enough for slopes."""
        return self._curves(self.crops[:_FOR_SLOPES], psf, *noise_factors)

    def _curves(
        self, crops: list[FloatArray], psf: Psf, *noise_factors: float
    ) -> list[DetectabilityCurve]:
        task = DetectionTask(
            signal=GaussianSignal(sigma_px=self.signal_sigma_px),
            contrasts_dn=(self.contrast_dn,),
            noises_dn=tuple(self.noise_dn * factor for factor in noise_factors),
            zooms=_ZOOMS,
            models=("matched",),
            observers=("hotelling",),
        )
        return d_prime_curves(crops, psf, task).curves

    def tilt_deg(self, curve: DetectabilityCurve, min_d_prime: float) -> float | None:
        """Largest tilt with a d' of at least this; None where nothing in the curve limits it."""
        if self.camera is None:
            return None
        try:
            found = pose_limits(curve, min_d_prime, self.camera)
        except NotDetectableError:
            return None
        return None if found.is_zoom_beyond_curve else found.tilt_deg


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity:
    """A value, and how it changes: by the widths and the correlation, the noise, the scene.

    ``by_widths`` are derivatives by sigma_x_px, sigma_y_px and rho; ``by_log_noise`` is that by the
    logarithm of the noise. ``scene_err`` is the standard error that the planned photographs leave.
    """

    value: float
    by_widths: FloatArray
    by_log_noise: float
    scene_err: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChangeSensitivities:
    """Sensitivities of d' at the studied zoom and of the allowed tilt in degrees.

    ``by_log_sigma`` and ``by_log_noise`` are derivatives of the logarithm of d', of both widths
    together and of the noise.
    """

    d_prime: Sensitivity
    tilt_deg: Sensitivity | None
    by_log_sigma: float
    by_log_noise: float


def change_sensitivities(
    scene: StudiedScene, psf: Psf, gaussian: GaussianPsf
) -> ChangeSensitivities:
    """Compute the sensitivities.

    Parameters
    ----------
    scene
        The scene and the change.
    psf
        Total PSF as measured, for the values.
    gaussian
        The Gaussian nearest to it, for the slopes.
    """
    best = scene.curve(psf)
    middle, noisier = scene.slope_curves(gaussian, 1.0, 1 + _STEP)
    widths = np.array([gaussian.sigma_x_px, gaussian.sigma_y_px, gaussian.rho])
    steps = np.array([_STEP * widths[0], _STEP * widths[1], _STEP])
    moved: list[DetectabilityCurve] = []
    for number in range(3):
        values = widths.copy()
        values[number] += steps[number] if number < 2 or widths[2] < 0.5 else -steps[number]
        steps[number] = values[number] - widths[number]
        moved += scene.slope_curves(_gaussian(values), 1.0)
    # Slopes of the Gaussian are taken relative to its own value.
    value, own = best.dprime[_AT], middle.dprime[_AT]
    by_widths = np.array([one.dprime[_AT] - own for one in moved]) / steps * value / own
    by_log_noise = (noisier.dprime[_AT] / own - 1) / log(1 + _STEP)
    scene_err = _relative_scene_errs(scene, best)
    return ChangeSensitivities(
        d_prime=Sensitivity(
            value=value,
            by_widths=by_widths,
            by_log_noise=by_log_noise * value,
            scene_err=value * float(scene_err[_AT]),
        ),
        tilt_deg=_tilt(scene, (best, middle, noisier), moved, steps),
        by_log_sigma=float(by_widths[:2] @ widths[:2]) / value,
        by_log_noise=by_log_noise,
    )


def _gaussian(values: FloatArray) -> GaussianPsf:
    x, y, rho = values.tolist()
    return GaussianPsf(sigma_x_px=x, sigma_y_px=y, rho=rho)


def _relative_scene_errs(scene: StudiedScene, curve: DetectabilityCurve) -> FloatArray:
    """Standard error of the logarithm of d' by the choice of photographs, at each zoom."""
    low = np.array(getattr(curve, "dprime_low_scene", None) or curve.dprime_low)
    high = np.array(getattr(curve, "dprime_high_scene", None) or curve.dprime_high)
    value = np.array(curve.dprime)
    given = (high - low) / _INTERVAL_SIGMAS / np.maximum(value, 1e-12)
    return np.asarray(given * sqrt(len(scene.photographs) / scene.planned_count))


def _tilt(
    scene: StudiedScene,
    curves: tuple[DetectabilityCurve, DetectabilityCurve, DetectabilityCurve],
    moved: Sequence[DetectabilityCurve],
    steps: FloatArray,
) -> Sensitivity | None:
    """Sensitivity of the allowed tilt; None where the curves do not limit it."""
    best, middle, noisier = curves
    threshold = scene.min_d_prime
    value = scene.tilt_deg(best, threshold)
    own = scene.tilt_deg(middle, threshold)
    stricter = scene.tilt_deg(best, threshold * (1 + _STEP))
    beside = [scene.tilt_deg(one, threshold) for one in (noisier, *moved)]
    if value is None or own is None or stricter is None or None in beside:
        return None
    noise, *widths = (one - own for one in beside if one is not None)
    allowed = best.largest_zoom(threshold) or 1.0
    scene_err = float(np.interp(allowed, best.zoom, _relative_scene_errs(scene, best)))
    by_log_d_prime = (value - stricter) / log(1 + _STEP)
    return Sensitivity(
        value=value,
        by_widths=np.array(widths) / steps,
        by_log_noise=noise / log(1 + _STEP),
        scene_err=abs(by_log_d_prime) * scene_err,
    )
