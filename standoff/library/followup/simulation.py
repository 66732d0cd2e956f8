"""A photograph simulated from further away or from another pose, by any model."""

from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from calibration.files import read_correction
from calibration.noise import CorrectionMaps
from calibration.registration import Homography
from simulation import PoseOptions, Psf, PsfField, SamplingGrid
from simulation.arguments import checked
from simulation.arrays import AnyArray
from simulation.choices import (
    DEFAULT_MODEL,
    KERNEL_MODELS,
    POSE_MODELS,
    TRAINING_STEPS,
    GaussianForm,
    KernelModel,
    Model,
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
    zoomed_out,
)
from simulation.kernelgan import KernelGanSettings, kernel_operator
from simulation.sampling_grid import reference_shape
from simulation.uncertainty import SimulatedView
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import Call, Progress
from standoff.library.followup.channels import each_channel
from standoff.library.followup.learned_kernel import FoundKernel, found_kernel
from standoff.library.followup.poses import given_homography
from standoff.library.followup.simulated_photograph import SimulatedPhotograph
from standoff.library.followup.uncertainty import (
    Simulation,
    SimulationUncertainty,
    UncertaintyOptions,
    simulation_uncertainty,
)
from standoff.library.inputs import FilePath, ImageLike, NoiseLike, PsfLike, camera_noise
from standoff.library.psf import channel_psfs, frame_psf
from standoff.photographs import Photograph, ReadOptions

_CLIPPED_SAID = 0.001
"""Share of the pixels."""


@checked
def simulate(
    image: ImageLike,
    *,
    zoom: float | None = None,
    homography: ArrayLike | Homography | FilePath | None = None,
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
        Instead of ``zoom``: maps follow-up pixels ``(x, y, 1)`` to pixels of the image; shape
        (3, 3), or the path of an H.json.
    psf
        The camera's PSF: needed by ``matched``, ``paper`` and ``lmmse``. Of a calibration that has
        one for each colour, each channel of a photograph in colour takes its own.
    model
        ``lmmse``, ``matched``, ``paper`` (equation 1), ``bicubic``, ``kernelgan`` or
        ``gaussian-kernelgan``.
    transfer
        Which PSF of a calibration: the ``best`` it has, the ``gaussian`` or the ``measured`` one.
    gaussian
        Whether ``paper`` blurs by the exact transfer function or by sampled weights.
    camera
        Exposure, vignetting, sharpening and the seed of noise and training.
    noise
        Adds the noise of a capture: a noise.json, or what it says.
    correct
        Maps of dark, flat and defects that are applied to the reference first, or their noise.json.
    steps, centre_crop, sampler, kernel_cache
        For models that learn: training steps, whether the central half alone is learned from,
        sampling at exact grid points or nearest pixels, folder of trained kernels.
    uncertainty
        Asks for the standard error of each pixel, of models ``matched``, ``lmmse`` and ``paper``.
    threads
        Threads that share the rows; the image does not depend on it.
    white_level
        Level, as it is stored, at which the reference is clipped: a note says how much of it is.
    reading
        How the file is read; see ``standoff.reading``.
    progress
        Who watches the training.

    Returns
    -------
    SimulatedPhotograph
        The image, its masks and figures; ``write(path)`` writes it.

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
    errors = None
    try:
        if model == "kernelgan" or model == "gaussian-kernelgan":
            assert zoom is not None
            settings = KernelGanSettings(
                zoom=zoom, model=model, steps=steps, seed=camera.seed, is_centre_crop=centre_crop
            )
            made = _learned(call, reference, settings, sampler, kernel_cache, how)
        elif homography is not None:
            assert psf is not None
            pose = given_homography(homography, frame)
            made = _posed(call, reference, pose, psf, (model, transfer), how)
        else:
            assert zoom is not None
            made = _zoomed(call, reference, zoom, psf, (model, transfer), how)
        if uncertainty is not None:
            errors = _stated(call, made, (photograph, correct is not None), camera, uncertainty)
        with np.errstate(over="ignore"):  # levels beyond float32 are refused below
            delivered = captured(made.followup, camera, how.noise).astype(np.float32, copy=False)
    except ValueError as error:
        raise _refusal(error, fault, source) from error
    if not np.all(np.isfinite(delivered)):
        raise ApplicationError(f"{source}: the follow-up's levels exceed float32; lower --exposure")
    named = Path(fault).name if fault != source else "given"
    return SimulatedPhotograph(
        image=delivered,
        followup=made.followup,
        source=source,
        pose=f"zoom {zoom!r}" if homography is None else f"homography {named}",
        model=model,
        zoom=zoom,
        kernel=made.kernel,
        provenance=call.provenance(),
        notes=call.notes,
        uncertainty=errors,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Made:
    """A follow-up, with the kernel that it was learned by, or with what a kernel was made of.

    ``psf`` is the one for all channels, even if each took its own (``is_by_channel``).
    """

    followup: FollowUp
    reference: AnyArray
    how: Rendering
    kernel: FoundKernel | None = None
    view: SimulatedView | None = None
    given: PsfLike | None = None
    psf: Psf | PsfField | None = None
    is_by_channel: bool = False


def _stated(
    call: Call,
    made: _Made,
    photograph: tuple[Photograph, bool],
    camera: CaptureOptions,
    options: UncertaintyOptions,
) -> SimulationUncertainty:
    """Standard errors of a follow-up; a photograph comes with whether maps corrected it."""
    assert made.view is not None
    assert made.psf is not None
    assert made.given is not None
    done = Simulation(
        view=made.view,
        photograph=photograph[0],
        reference=made.reference,
        psf=made.psf,
        followup=made.followup,
        camera=camera,
        noise=made.how.noise,
        is_corrected=photograph[1],
    )
    if made.is_by_channel:
        call.note("the uncertainty of each channel is that by one PSF for all, not by its own")
    return simulation_uncertainty(call, done, made.given, options)


def _learned(
    call: Call,
    reference: AnyArray,
    settings: KernelGanSettings,
    sampler: Sampler,
    folder: FilePath | None,
    how: Rendering,
) -> _Made:
    kernel = found_kernel(call, reference, settings, folder)
    shape = reference_shape(reference)
    grid = SamplingGrid.centred(shape, settings.zoom)
    operator = kernel_operator(shape, grid, kernel.kernel, sampler)
    followup = followup_by(reference, operator, how)
    return _Made(followup=followup, reference=reference, how=how, kernel=kernel)


def _posed(
    call: Call,
    reference: AnyArray,
    pose: Homography,
    psf: PsfLike,
    kind: tuple[Model, PsfShape],
    how: Rendering,
) -> _Made:
    model, transfer = kind
    frame = reference.shape[1], reference.shape[0]
    known = frame_psf(call, psf, frame if pose.size == frame else None, model, transfer)
    options = PoseOptions(
        model="lmmse" if model == "lmmse" else "matched",
        threads=how.threads,
        distortion_k1=pose.distortion_k1,
    )

    def made(image: AnyArray, own: Psf | PsfField) -> FollowUp:
        return from_pose(image, pose.matrix, pose.size, own, options, how.noise)

    own_psfs = channel_psfs(call, psf, reference, known)
    followup = each_channel(reference, own_psfs, made) if own_psfs else made(reference, known)
    view = SimulatedView.of_pose(reference_shape(reference), pose.matrix, pose.size, options)
    return _Made(
        followup=followup,
        reference=reference,
        how=how,
        view=view,
        given=psf,
        psf=known,
        is_by_channel=own_psfs is not None,
    )


def _zoomed(
    call: Call,
    reference: AnyArray,
    zoom: float,
    psf: PsfLike | None,
    kind: tuple[Model, PsfShape],
    how: Rendering,
) -> _Made:
    model, transfer = kind
    frame = reference.shape[1], reference.shape[0]
    # The paper's model knows a Gaussian only.
    form = "gaussian" if model == "paper" else transfer
    known = None if psf is None else frame_psf(call, psf, frame, model, form)

    def made(image: AnyArray, own: Psf | PsfField | None) -> FollowUp:
        return zoomed_out(image, zoom, own, model, how)

    own_psfs = None
    if psf is not None and known is not None and model != "bicubic":
        own_psfs = channel_psfs(call, psf, reference, known)
    followup = each_channel(reference, own_psfs, made) if own_psfs else made(reference, known)
    view = SimulatedView.at_zoom(reference_shape(reference), zoom, model, how.threads)
    return _Made(
        followup=followup,
        reference=reference,
        how=how,
        view=view,
        given=psf,
        psf=known,
        is_by_channel=own_psfs is not None,
    )


def _note_clipping(call: Call, photograph: Photograph) -> None:
    """Say how much of a reference is clipped: more light was there than its levels say."""
    clipped = photograph.not_measured(is_clipped=True)
    share = 0.0 if clipped is None else float(clipped.mean())
    if share >= _CLIPPED_SAID:
        call.note(
            f"{photograph.name}: {100 * share:.2g} % of the pixels are clipped; the follow-up is "
            "too dark there"
        )


def _refuse_uncertainty(model: Model | KernelModel, camera: CaptureOptions | None) -> None:
    if model == "bicubic" or model in KERNEL_MODELS:
        raise ArgumentError(f"uncertainty needs model matched, lmmse or paper, got {model}")
    if camera is not None and camera.sharpening is not None:
        raise ArgumentError(
            "uncertainty is that of pixels whose noise is independent, which sharpening ends; "
            "leave out one of the two"
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
