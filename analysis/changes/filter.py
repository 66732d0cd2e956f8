"""Changes between two photographs that the change of pose does not explain.

The reference is simulated on the follow-up's own pixels; light that changed slowly over the frame
is fitted and taken out; what remains is compared with its uncertainty.
"""

from dataclasses import dataclass
from math import exp, pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, gaussian_filter, map_coordinates
from scipy.optimize import brentq
from scipy.special import ndtr

from analysis.changes.uncertainty import DifferenceVariance, extra_blur, fit_variance
from analysis.choices import FALSE_ALARMS
from analysis.errors import AnalysisError
from calibration.registration import DistortedPose
from simulation import GaussianPsf, simulate_pose
from simulation.capture_noise import CaptureNoise
from simulation.pose import pose_noise_gain

__all__ = [
    "FALSE_ALARMS",
    "SOFTNESS_LIMIT_PX2",
    "ChangeResult",
    "find_changes",
    "significance_threshold",
]

FloatArray = NDArray[np.float64]

SOFTNESS_LIMIT_PX2 = 0.15
"""Extra blur of the follow-up that is refused: a width of 0.39 px on top of the simulated."""

_SURE = 2.0
"""Standard errors by which the extra blur must exceed the limit."""

_SMOOTHING_PX = 1.0
"""Width of the Gaussian that gathers a change's pixels before the decision."""

_SPREAD_ERR = 0.06
"""Relative standard deviation, over the frame, of the true spread about the one worked out: what
the fitted sizes and the neighbours' correlation leave open. Without it a third more pixels than
stated are flagged at a rate of 1 a frame (``benchmarks/bench_changes.py``, where it was chosen)."""

_CLIP = 2.5
_BORDER_PX = 4
_LIGHT_ROUNDS = 5
_SPREAD_ROUNDS = 5
_LEAST_PIXELS = 1000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChangeResult:
    """Images on the follow-up's pixels, shape ``(rows, cols)`` each; 0 where not ``valid``.

    Parameters
    ----------
    difference_dn
        Follow-up minus the simulated one in the follow-up's light.
    plain_difference_dn
        Follow-up minus the reference merely resampled, in the same light.
    pose_difference_dn
        The part of the plain difference that the pose explains.
    significance
        Smoothed difference over its standard deviation.
    is_change
        Where the significance exceeds ``threshold`` in absolute value.
    valid
        Pixels that both images show and that the reference resolves.
    uncertainty
        Of the difference, and what it is made of.
    threshold
        In standard deviations, from the false alarms allowed.
    extra_blur_px2, extra_blur_err_px2
        Variance by which the follow-up is softer than simulated, and its standard error;
        negative: sharper.
    gain
        Mean of the fitted gain of light.
    """

    difference_dn: FloatArray
    plain_difference_dn: FloatArray
    pose_difference_dn: FloatArray
    significance: FloatArray
    is_change: NDArray[np.bool_]
    valid: NDArray[np.bool_]
    uncertainty: DifferenceVariance
    threshold: float
    extra_blur_px2: float
    extra_blur_err_px2: float
    gain: float


def find_changes(
    reference_dn: FloatArray,
    followup_dn: FloatArray,
    matrix: FloatArray,
    psf: GaussianPsf,
    noise: CaptureNoise | None = None,
    *,
    distortion_k1: float = 0.0,
    false_alarms: float = FALSE_ALARMS,
) -> ChangeResult:
    """Compare a follow-up with what its pose alone would make of the reference.

    Parameters
    ----------
    reference_dn, followup_dn
        Grey, shape ``(rows, cols)``.
    matrix
        Shape (3, 3): follow-up pixel centres to reference pixel centres, both without distortion.
    psf
        Total PSF of the camera.
    noise
        Of both captures; without it the noise is fitted.
    distortion_k1
        Of the lens that took both, as in ``simulate_pose``.
    false_alarms
        Pixels flagged by chance, expected in a frame.

    Raises
    ------
    AnalysisError
        If the images share too little, or the follow-up is softer than simulated.
    """
    rows, cols = followup_dn.shape
    try:
        simulated = simulate_pose(
            reference_dn, matrix, (cols, rows), psf, distortion_k1=distortion_k1
        )
    except ValueError as error:
        raise AnalysisError(str(error)) from error
    seen = np.asarray(simulated.image, dtype=np.float64)
    valid = binary_erosion(
        ~simulated.outside & ~simulated.nearer, iterations=_BORDER_PX, border_value=0
    )
    if int(valid.sum()) < _LEAST_PIXELS:
        raise AnalysisError(
            "the images share too little that the reference resolves as well as the follow-up"
        )
    gain, offset = _light(seen, followup_dn, valid)
    expected = gain * seen + offset
    difference = np.where(valid, followup_dn - expected, 0.0)
    blur = extra_blur(expected, followup_dn, valid)
    if blur.value_px2 - _SURE * blur.err_px2 > SOFTNESS_LIMIT_PX2:
        raise AnalysisError(
            f"the follow-up is softer than simulated by {sqrt(blur.value_px2):.2f} px (defocus or "
            "motion): changes cannot be told from blur; take it again"
        )
    variance = None
    if noise is not None:
        own = pose_noise_gain(
            matrix, _shape(reference_dn), (cols, rows), psf, distortion_k1=distortion_k1
        )
        variance = noise.variance_dn2(followup_dn) + gain**2 * own * noise.variance_dn2(seen)
    uncertainty = fit_variance(difference, expected, valid, variance)
    significance = _significance(difference / np.sqrt(uncertainty.variance_dn2), valid)
    threshold = significance_threshold(false_alarms / int(valid.sum()))
    pose = DistortedPose(
        matrix=matrix,
        k1=distortion_k1,
        reference_shape=_shape(reference_dn),
        followup_shape=(rows, cols),
    )
    resampled = gain * _resampled(reference_dn, pose) + offset
    return ChangeResult(
        difference_dn=difference,
        plain_difference_dn=np.where(valid, followup_dn - resampled, 0.0),
        pose_difference_dn=np.where(valid, expected - resampled, 0.0),
        significance=significance,
        is_change=np.abs(significance) > threshold,
        valid=np.asarray(valid),
        uncertainty=uncertainty,
        threshold=threshold,
        extra_blur_px2=blur.value_px2,
        extra_blur_err_px2=blur.err_px2,
        gain=float(gain[valid].mean()),
    )


def _light(
    simulated: FloatArray, followup: FloatArray, valid: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Gain and offset that change slowly over the frame, by a robust fit of quadratics."""
    rows, cols = simulated.shape
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    level = float(simulated[valid].mean())
    # Contrast around the mean level tells gain from offset.
    columns = np.concatenate([basis * (simulated - level), basis])
    used, target = columns[:, valid].T, followup[valid]
    weight = np.ones(len(target))
    solution = np.zeros(len(columns))
    for _ in range(_LIGHT_ROUNDS):
        normal = (used * weight[:, None]).T @ used
        normal[np.diag_indices_from(normal)] *= 1 + 1e-10
        solution = np.linalg.solve(normal, used.T @ (weight * target))
        residual = target - used @ solution
        scale = 1.4826 * float(np.median(np.abs(residual))) + 1e-9
        weight = np.maximum(1 - (residual / (4.685 * scale)) ** 2, 0.0) ** 2  # Tukey's biweight
    count = len(basis)
    gain = np.tensordot(solution[:count], basis, axes=1)
    offset = np.tensordot(solution[count:], basis, axes=1) - gain * level
    return np.asarray(gain), np.asarray(offset)


def _significance(normalised: FloatArray, valid: NDArray[np.bool_]) -> FloatArray:
    weight = gaussian_filter(valid.astype(np.float64), _SMOOTHING_PX)
    smooth = gaussian_filter(np.where(valid, normalised, 0.0), _SMOOTHING_PX)
    smooth = np.where(valid, smooth / np.maximum(weight, 1e-6), 0.0)
    impulse = np.zeros((17, 17))
    impulse[8, 8] = 1.0
    white = sqrt(float(np.sum(gaussian_filter(impulse, _SMOOTHING_PX) ** 2)))
    # Noise that the simulation has smeared is not white: its own spread, if that is larger.
    return np.asarray(smooth / max(white, _spread(smooth[valid])))


def _spread(values: FloatArray) -> float:
    """Standard deviation of normal values, some of which are changes: that of the inner ones."""
    spread = 1.4826 * float(np.median(np.abs(values)))
    # Share of the variance that is left when a normal distribution is cut off there.
    density = exp(-_CLIP * _CLIP / 2) / sqrt(2 * pi)
    kept = 1 - 2 * _CLIP * density / (2 * float(ndtr(_CLIP)) - 1)
    for _ in range(_SPREAD_ROUNDS):
        inner = values[np.abs(values) < _CLIP * spread]
        if not len(inner):
            break
        spread = sqrt(float(np.mean(inner**2)) / kept)
    return spread


def significance_threshold(rate: float) -> float:
    """Standard deviations that a pixel without change exceeds, either way, at this rate."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(15)
    spreads, weights = 1 + _SPREAD_ERR * nodes, weights / weights.sum()

    def excess(threshold: float) -> float:
        return float(np.log(np.sum(weights * 2 * ndtr(-threshold / spreads)) / rate))

    if rate >= 1:
        return 0.0
    return float(brentq(excess, 0.0, 30.0))


def _resampled(reference: FloatArray, pose: DistortedPose) -> FloatArray:
    places = pose.followup_places_px()
    return np.asarray(map_coordinates(reference, places, order=3, mode="nearest"))


def _shape(image: FloatArray) -> tuple[int, int]:
    return image.shape[0], image.shape[1]
