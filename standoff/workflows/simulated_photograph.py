"""The follow-up of a photograph file, by any model and with the camera's effects."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.validation import KernelCache, default_cache_folder
from calibration.files import read_correction, read_homography
from calibration.psf import luma_plane
from calibration.registration import Homography
from simulation import SamplingGrid
from simulation.arrays import AnyArray, Float32Array
from simulation.choices import GaussianForm, KernelModel, Model, PoseModel, PsfShape, Sampler
from simulation.kernelgan import (
    EstimatedKernel,
    KernelGanError,
    KernelGanSettings,
    estimate_kernel,
    kernel_operator,
)
from simulation.resampling import reference_shape
from standoff.errors import ApplicationError
from standoff.photographs import Inputs
from standoff.terminal import note, progress_bar
from standoff.workflows.followup import (
    CaptureOptions,
    FollowUp,
    Rendering,
    captured,
    followup_by,
    from_pose,
    zoomed_out,
)
from standoff.workflows.psf_files import frame_psf


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowUpRequest:
    """A photograph, the pose of its follow-up and how to simulate it.

    ``inputs`` reads the photograph. The pose is ``zoom`` or the H.json ``homography``. ``transfer``
    says which PSF of the psf.json is used. ``correct`` is the
    noise.json whose maps correct the photograph first. The four before ``threads`` are for models
    that learn their kernel.
    """

    image: Path
    inputs: Inputs
    model: Model | KernelModel
    camera: CaptureOptions
    zoom: float | None = None
    homography: Path | None = None
    psf: Path | None = None
    transfer: PsfShape = "best"
    gaussian: GaussianForm = "transfer"
    correct: Path | None = None
    steps: int
    is_centre_crop: bool = False
    sampler: Sampler = "exact"
    kernel_cache: Path | None = None
    threads: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundKernel:
    """A kernel, and where it is stored."""

    kernel: EstimatedKernel
    path: Path
    is_from_cache: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedPhotograph:
    """The image as the camera delivers it, the follow-up behind it, and the learned kernel."""

    image: Float32Array
    followup: FollowUp
    kernel: FoundKernel | None


def simulate_photograph(request: FollowUpRequest) -> SimulatedPhotograph:
    """Simulate the follow-up of a photograph.

    Raises
    ------
    ApplicationError
        If an image cannot be read, the model does not allow the pose, or levels exceed float32.
    CalibrationError
        If the PSF, the homography or the maps cannot be read.
    """
    pose = None if request.homography is None else read_homography(request.homography)
    reference = _reference(request)
    kernel = None
    try:
        if request.model == "kernelgan" or request.model == "gaussian-kernelgan":
            kernel = _kernel(reference, request, request.model)
            followup = _by_kernel(reference, request, kernel.kernel)
        elif pose is not None:
            followup = _from_pose(reference, request, pose)
        else:
            followup = _zoomed_out(reference, request, request.model)
        with np.errstate(over="ignore"):  # levels beyond float32 are refused below
            image = captured(followup, request.camera).astype(np.float32, copy=False)
    except ValueError as error:
        raise ApplicationError(f"{request.homography or request.image}: {error}") from error
    if not np.all(np.isfinite(image)):
        raise ApplicationError(
            f"{request.image}: the follow-up's levels exceed float32; lower --exposure"
        )
    return SimulatedPhotograph(image=image, followup=followup, kernel=kernel)


def _reference(request: FollowUpRequest) -> AnyArray:
    image, correct = request.image, request.correct
    file = request.inputs.photograph(image)
    if correct is None:
        return file.colour_planes
    if file.is_colour:
        raise ApplicationError(
            f"{image}: a colour image, but the maps are of a grey camera; leave out --correct"
        )
    maps = read_correction(correct)
    try:
        return maps.correct(file.colour_planes)
    except ValueError as error:
        raise ApplicationError(f"{image}: {error}") from error


def _kernel(reference: AnyArray, request: FollowUpRequest, model: KernelModel) -> FoundKernel:
    """Return the kernel of a photograph; unless stored, train it with a bar on stderr."""
    settings = KernelGanSettings(
        zoom=_zoom(request),
        model=model,
        steps=request.steps,
        seed=request.camera.seed,
        is_centre_crop=request.is_centre_crop,
    )
    grey = luma_plane(reference)
    cache = KernelCache(request.kernel_cache or default_cache_folder())
    path = cache.path(grey, settings)
    stored = cache.load(grey, settings)
    if stored is not None:
        note(f"kernel taken from {path}")
        return FoundKernel(kernel=stored, path=path, is_from_cache=True)
    try:
        with progress_bar(f"training {model}", settings.steps) as bar:
            kernel = estimate_kernel(grey, settings, bar.advance_to)
    except KernelGanError as error:
        raise ApplicationError(str(error)) from error
    cache.store(grey, settings, kernel)
    return FoundKernel(kernel=kernel, path=path, is_from_cache=False)


def _by_kernel(reference: AnyArray, request: FollowUpRequest, kernel: EstimatedKernel) -> FollowUp:
    shape = reference_shape(reference)
    grid = SamplingGrid.centred(shape, _zoom(request))
    operator = kernel_operator(shape, grid, kernel, request.sampler)
    return followup_by(reference, operator, _rendering(request))


def _from_pose(reference: AnyArray, request: FollowUpRequest, pose: Homography) -> FollowUp:
    assert request.psf is not None
    frame = (reference.shape[1], reference.shape[0])
    model: PoseModel = "lmmse" if request.model == "lmmse" else "matched"
    own = frame if pose.size == frame else None
    psf = frame_psf(request.psf, own, model, request.transfer)
    return from_pose(reference, pose, psf, model, _rendering(request))


def _zoomed_out(reference: AnyArray, request: FollowUpRequest, model: Model) -> FollowUp:
    zoom, how = _zoom(request), _rendering(request)
    if request.psf is None:
        return zoomed_out(reference, zoom, None, model, how)
    # The paper's model knows a Gaussian only.
    shape = "gaussian" if model == "paper" else request.transfer
    psf = frame_psf(request.psf, (reference.shape[1], reference.shape[0]), model, shape)
    return zoomed_out(reference, zoom, psf, model, how)


def _rendering(request: FollowUpRequest) -> Rendering:
    return Rendering(noise=request.camera.noise, gaussian=request.gaussian, threads=request.threads)


def _zoom(request: FollowUpRequest) -> float:
    assert request.zoom is not None
    return request.zoom
