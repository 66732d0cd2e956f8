"""What the errors of a study become in d' and in the allowed tilt.

Both follow from the PSF, the noise and the photographs of the scene. Their slopes are finite
differences of the curves that ``analysis.detectability`` computes; what the choice of photographs
leaves is the interval of those curves, which shrinks with the root of their number. Without
photographs the scene is overlapping discs of all sizes (the dead leaves model), which have edges,
an amplitude spectrum that falls about as 1/f, and areas of much and of little detail.

References
----------
Lee, Mumford, Huang, "Occlusion models for natural images", Int. J. Computer Vision 41, 2001:
radii by the inverse cube.
"""

from dataclasses import dataclass
from math import log, sqrt

import numpy as np

from analysis.detectability import (
    DetectabilityCurve,
    DetectionTask,
    GaussianSignal,
    curves_of_images,
)
from analysis.errors import NotDetectableError
from analysis.pose import ViewingCamera, limits_of_curve
from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf, Psf

BUILT_IN = "overlapping discs with radii by the inverse cube, 16 pictures of 192 px, seeded"

_PICTURES = 16
_SIDE_PX = 192
_OVERSAMPLING = 2
_RADII_PX = (1.0, 80.0)
_DISCS = 1500
_SEED = 20010101


def built_in_scenes(low_dn: float, high_dn: float, psf: GaussianPsf) -> tuple[FloatArray, ...]:
    """Return the pictures, seen through a PSF.

    ``low_dn, high_dn``: levels of black and white paper; the discs are evenly between them.
    """
    transfer = _transfer(_SIDE_PX * _OVERSAMPLING, psf)
    return tuple(
        low_dn + (high_dn - low_dn) * _seen(_discs(np.random.default_rng([_SEED, n])), transfer)
        for n in range(_PICTURES)
    )


def _discs(rng: np.random.Generator) -> FloatArray:
    """Reflectances from 0 to 1, on the finer grid."""
    side = _SIDE_PX * _OVERSAMPLING
    picture = np.full((side, side), 0.5)
    least, most = (radius**-2.0 for radius in _RADII_PX)
    radii = _OVERSAMPLING * (most + (least - most) * rng.random(_DISCS)) ** -0.5
    places = rng.uniform(0, side, (_DISCS, 2))
    greys = rng.random(_DISCS)
    for radius, (row, col), grey in zip(
        radii.tolist(), places.tolist(), greys.tolist(), strict=True
    ):
        top, left = max(int(row - radius), 0), max(int(col - radius), 0)
        part = picture[top : int(row + radius) + 2, left : int(col + radius) + 2]
        y, x = np.ogrid[: part.shape[0], : part.shape[1]]
        part[(y + top - row) ** 2 + (x + left - col) ** 2 < radius**2] = grey
    return picture


def _transfer(side: int, psf: GaussianPsf) -> FloatArray:
    """Transfer at the frequencies of the finer grid."""
    fy = np.fft.fftfreq(side)[:, None] * _OVERSAMPLING
    fx = np.fft.rfftfreq(side) * _OVERSAMPLING
    (xx, xy), (_, yy) = psf.covariance_px2.tolist()
    power = xx * fx**2 + 2 * xy * fx * fy + yy * fy**2
    return np.asarray(np.exp(-2 * np.pi**2 * power))


def _seen(picture: FloatArray, transfer: FloatArray) -> FloatArray:
    blurred = np.fft.irfft2(np.fft.rfft2(picture) * transfer, picture.shape)
    return np.asarray(blurred[::_OVERSAMPLING, ::_OVERSAMPLING])


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

    ``photographs``: levels, shape ``(rows, cols)`` each. ``planned_count``: number of photographs
    of the scene that will be taken. ``noise_dn, noise_relative_err``: noise of a pixel of either
    photograph, and how well it is known. ``contrast_dn, signal_sigma_px``: peak and width of the
    change. ``min_d_prime``: threshold of the allowed tilt. ``camera``: the camera; None where its
    frame is not known.
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
        return self._curves(self.crops, psf, _ZOOMS, (self.noise_dn,))[0]

    def log_d_primes(self, psf: Psf, zooms: tuple[float, ...], *noise_factors: float) -> FloatArray:
        """Logarithms of d' at some zooms, by factors on the noise: shape (factors, zooms).

        They are of a few of the photographs: enough for slopes.
        """
        noises_dn = tuple(self.noise_dn * factor for factor in noise_factors)
        curves = self._curves(self.crops[:_FOR_SLOPES], psf, zooms, noises_dn)
        return np.log(np.maximum([curve.dprime for curve in curves], 1e-12))

    def _curves(
        self,
        crops: list[FloatArray],
        psf: Psf,
        zooms: tuple[float, ...],
        noises_dn: tuple[float, ...],
    ) -> list[DetectabilityCurve]:
        task = DetectionTask(
            signal=GaussianSignal(sigma_px=self.signal_sigma_px),
            contrasts_dn=(self.contrast_dn,),
            noises_dn=noises_dn,
            zooms=zooms,
            models=("matched",),
            observers=("hotelling",),
        )
        return curves_of_images(crops, psf, task).curves

    def tilt_deg(self, curve: DetectabilityCurve, min_d_prime: float) -> float | None:
        """Largest tilt with a d' of at least this; None where nothing in the curve limits it."""
        if self.camera is None:
            return None
        try:
            found = limits_of_curve(curve, min_d_prime, self.camera)
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
    """Compute the sensitivities."""
    curve = scene.curve(psf)
    value = curve.dprime[_AT]
    allowed = curve.largest_zoom(scene.min_d_prime)
    zooms = tuple(sorted({STUDIED_ZOOM, *([] if allowed is None else [allowed])}))
    by_widths, by_log_noise = _log_slopes(scene, gaussian, zooms)
    scene_errs = _relative_scene_errs(scene, curve)
    at = zooms.index(STUDIED_ZOOM)
    widths = np.array([gaussian.sigma_x_px, gaussian.sigma_y_px])
    tilt = None
    if allowed is not None:
        there = zooms.index(allowed)
        err = float(np.interp(allowed, curve.zoom, scene_errs))
        tilt = _tilt(scene, curve, by_widths[:, there], float(by_log_noise[there]), err)
    return ChangeSensitivities(
        d_prime=Sensitivity(
            value=value,
            by_widths=value * by_widths[:, at],
            by_log_noise=value * float(by_log_noise[at]),
            scene_err=value * float(scene_errs[_AT]),
        ),
        tilt_deg=tilt,
        by_log_sigma=float(by_widths[:2, at] @ widths),
        by_log_noise=float(by_log_noise[at]),
    )


def _log_slopes(
    scene: StudiedScene, gaussian: GaussianPsf, zooms: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of log d' by sigma_x_px, sigma_y_px and rho, (3, zooms), and by log noise."""
    middle, noisier = scene.log_d_primes(gaussian, zooms, 1.0, 1 + _STEP)
    widths = np.array([gaussian.sigma_x_px, gaussian.sigma_y_px, gaussian.rho])
    rows = []
    for number in range(3):
        step = _STEP * widths[number] if number < 2 else -np.copysign(_STEP, widths[2])
        values = widths.copy()
        values[number] += step
        x, y, rho = values.tolist()
        moved = GaussianPsf(sigma_x_px=x, sigma_y_px=y, rho=rho)
        rows.append((scene.log_d_primes(moved, zooms, 1.0)[0] - middle) / step)
    return np.array(rows), np.asarray((noisier - middle) / log(1 + _STEP))


def _relative_scene_errs(scene: StudiedScene, curve: DetectabilityCurve) -> FloatArray:
    """Standard error of the logarithm of d' by the choice of photographs, at each zoom."""
    low = np.array(getattr(curve, "dprime_low_scene", None) or curve.dprime_low)
    high = np.array(getattr(curve, "dprime_high_scene", None) or curve.dprime_high)
    value = np.array(curve.dprime)
    given = (high - low) / _INTERVAL_SIGMAS / np.maximum(value, 1e-12)
    return np.asarray(given * sqrt(len(scene.photographs) / scene.planned_count))


def _tilt(
    scene: StudiedScene,
    curve: DetectabilityCurve,
    by_widths: FloatArray,
    by_log_noise: float,
    scene_err: float,
) -> Sensitivity | None:
    """Sensitivity of the allowed tilt; None where the curve does not limit it.

    The derivatives and the error are those of log d' at the zoom that the tilt brings about. A d'
    that is larger by a factor allows what a threshold smaller by it would.
    """
    value = scene.tilt_deg(curve, scene.min_d_prime)
    stricter = scene.tilt_deg(curve, scene.min_d_prime * (1 + _STEP))
    looser = scene.tilt_deg(curve, scene.min_d_prime / (1 + _STEP))
    if value is None or stricter is None or looser is None:
        return None
    by_log_d_prime = (looser - stricter) / (2 * log(1 + _STEP))
    return Sensitivity(
        value=value,
        by_widths=by_log_d_prime * by_widths,
        by_log_noise=by_log_d_prime * by_log_noise,
        scene_err=abs(by_log_d_prime) * scene_err,
    )
