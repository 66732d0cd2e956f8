"""Changes between two photographs that the change of pose does not explain.

The reference is simulated on the follow-up's own pixels; light that changed slowly over the frame
is fitted and taken out; what remains is compared with its uncertainty.
"""

from dataclasses import dataclass
from math import exp, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import binary_erosion, gaussian_filter, map_coordinates
from scipy.special import ndtr

from analysis.changes.chance import significance_threshold
from analysis.changes.document import ChangeSummary
from analysis.changes.options import ChangeOptions
from analysis.changes.uncertainty import extra_blur, fit_variance
from analysis.changes.warning_sentences import ChangeMasks
from analysis.errors import AnalysisError, OverlapError, SoftFollowupError
from calibration.notebook import html_table
from calibration.registration import DistortedPose, register
from calibration.robust import robust_sigma
from simulation import PoseOptions, Psf, PsfField, simulate_pose
from simulation.arrays import AnyArray, BoolArray, FloatArray
from simulation.choices import PoseModel
from simulation.pose import pose_noise_gain

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SOFTNESS_LIMIT_PX2 = 0.15
"""Extra blur of the follow-up that is refused: a width of 0.39 px on top of the simulated."""

_SURE = 2.0
"""Standard errors by which the extra blur must exceed the limit."""

_MODEL: PoseModel = "matched"
"""The capture model with which the rates of false alarms were measured."""

_SMOOTHING_PX = 1.0
"""Width of the Gaussian that gathers a change's pixels before the decision."""

_SHOWN = ("changed_px", "compared_px", "threshold_sd", "zoom", "gain", "extra_blur_px2")
_CLIP = 2.5
_BORDER_PX = 4
_LIGHT_ROUNDS = 5
_SPREAD_ROUNDS = 5
_LEAST_PIXELS = 1000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ChangeResult:
    """Images on the follow-up's pixels, shape ``(rows, cols)`` each; 0 where not ``valid``.

    Parameters
    ----------
    summary
        What the comparison found, in figures.
    followup_dn
        The follow-up itself.
    difference_dn
        Follow-up minus the simulated one in the follow-up's light.
    plain_difference_dn
        Follow-up minus the reference merely resampled, in the same light.
    pose_difference_dn
        The part of the plain difference that the pose explains.
    variance_dn2
        Variance of the difference.
    significance
        Smoothed difference over its standard deviation.
    is_change
        Where the significance exceeds the threshold in absolute value.
    valid
        Pixels that both images show and that the reference resolves.
    pose
        Position of every follow-up pixel in the reference.
    masks
        Changed, compared and clipped pixels.
    """

    summary: ChangeSummary
    followup_dn: FloatArray
    difference_dn: FloatArray
    plain_difference_dn: FloatArray
    pose_difference_dn: FloatArray
    variance_dn2: FloatArray
    significance: FloatArray
    is_change: BoolArray
    valid: BoolArray
    pose: DistortedPose
    masks: ChangeMasks | None = None

    def __repr__(self) -> str:
        found = self.summary
        return (
            f"<ChangeResult: {found.changed_px} of {found.compared_px} px changed, beyond "
            f"{found.threshold_sd:.2f} standard deviations, zoom {found.zoom:.3f}>"
        )

    def _repr_html_(self) -> str:
        facts = self.summary.model_dump(include=set(_SHOWN))
        return html_table("Changes", ("", ""), [(name, f"{facts[name]:.5g}") for name in _SHOWN])

    def plot(self) -> "Figure":
        """Return a figure of the follow-up with its changes, both differences, significance."""
        from analysis.changes.plot import changes_figure  # matplotlib, for whoever looks

        return changes_figure(self)


def find_changes(
    reference: AnyArray,
    followup: AnyArray,
    psf: Psf | PsfField,
    options: ChangeOptions | None = None,
) -> ChangeResult:
    """Find changes between two photographs that the change of pose does not explain.

    Parameters
    ----------
    reference, followup
        Grey, shape ``(rows, cols)``; the follow-up is the later one, from further away.
    psf
        Total PSF of the camera.
    options
        Pose, noise and allowed false alarms, if not the defaults.

    Raises
    ------
    RegistrationError
        If no pose is given and the two cannot be aligned.
    OverlapError
        If the images share too little.
    SoftFollowupError
        If the follow-up is softer than simulated.
    AnalysisError
        If the pose is not that of a plane in front of the camera.
    """
    options = options or ChangeOptions()
    near, far = (np.asarray(image, dtype=np.float64) for image in (reference, followup))
    pose, k1_err = options.pose, None
    if pose is None:
        aligned = register(near, far, psf.gaussian)
        pose, k1_err = aligned.pose, aligned.k1_err
    seen, valid = _simulated(near, far, psf, pose)
    gain, offset = _light(seen, far, valid)
    expected = gain * seen + offset
    difference = np.where(valid, far - expected, 0.0)
    blur = extra_blur(expected, far, valid)
    if blur.value_px2 - _SURE * blur.err_px2 > SOFTNESS_LIMIT_PX2:
        raise SoftFollowupError(
            f"the follow-up is softer than simulated by {sqrt(blur.value_px2):.2f} px (defocus or "
            "motion): changes cannot be distinguished from blur; retake it",
            blur_px=sqrt(blur.value_px2),
        )
    variance = None
    if options.noise is not None:
        own = pose_noise_gain(pose.matrix, _shape(near), _shape(far)[::-1], psf, _options(pose))
        noise = options.noise
        variance = noise.variance_dn2(far) + gain**2 * own * noise.variance_dn2(seen)
    uncertainty = fit_variance(difference, expected, valid, variance)
    significance = _significance(difference / np.sqrt(uncertainty.variance_dn2), valid)
    threshold = significance_threshold(options.false_alarms / int(valid.sum()))
    is_change = np.abs(significance) > threshold
    resampled = gain * _resampled(near, pose) + offset
    return ChangeResult(
        summary=ChangeSummary(
            homography=pose.matrix.tolist(),
            distortion_k1=pose.k1,
            distortion_k1_err=k1_err,
            zoom=pose.zoom,
            changed_px=int(is_change.sum()),
            compared_px=int(valid.sum()),
            threshold_sd=threshold,
            false_alarms_px=options.false_alarms,
            gain=float(gain[valid].mean()),
            extra_blur_px2=blur.value_px2,
            extra_blur_err_px2=blur.err_px2,
            noise_factor=uncertainty.noise_factor,
            is_noise_known=options.noise is not None,
            registration_err_px=uncertainty.registration_err_px,
            width_err_px2=uncertainty.width_err_px2,
            psf_form=psf.form,
        ),
        followup_dn=far,
        difference_dn=difference,
        plain_difference_dn=np.where(valid, far - resampled, 0.0),
        pose_difference_dn=np.where(valid, expected - resampled, 0.0),
        variance_dn2=uncertainty.variance_dn2,
        significance=significance,
        is_change=is_change,
        valid=valid,
        pose=pose,
    )


def _options(pose: DistortedPose) -> PoseOptions:
    return PoseOptions(distortion_k1=pose.k1, model=_MODEL)


def _simulated(
    near: FloatArray, far: FloatArray, psf: Psf | PsfField, pose: DistortedPose
) -> tuple[FloatArray, BoolArray]:
    """The follow-up as its pose alone would make it, and the pixels that may be compared."""
    try:
        simulated = simulate_pose(
            near,
            pose.matrix,
            (far.shape[1], far.shape[0]),
            psf,
            _options(pose),
        )
    except ValueError as error:
        raise AnalysisError(str(error)) from error
    valid = binary_erosion(
        ~simulated.outside & ~simulated.nearer, iterations=_BORDER_PX, border_value=0
    )
    if int(valid.sum()) < _LEAST_PIXELS:
        raise OverlapError(
            "the images overlap too little where the reference resolves at least as finely as the "
            "follow-up; retake the follow-up with more overlap or from further away",
            shared_px=int(valid.sum()),
        )
    return np.asarray(simulated.image, dtype=np.float64), np.asarray(valid)


def _light(
    simulated: FloatArray, followup: FloatArray, valid: BoolArray
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
        scale = robust_sigma(residual) + 1e-9
        weight = np.maximum(1 - (residual / (4.685 * scale)) ** 2, 0.0) ** 2  # Tukey's biweight
    count = len(basis)
    gain = np.tensordot(solution[:count], basis, axes=1)
    offset = np.tensordot(solution[count:], basis, axes=1) - gain * level
    return np.asarray(gain), np.asarray(offset)


def _significance(normalised: FloatArray, valid: BoolArray) -> FloatArray:
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
    spread = robust_sigma(values)
    # Share of the variance that is left when a normal distribution is cut off there.
    density = exp(-_CLIP * _CLIP / 2) / sqrt(2 * pi)
    kept = 1 - 2 * _CLIP * density / (2 * float(ndtr(_CLIP)) - 1)
    for _ in range(_SPREAD_ROUNDS):
        inner = values[np.abs(values) < _CLIP * spread]
        if not len(inner):
            break
        spread = sqrt(float(np.mean(inner**2)) / kept)
    return spread


def _resampled(reference: FloatArray, pose: DistortedPose) -> FloatArray:
    places = pose.followup_places_px()
    return np.asarray(map_coordinates(reference, places, order=3, mode="nearest"))


def _shape(image: FloatArray) -> tuple[int, int]:
    return image.shape[0], image.shape[1]
