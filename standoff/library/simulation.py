"""How a scene looks from further away or from another pose, and through the camera."""

from collections.abc import Callable
from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.photographs import LARGEST_IMAGE_PX, Photograph, ReadOptions
from calibration.files import read_correction, read_homography
from calibration.noise import CorrectionMaps
from calibration.registration import Homography
from simulation import (
    PoseOptions,
    Psf,
    PsfField,
    SamplingGrid,
    SceneDepth,
    SimulatedPose,
)
from simulation.arguments import (
    ArgumentError,
    ArgumentTypeError,
    arguments_at_fault,
    checked,
    is_array_like,
    kind_of,
    whole_array,
)
from simulation.arrays import AnyArray
from simulation.choices import (
    DEFAULT_MODEL,
    KERNEL_MODELS,
    POSE_MODELS,
    TRAINING_STEPS,
    GaussianForm,
    KernelModel,
    Model,
    PoseModel,
    PsfShape,
    Sampler,
)
from simulation.followup import (
    CaptureOptions as CaptureOptions,
    FollowUp,
    Rendering,
    captured,
    followup_by,
    from_pose,
    of_depth,
    zoomed_out,
)
from simulation.kernelgan import KernelGanSettings, kernel_operator
from simulation.pose import DepthView, homography_fault
from simulation.sampling_grid import reference_shape
from simulation.uncertainty import SimulatedView
from standoff.errors import ApplicationError
from standoff.library.call import (
    Call,
    FilePath,
    ImageLike,
    NoiseLike,
    Progress,
    PsfLike,
    camera_noise,
    colour_planes,
    path_of,
)
from standoff.library.psf import channel_psfs, frame_psf
from standoff.library.simulated_photograph import (
    FoundKernel,
    SimulatedPhotograph,
    Simulation,
    UncertaintyOptions,
    found_kernel,
    simulation_uncertainty,
)


@checked
@arguments_at_fault()
def zoom_out(
    image: ImageLike,
    zoom: float,
    psf: PsfLike | None = None,
    model: Model = DEFAULT_MODEL,
    *,
    reading: ReadOptions | None = None,
) -> NDArray[np.floating[Any]]:
    """Return the image of the same scene from ``zoom`` times further away.

    Parameters
    ----------
    image
        The photograph, linear in light: an array of shape ``(rows, cols)`` or ``(rows, cols,
        channels)``, or a file.
    zoom
        Ratio of the distances, at least 1.
    psf
        The camera's PSF: a PSF such as ``GaussianPsf``, a calibration, or the path of a psf.json. A
        calibration's measured PSF is preferred to its Gaussian. If the image is a whole frame,
        ``matched`` and ``lmmse`` use the PSF as it varies over the frame. If a calibration has a
        PSF for each colour, each channel of a colour image takes its own. ``bicubic`` needs none.
    model
        Capture model: ``matched``, ``paper`` (equation 1 of the paper), ``lmmse`` or ``bicubic``.
    reading
        How the image is read; see ``standoff.reading``.

    Returns
    -------
    ndarray of float32, or float64 for float64 input
        The follow-up, in the levels of the image, with ``floor(N / zoom)`` pixels along an axis of
        N; the centres of the two images coincide.

    Raises
    ------
    TypeError
        If the image or the PSF has the wrong type.
    ValueError
        If the zoom is below 1, the image is too small for it, or the model needs a PSF.

    Examples
    --------
    >>> import numpy as np
    >>> near = np.full((120, 160), 700.0)
    >>> far = standoff.zoom_out(near, 2.0, standoff.GaussianPsf(sigma_px=0.8))
    >>> far.shape, round(float(far.mean()), 3)
    ((60, 80), 700.0)
    """
    planes = colour_planes(image, options=reading)
    call, how = Call("zoom_out"), Rendering()
    return _zoomed(call, planes, zoom, psf, (model, "best"), how).followup.image


@checked
@arguments_at_fault()
def simulate_pose(
    image: ImageLike,
    homography: ArrayLike | Homography | FilePath,
    psf: PsfLike,
    size: tuple[int, int] | None = None,
    model: PoseModel = DEFAULT_MODEL,
    *,
    reading: ReadOptions | None = None,
) -> SimulatedPose:
    """Return the image of the same plane from another pose of the same camera.

    Parameters
    ----------
    image
        The photograph, linear in light: an array or a file.
    homography
        Maps follow-up pixels ``(x, y, 1)`` to pixels of the image: a matrix of shape (3, 3), a
        `Homography`, or the path of an H.json.
    psf
        The camera's PSF, as in ``zoom_out``.
    size
        ``(width, height)`` of the follow-up in px; by default that of H.json, or else that of the
        image.
    model
        Capture model: ``matched`` or ``lmmse``.
    reading
        How the image is read; see ``standoff.reading``.

    Returns
    -------
    SimulatedPose
        The follow-up, and masks of the pixels that would be sharper than the image, and of those
        that look past it.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If no camera in front of the plane has such a homography.

    Examples
    --------
    >>> far = standoff.simulate_pose("before.tif", "H.json", "psf.json")
    >>> far.image.shape, round(float(far.outside.mean()), 2)
    ((240, 320), 0.29)
    """
    planes = colour_planes(image, options=reading)
    frame = planes.shape[1], planes.shape[0]
    pose = given_homography(homography, size or frame)
    call = Call("simulate_pose")
    known = frame_psf(call, psf, frame if pose.size == frame else None, model)
    pose = pose.model_copy(update={"size": size or pose.size})
    made = _posed(call, planes, pose, (psf, known), model, Rendering()).followup
    assert made.nearer is not None
    assert made.outside is not None
    return SimulatedPose(image=made.image, nearer=made.nearer, outside=made.outside)


def given_homography(
    homography: ArrayLike | Homography | FilePath, size: tuple[int, int]
) -> Homography:
    """Return a homography as given, or read from its H.json; ``size`` is for a bare matrix."""
    if isinstance(homography, str | PathLike):
        found = read_homography(path_of(homography, "homography"))
    elif isinstance(homography, Homography):
        found = homography
    elif is_array_like(homography) or isinstance(homography, list | tuple):
        matrix = np.asarray(whole_array(homography, "homography"), dtype=np.float64)
        fault = homography_fault(matrix)
        if fault is not None:
            raise ArgumentError(fault, argument="homography")
        found = Homography(matrix=matrix, size=size)
    else:
        raise ArgumentTypeError(
            "expected a 3 x 3 matrix or the path of an H.json, got " + kind_of(homography),
            argument="homography",
        )
    width, height = found.size
    refuse_giant_frame(found.size, "size")
    fault = homography_fault(found.matrix, ((width - 1) / 2, (height - 1) / 2))
    if fault is not None:
        raise ArgumentError(fault, argument="homography")
    return found


def refuse_giant_frame(size: tuple[int, int], name: str) -> None:
    """Refuse a follow-up of ``(width, height)`` in px that is too large to be computed."""
    width, height = size
    if width * height > LARGEST_IMAGE_PX:
        raise ArgumentError(
            f"at most {LARGEST_IMAGE_PX / 1e6:g} million pixels, got {width} x {height}",
            argument=name,
        )


_CLIPPED_SAID = 0.001
"""Share of the pixels."""


@checked
def simulate(
    image: ImageLike,
    *,
    zoom: float | None = None,
    homography: ArrayLike | Homography | FilePath | None = None,
    depth: SceneDepth | None = None,
    psf: PsfLike | None = None,
    model: Model | KernelModel = DEFAULT_MODEL,
    transfer: PsfShape = "best",
    gaussian: GaussianForm = "transfer",
    camera: CaptureOptions | None = None,
    noise: NoiseLike | None = None,
    correct: CorrectionMaps | FilePath | None = None,
    steps: int = TRAINING_STEPS,
    centre_crop: bool = False,
    sampler: Sampler = "exact",
    kernel_cache: FilePath | None = None,
    uncertainty: UncertaintyOptions | None = None,
    threads: int = 1,
    white_level: float | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> SimulatedPhotograph:
    """Simulate how the scene of a photograph looks from further away or from another pose.

    Parameters
    ----------
    image
        The reference: an array linear in light, ``(rows, cols)`` or ``(rows, cols, channels)``, or
        a file.
    zoom
        Ratio of the distances, at least 1.
    homography
        Instead of ``zoom``: maps follow-up pixels ``(x, y, 1)`` to pixels of the image; a matrix of
        shape (3, 3), a `Homography`, or the path of an H.json.
    depth
        Depth of what the reference shows, as ``read_depth`` reads it: then nearer things grow more
        than those behind them, and hide others. By default the scene is flat. For models
        ``matched`` and ``lmmse``; a homography needs its focal length.
    psf
        The camera's PSF, which ``matched``, ``paper`` and ``lmmse`` need. If a calibration has a
        PSF for each colour, each channel of a colour photograph takes its own.
    model
        Capture model: ``lmmse``, ``matched``, ``paper`` (equation 1 of the paper), ``bicubic``,
        ``kernelgan`` or ``gaussian-kernelgan``.
    transfer
        Which PSF of a calibration to use: ``measured``, ``gaussian``, or ``best``: the measured
        one if the calibration has it, else the Gaussian.
    gaussian
        How ``paper`` blurs: ``transfer`` by the exact transfer function of the Gaussian,
        ``sampled`` by sampled weights.
    camera
        Exposure, vignetting and sharpening of the follow-up's camera, and the seed of noise and
        training.
    noise
        Noise of a capture, or the path of a noise.json; the follow-up gets the noise of such a
        capture. By default no noise is added.
    correct
        Dark, flat and defect maps to apply to the reference first, or the path of their noise.json.
    steps, centre_crop, sampler, kernel_cache
        For models that learn: number of training steps, whether only the central half is used for
        training, sampling at ``exact`` grid points or ``nearest`` pixels, and folder in which
        trained kernels are kept.
    uncertainty
        Errors of the inputs; if given, the standard error of each pixel is computed. For models
        ``matched``, ``lmmse`` and ``paper``.
    threads
        Number of threads that share the rows; the image does not depend on it.
    white_level
        Level, as it is stored, at which the reference is clipped; a note states the clipped share.
    reading
        How the file is read; see ``standoff.reading``.
    progress
        Shows the progress of the training, see `Progress`; by default nothing is shown.

    Returns
    -------
    SimulatedPhotograph
        The simulated image, its masks and figures; ``write(path)`` writes the image.

    Raises
    ------
    TypeError, ArgumentError
        If an argument has the wrong type, or two do not go together.
    ApplicationError
        If an image cannot be read, the model does not allow the pose, or levels exceed float32.
    CalibrationError
        If the PSF, the homography or the maps cannot be read.

    Examples
    --------
    >>> far = standoff.simulate("before.tif", zoom=2, psf="psf.json")
    >>> far.image.shape
    (120, 160)
    >>> far.write("far.tif")
    """
    _refuse_together(zoom, homography, psf, model)
    if depth is not None:
        _refuse_with_depth(model, uncertainty)
    if uncertainty is not None:
        _refuse_uncertainty(model, camera)
    zoom = None if zoom is None else float(zoom)
    own_noise = None if uncertainty is None else uncertainty.reference_noise
    files = psf, noise, homography, correct, own_noise
    call = Call("simulate", progress, reading, files, white_level)
    how = Rendering(noise=camera_noise(noise), gaussian=gaussian, threads=threads)
    camera = camera or CaptureOptions()
    photograph = call.photograph(image)
    source = fspath(image) if isinstance(image, str | PathLike) else photograph.name
    fault = fspath(homography) if isinstance(homography, str | PathLike) else source
    reference = _corrected(photograph, correct)
    _note_clipping(call, photograph)
    frame = reference.shape[1], reference.shape[0]
    kernel = errors = None
    try:
        if model == "kernelgan" or model == "gaussian-kernelgan":
            assert zoom is not None
            settings = KernelGanSettings(
                zoom=zoom, model=model, steps=steps, seed=camera.seed, is_centre_crop=centre_crop
            )
            kernel = found_kernel(call, reference, settings, kernel_cache)
            made = _learned(reference, settings, sampler, kernel, how)
        else:
            pose = None if homography is None else given_homography(homography, frame)
            made = _modelled(call, reference, (zoom, pose, depth), psf, (model, transfer), how)
        if uncertainty is not None:
            assert psf is not None
            whence = photograph, correct is not None
            errors = simulation_uncertainty(call, made, psf, (camera, uncertainty), whence)
        with np.errstate(over="ignore"):  # levels beyond float32 are refused below
            delivered = captured(made.followup, camera, how.noise).astype(np.float32, copy=False)
    except ValueError as error:
        raise _refusal(error, fault, source) from error
    if not np.all(np.isfinite(delivered)):
        raise ApplicationError(f"{source}: the follow-up's levels exceed float32; lower --exposure")
    words = f"zoom {zoom!r}"
    if homography is not None:
        words = f"homography {Path(fault).name if fault != source else 'given'}"
    return SimulatedPhotograph(
        image=delivered,
        followup=made.followup,
        source=source,
        pose=words if depth is None else f"{words}, with depth",
        model=model,
        zoom=zoom,
        kernel=kernel,
        provenance=call.provenance(),
        notes=call.notes,
        uncertainty=errors,
    )


def _modelled(
    call: Call,
    reference: AnyArray,
    where: tuple[float | None, Homography | None, SceneDepth | None],
    psf: PsfLike | None,
    kind: tuple[Model, PsfShape],
    how: Rendering,
) -> Simulation:
    """The follow-up by a model that learns nothing: further away or from another pose."""
    (zoom, pose, depth), (model, transfer) = where, kind
    if depth is not None:
        return _of_depth(call, reference, (depth, zoom, pose), psf, kind, how)
    if pose is not None:
        assert psf is not None
        frame = reference.shape[1], reference.shape[0]
        known = psf, frame_psf(call, psf, frame if pose.size == frame else None, model, transfer)
        return _posed(call, reference, pose, known, model, how)
    assert zoom is not None
    return _zoomed(call, reference, zoom, psf, kind, how)


def _learned(
    reference: AnyArray,
    settings: KernelGanSettings,
    sampler: Sampler,
    found: FoundKernel,
    how: Rendering,
) -> Simulation:
    shape = reference_shape(reference)
    grid = SamplingGrid.centred(shape, settings.zoom)
    operator = kernel_operator(shape, grid, found.kernel, sampler)
    return Simulation(reference=reference, followup=followup_by(reference, operator, how), how=how)


def _posed(
    call: Call,
    reference: AnyArray,
    pose: Homography,
    known: tuple[PsfLike, Psf | PsfField],
    model: Model | KernelModel,
    how: Rendering,
) -> Simulation:
    """The follow-up from another pose; the PSF as it is given, and the one for all channels."""
    options = PoseOptions(
        model="lmmse" if model == "lmmse" else "matched",
        threads=how.threads,
        distortion_k1=pose.distortion_k1,
    )

    def made(image: AnyArray, own: Psf | PsfField | None) -> FollowUp:
        assert own is not None
        return from_pose(image, pose.matrix, pose.size, own, options, how.noise)

    followup, is_by_channel = _by_channel(call, reference, known, made)
    shape = reference_shape(reference)
    return Simulation(
        reference=reference,
        how=how,
        followup=followup,
        psf=known[1],
        view=lambda: SimulatedView.of_pose(shape, pose.matrix, pose.size, options),
        is_by_channel=is_by_channel,
    )


def _of_depth(
    call: Call,
    reference: AnyArray,
    scene: tuple[SceneDepth, float | None, Homography | None],
    psf: PsfLike | None,
    kind: tuple[Model, PsfShape],
    how: Rendering,
) -> Simulation:
    """The follow-up of a scene with depth, by a zoom or the homography of its plane."""
    (depth, zoom, pose), (model, transfer) = scene, kind
    assert psf is not None
    frame = reference.shape[1], reference.shape[0]
    if pose is not None:
        view = DepthView.of_homography(depth, pose.matrix, pose.size, pose.distortion_k1)
    else:
        assert zoom is not None
        view = DepthView.further_away(depth, zoom)
    size = view.follow_up[1], view.follow_up[0]
    one_psf = frame_psf(call, psf, frame if size == frame else None, model, transfer)
    options = PoseOptions(model="lmmse" if model == "lmmse" else "matched", threads=how.threads)

    def made(image: AnyArray, own: Psf | PsfField | None) -> FollowUp:
        assert own is not None
        return of_depth(image, depth, view, own, options, how.noise)

    followup, is_by_channel = _by_channel(call, reference, (psf, one_psf), made)
    return Simulation(
        reference=reference,
        how=how,
        followup=followup,
        psf=one_psf,
        is_by_channel=is_by_channel,
    )


def _zoomed(
    call: Call,
    reference: AnyArray,
    zoom: float,
    psf: PsfLike | None,
    kind: tuple[Model, PsfShape],
    how: Rendering,
) -> Simulation:
    model, transfer = kind
    frame = reference.shape[1], reference.shape[0]
    # The paper's model knows a Gaussian only.
    form = "gaussian" if model == "paper" else transfer

    def made(image: AnyArray, own: Psf | PsfField | None) -> FollowUp:
        return zoomed_out(image, zoom, own, model, how)

    known = None if psf is None else frame_psf(call, psf, frame, model, form)
    own = None if model == "bicubic" else psf
    followup, is_by_channel = _by_channel(call, reference, (own, known), made)
    shape = reference_shape(reference)
    return Simulation(
        reference=reference,
        how=how,
        followup=followup,
        psf=known,
        view=lambda: SimulatedView.at_zoom(shape, zoom, model, how.threads),
        is_by_channel=is_by_channel,
    )


def _by_channel(
    call: Call,
    reference: AnyArray,
    known: tuple[PsfLike | None, Psf | PsfField | None],
    made: Callable[[AnyArray, Psf | PsfField | None], FollowUp],
) -> tuple[FollowUp, bool]:
    """The follow-up of a photograph, and whether its channels took a PSF each.

    ``made`` makes that of one plane, or of all by one PSF. Masks and the form of the PSF are those
    of the second channel, green.
    """
    given, psf = known
    psfs = None if given is None or psf is None else channel_psfs(call, given, reference, psf)
    if psfs is None:
        return made(reference, psf), False
    planes = [
        made(np.ascontiguousarray(reference[:, :, channel]), own)
        for channel, own in enumerate(psfs)
    ]
    variances = [one.own_variance_dn2 for one in planes if one.own_variance_dn2 is not None]
    whole = replace(
        planes[1],
        image=np.stack([one.image for one in planes], axis=2),
        own_variance_dn2=np.stack(variances, axis=2) if variances else None,
    )
    return whole, True


def _note_clipping(call: Call, photograph: Photograph) -> None:
    """Say how much of a reference is clipped: more light was there than its levels say."""
    clipped = photograph.not_measured(is_clipped=True)
    share = 0.0 if clipped is None else float(clipped.mean())
    if share >= _CLIPPED_SAID:
        call.note(
            f"{photograph.name}: {100 * share:.3g} % of the pixels are clipped; the follow-up is "
            "too dark there"
        )


def _refuse_uncertainty(model: Model | KernelModel, camera: CaptureOptions | None) -> None:
    if model == "bicubic" or model in KERNEL_MODELS:
        raise ArgumentError(f"uncertainty needs model matched, lmmse or paper, got {model}")
    if camera is not None and camera.sharpening is not None:
        raise ArgumentError(
            "uncertainty assumes independent noise in the pixels, which sharpening correlates; "
            "leave out one of the two"
        )


def _refuse_with_depth(model: Model | KernelModel, uncertainty: UncertaintyOptions | None) -> None:
    if model not in POSE_MODELS:
        raise ArgumentError(f"depth needs model {' or '.join(POSE_MODELS)}, got {model}")
    if uncertainty is not None:
        raise ArgumentError(
            "the uncertainty of a scene with depth is not known, because the uncertainty of the "
            "depth is not; leave out one of the two"
        )


def _refusal(error: ValueError, fault: str, source: str) -> Exception:
    """The error of an argument as it is; any other names the file at fault."""
    if isinstance(error, ArgumentError) and error.argument and fault == source:
        return error
    return ApplicationError(f"{fault}: {error}")


def _refuse_together(
    zoom: float | None, homography: object, psf: object, model: Model | KernelModel
) -> None:
    if (zoom is None) == (homography is None):
        raise ArgumentError("give exactly one of zoom and homography")
    if homography is not None and model not in POSE_MODELS:
        raise ArgumentError(f"homography needs model {' or '.join(POSE_MODELS)}, got {model}")
    if psf is None and model != "bicubic" and model not in KERNEL_MODELS:
        raise ArgumentError(f"model {model} needs psf")


def _corrected(photograph: Photograph, correct: CorrectionMaps | FilePath | None) -> AnyArray:
    if correct is None:
        return photograph.colour_planes
    if photograph.is_colour:
        raise ApplicationError(
            f"{photograph.name}: a colour image, but the maps are of a grey camera; "
            "leave out --correct"
        )
    maps = correct if isinstance(correct, CorrectionMaps) else read_correction(Path(correct))
    try:
        return maps.correct(photograph.colour_planes)
    except ValueError as error:
        raise ApplicationError(f"{photograph.name}: {error}") from error
