"""A simulated follow-up with the camera's effects: light, noise, sharpening, in this order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from simulation.arguments import ArgumentError, check_fields
from simulation.arrays import AnyArray, BoolArray, FloatArray, FloatImage
from simulation.capture_noise import CaptureNoise, propagated_variance, with_capture_noise
from simulation.choices import POSE_MODELS, GaussianForm, Model, PsfForm
from simulation.pose import (
    DepthRendering,
    DepthView,
    PoseOptions,
    SceneDepth,
    SimulatedPose,
    pose_noise_gain,
    simulate_pose_of_image,
)
from simulation.psf import Psf, PsfField
from simulation.sampling_grid import SamplingGrid
from simulation.zoom import ZoomOperator, zoom_operator, zoom_out_image


def _exposed(image_dn: FloatImage, factor: float, black_level_dn: float = 0.0) -> FloatImage:
    """Image with ``factor`` times the light; levels are not clipped."""
    if not (factor >= 0 and np.isfinite(factor)):
        raise ValueError(f"an exposure factor must be finite and not negative, got {factor}")
    return _like(image_dn, (image_dn - black_level_dn) * factor + black_level_dn)


def _vignetted(
    image_dn: FloatImage, corner_fall_off: float, black_level_dn: float = 0.0
) -> FloatImage:
    """Image with a lens's natural vignetting: ``cos^4``, losing a share at the corner pixel."""
    if not 0 <= corner_fall_off < 1:
        raise ValueError(f"a corner fall-off must be in [0, 1), got {corner_fall_off}")
    rows, cols = image_dn.shape[:2]
    y = (np.arange(rows) - (rows - 1) / 2)[:, None]
    x = np.arange(cols) - (cols - 1) / 2
    corner2 = ((rows - 1) / 2) ** 2 + ((cols - 1) / 2) ** 2
    # cos^4 = (1 + tan^2)^-2, with tan^2 growing as the square of the radius.
    tan2_at_corner = (1 - corner_fall_off) ** -0.5 - 1
    light = (1 + tan2_at_corner * (x**2 + y**2) / max(corner2, 1.0)) ** -2
    if image_dn.ndim == 3:
        light = light[:, :, None]
    return _like(image_dn, (image_dn - black_level_dn) * light + black_level_dn)


def _unsharp_masked(image_dn: FloatImage, amount: float, sigma_px: float) -> FloatImage:
    """Image after a camera's sharpening by its blur; phones use amounts of 0.3 to 1.5."""
    if not (amount >= 0 and np.isfinite(amount)):
        raise ValueError(f"the sharpening amount must be finite and not negative, got {amount}")
    if not (sigma_px > 0 and np.isfinite(sigma_px)):
        raise ValueError(f"sigma_px must be positive, got {sigma_px}")
    widths = (sigma_px, sigma_px, 0.0)[: image_dn.ndim]
    blurred = gaussian_filter(np.asarray(image_dn, dtype=np.float64), widths, mode="reflect")
    return _like(image_dn, image_dn + amount * (image_dn - blurred))


def _like(image_dn: FloatImage, values: NDArray[np.floating]) -> FloatImage:
    return values.astype(image_dn.dtype, copy=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureOptions:
    """Effects of the follow-up's camera beyond the capture model.

    Parameters
    ----------
    exposure
        Light of the follow-up relative to that of the reference.
    vignetting
        Relative loss of light at the corner of the frame, from 0 to below 1.
    sharpening
        Amount and width (sigma) in px of an unsharp mask; None for no sharpening.
    seed
        Seed of the added noise, and of training.

    Examples
    --------
    >>> dim = standoff.CaptureOptions(exposure=0.8, vignetting=0.1)
    >>> far = standoff.simulate("before.tif", zoom=1.5, psf="psf.json", camera=dim)
    """

    exposure: float = 1.0
    vignetting: float = 0.0
    sharpening: tuple[float, float] | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        if self.vignetting == 1:
            raise ArgumentError("expected a number below 1, got 1", argument="vignetting")
        if self.sharpening is not None and not (self.sharpening[0] >= 0 < self.sharpening[1]):
            raise ArgumentError(
                "expected an amount from 0 on and a width in px above 0, got "
                f"{self.sharpening[0]:g},{self.sharpening[1]:g}",
                argument="sharpening",
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendering:
    """How a follow-up is computed.

    ``noise`` is what the reference is assumed to have, ``gaussian`` the form of model ``paper``'s
    blur, ``threads`` how many share the rows; the image does not depend on that.
    """

    noise: CaptureNoise | None = None
    gaussian: GaussianForm = "transfer"
    threads: int = 1


_DEFAULTS = Rendering()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FollowUp:
    """The output of the capture model, before the camera's own effects.

    ``own_variance_dn2`` is the variance that the noise of the reference leaves in the image, in its
    shape; None if no noise was asked for. ``nearer`` and ``outside`` are masks of shape ``(rows,
    cols)``, None for a plain zoom-out; ``hidden``, of what the reference does not show, is None
    unless the scene has depth. ``psf_form`` is the form in which the PSF was known,
    ``is_field`` whether it varied over the frame.
    """

    image: FloatImage
    own_variance_dn2: FloatArray | None
    nearer: BoolArray | None = None
    outside: BoolArray | None = None
    hidden: BoolArray | None = None
    psf_form: PsfForm | None = None
    is_field: bool = False


def zoomed_out(
    reference: AnyArray,
    zoom: float,
    psf: Psf | PsfField | None,
    model: Model,
    how: Rendering = _DEFAULTS,
) -> FollowUp:
    """Follow-up from ``zoom`` times further away; a field only by a model that takes one."""
    shape = reference.shape[0], reference.shape[1]
    grid = SamplingGrid.centred(shape, zoom)
    if isinstance(psf, PsfField):
        taking = [name for name in POSE_MODELS if name == model]
        if not taking:
            raise ValueError(f"model {model!r} takes one PSF for the whole frame")
        options = PoseOptions(
            model=taking[0],
            threads=how.threads,
            # The follow-up is the middle of the camera's frame.
            origin_px=((shape[1] - grid.cols) / 2, (shape[0] - grid.rows) / 2),
        )
        return from_pose(reference, grid.matrix, (grid.cols, grid.rows), psf, options, how.noise)
    image = zoom_out_image(reference, zoom, psf, model, gaussian=how.gaussian, threads=how.threads)
    own = None
    if how.noise is not None:
        own = _own_variance(reference, zoom_operator(shape, grid, psf, model), how.noise)
    form = None if psf is None or model == "bicubic" else psf.form
    return FollowUp(image=image, own_variance_dn2=own, psf_form=form)


def followup_by(
    reference: AnyArray, operator: ZoomOperator, how: Rendering = _DEFAULTS
) -> FollowUp:
    """Follow-up by an operator for images of this size, plane by plane."""
    dtype = np.float64 if reference.dtype == np.float64 else np.float32
    planes = reference[:, :, None] if reference.ndim == 2 else reference
    image = np.stack(
        [
            operator.apply(planes[:, :, k].astype(dtype), how.threads)
            for k in range(planes.shape[2])
        ],
        axis=-1,
    )
    own = None if how.noise is None else _own_variance(reference, operator, how.noise)
    return FollowUp(image=image[:, :, 0] if reference.ndim == 2 else image, own_variance_dn2=own)


def from_pose(
    reference: AnyArray,
    matrix: FloatArray,
    size: tuple[int, int],
    psf: Psf | PsfField,
    options: PoseOptions,
    noise: CaptureNoise | None = None,
) -> FollowUp:
    """Follow-up from any pose, as of ``simulate_pose_of_image``, of a reference with this noise."""
    simulated = simulate_pose_of_image(reference, matrix, size, psf, options)
    own = None
    if noise is not None:
        shape = reference.shape[0], reference.shape[1]
        gain = pose_noise_gain(matrix, shape, size, psf, options)
        # At an edge the reference's variance is taken to be that of the blurred level.
        planes = gain if simulated.image.ndim == 2 else gain[:, :, None]
        own = planes * noise.variance_dn2(simulated.image)
    return _posed(simulated, own, psf)


def of_depth(
    reference: AnyArray,
    scene: SceneDepth,
    view: DepthView,
    psf: Psf | PsfField,
    options: PoseOptions,
    noise: CaptureNoise | None = None,
) -> FollowUp:
    """Follow-up of a scene with depth, of a reference with this noise."""
    rendering = DepthRendering.of(scene, view, psf)
    simulated = rendering.photograph(reference, options)
    own = None
    if noise is not None:
        gain = rendering.noise_gain(options)
        planes = gain if simulated.image.ndim == 2 else gain[:, :, None]
        own = planes * noise.variance_dn2(simulated.image)
    return _posed(simulated, own, psf)


def _posed(simulated: SimulatedPose, own: FloatArray | None, psf: Psf | PsfField) -> FollowUp:
    return FollowUp(
        image=simulated.image,
        own_variance_dn2=own,
        nearer=simulated.nearer,
        outside=simulated.outside,
        hidden=simulated.hidden,
        psf_form=psf.form,
        is_field=isinstance(psf, PsfField),
    )


def captured(
    followup: FollowUp, options: CaptureOptions, noise: CaptureNoise | None = None
) -> FloatImage:
    """Return the follow-up's image as the camera delivers it, with the noise of a capture."""
    black_dn = noise.black_level_dn if noise else 0.0
    image = _lit(followup.image, options, black_dn)
    own_variance_dn2 = followup.own_variance_dn2
    if noise is not None and own_variance_dn2 is not None:
        light = light_on(options, own_variance_dn2.shape)
        rng = np.random.default_rng(options.seed)
        image = with_capture_noise(image, light**2 * own_variance_dn2, noise, rng)
    if options.sharpening is not None:
        image = _unsharp_masked(image, *options.sharpening)
    return image


def light_on(options: CaptureOptions, shape: tuple[int, ...]) -> FloatArray:
    """Return the light of the follow-up's pixels over that of the reference, of a shape."""
    return np.asarray(_lit(np.ones(shape), options, 0.0), dtype=np.float64)


def _own_variance(reference: AnyArray, operator: ZoomOperator, noise: CaptureNoise) -> FloatArray:
    variance = noise.variance_dn2(reference.astype(np.float64))
    if variance.ndim == 2:
        return propagated_variance(operator, variance)
    planes = [propagated_variance(operator, variance[:, :, k]) for k in range(variance.shape[2])]
    return np.stack(planes, axis=-1)


def _lit(image: FloatImage, options: CaptureOptions, black_dn: float) -> FloatImage:
    if options.exposure != 1.0:
        image = _exposed(image, options.exposure, black_dn)
    if options.vignetting != 0.0:
        image = _vignetted(image, options.vignetting, black_dn)
    return image
