"""A photograph as the same camera would take it from another pose, by any model."""

from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from analysis.validation import KernelCache, default_cache_folder
from calibration.files import read_correction
from calibration.noise import CorrectionMaps
from calibration.notebook import html_table
from calibration.provenance import Provenance
from calibration.psf import luma_plane
from calibration.registration import Homography
from simulation import PoseOptions, SamplingGrid
from simulation.arrays import AnyArray, Float32Array
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
    FollowUp as FollowUp,
    Rendering,
    captured,
    followup_by,
    from_pose,
    zoomed_out as zoomed_out,
)
from simulation.kernelgan import (
    EstimatedKernel,
    KernelGanError,
    KernelGanSettings,
    estimate_kernel,
    kernel_operator,
)
from simulation.resampling import reference_shape
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import Call, Progress
from standoff.library.files import write_float_tiff, write_mask
from standoff.library.followup.poses import given_homography
from standoff.library.inputs import FilePath, ImageLike, NoiseLike, PsfLike, camera_noise, path_of
from standoff.library.psf import frame_psf
from standoff.photographs import Photograph, ReadOptions

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundKernel:
    """A kernel, and where it is stored."""

    kernel: EstimatedKernel
    path: Path
    is_from_cache: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedPhotograph:
    """A simulated follow-up; ``numpy.asarray`` of it is its image.

    Parameters
    ----------
    image
        As the camera delivers it, in the levels of the reference.
    followup
        The output of the capture model behind it, and the masks of another pose.
    source, pose, model
        The photograph, the pose in words, and the capture model.
    zoom
        None for another pose.
    kernel
        What a model learned, if it does.
    notes
        What there is to say of it, in sentences.
    """

    image: Float32Array
    followup: FollowUp
    source: str
    pose: str
    model: Model | KernelModel
    zoom: float | None
    kernel: FoundKernel | None
    provenance: Provenance
    notes: tuple[str, ...] = ()

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.image, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        rows, cols = self.image.shape[:2]
        return f"<SimulatedPhotograph of {self.source}: {cols} x {rows} px, {self.how}>"

    def _repr_html_(self) -> str:
        facts = [(name, str(value)) for name, value in self.to_json().items() if name not in _LONG]
        return html_table("simulated photograph", ("", ""), facts)

    @property
    def how(self) -> str:
        """Pose and model in words."""
        return f"{self.pose}, model {self.model}"

    @property
    def mask_fractions(self) -> dict[str, float]:
        """Shares that would be sharper than the reference, and that it does not show."""
        followup = self.followup
        masks = (("nearer", followup.nearer), ("outside", followup.outside))
        return {f"{name}_fraction": float(m.mean()) for name, m in masks if m is not None}

    def to_json(self) -> dict[str, Any]:
        """Return the figures as ``standoff simulate --json`` prints them, without the file."""
        form, kernel = self.followup.psf_form, self.kernel
        learned = (
            {}
            if kernel is None
            else {
                "kernel": str(kernel.path),
                "kernel_from_cache": kernel.is_from_cache,
                "kernel_covariance_px2": kernel.kernel.covariance_px2.tolist(),
            }
        )
        return {
            "image": self.source,
            "zoom": self.zoom,
            "model": self.model,
            "transfer": "gaussian" if form in (None, "gaussian") else "measured",
            "psf_form": form,
            "psf_field": self.followup.is_field,
            "size": [self.image.shape[1], self.image.shape[0]],
            "min": float(self.image.min()),
            "max": float(self.image.max()),
            **(self.mask_fractions if self.zoom is None else {}),
            **learned,
            "provenance": self.provenance.model_dump(mode="json"),
        }

    def write(self, path: FilePath) -> None:
        """Write the image as a float32 TIFF, whole or not at all.

        Raises
        ------
        ImageFileError
            If the file cannot be written.
        """
        description = f"standoff simulate: {self.how}, of {Path(self.source).name}"
        write_float_tiff(path_of(path, "path"), self.image, description)

    def write_nearer(self, path: FilePath) -> None:
        """Write the mask of pixels that would be sharper than the reference, as PNG.

        Raises
        ------
        ArgumentError
            If the follow-up is merely further away: then there are none.
        ImageFileError
            If the file cannot be written.
        """
        if self.followup.nearer is None:
            raise ArgumentError("only a follow-up of another pose has pixels that are nearer")
        write_mask(path_of(path, "path"), self.followup.nearer)

    def plot(self) -> "Figure":
        """Return a figure of the follow-up as a screen shows it."""
        return Photograph.of_array(f"{Path(self.source).name}: {self.how}", self.image).plot()


_LONG = ("provenance", "kernel_covariance_px2")


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
    threads: int = 1,
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
        The camera's PSF: needed by ``matched``, ``paper`` and ``lmmse``.
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
    threads
        Threads that share the rows; the image does not depend on it.
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
    >>> far = standoff.simulate("near.tif", zoom=2, psf="psf.json")
    >>> far.write("far.tif")
    """
    _refuse_together(zoom, homography, psf, model)
    zoom = None if zoom is None else float(zoom)
    call = Call("simulate", progress, reading, (psf, noise, homography, correct))
    how = Rendering(noise=camera_noise(noise), gaussian=gaussian, threads=threads)
    camera = camera or CaptureOptions()
    photograph = call.photograph(image)
    source = fspath(image) if isinstance(image, str | PathLike) else photograph.name
    fault = fspath(homography) if isinstance(homography, str | PathLike) else source
    reference = _corrected(photograph, correct)
    frame = reference.shape[1], reference.shape[0]
    kernel = pose = None
    try:
        if model == "kernelgan" or model == "gaussian-kernelgan":
            assert zoom is not None
            settings = KernelGanSettings(
                zoom=zoom, model=model, steps=steps, seed=camera.seed, is_centre_crop=centre_crop
            )
            kernel = _kernel(call, reference, settings, kernel_cache)
            grid = SamplingGrid.centred(reference_shape(reference), zoom)
            operator = kernel_operator(reference_shape(reference), grid, kernel.kernel, sampler)
            followup = followup_by(reference, operator, how)
        elif homography is not None:
            assert psf is not None
            pose = given_homography(homography, frame)
            known = frame_psf(call, psf, frame if pose.size == frame else None, model, transfer)
            options = PoseOptions(
                model="lmmse" if model == "lmmse" else "matched",
                threads=threads,
                distortion_k1=pose.distortion_k1,
            )
            followup = from_pose(reference, pose.matrix, pose.size, known, options, how.noise)
        else:
            assert zoom is not None
            # The paper's model knows a Gaussian only.
            shape = "gaussian" if model == "paper" else transfer
            given = None if psf is None else frame_psf(call, psf, frame, model, shape)
            followup = zoomed_out(reference, zoom, given, model, how)
        with np.errstate(over="ignore"):  # levels beyond float32 are refused below
            delivered = captured(followup, camera, how.noise).astype(np.float32, copy=False)
    except ValueError as error:
        raise ApplicationError(f"{fault}: {error}") from error
    if not np.all(np.isfinite(delivered)):
        raise ApplicationError(f"{source}: the follow-up's levels exceed float32; lower --exposure")
    named = Path(fault).name if fault != source else "given"
    return SimulatedPhotograph(
        image=delivered,
        followup=followup,
        source=source,
        pose=f"zoom {zoom!r}" if homography is None else f"homography {named}",
        model=model,
        zoom=zoom,
        kernel=kernel,
        provenance=call.provenance(),
        notes=call.notes,
    )


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


def _kernel(
    call: Call, reference: AnyArray, settings: KernelGanSettings, folder: FilePath | None
) -> FoundKernel:
    """Return the kernel of a photograph; train it unless it is stored."""
    grey = luma_plane(reference)
    cache = KernelCache(default_cache_folder() if folder is None else Path(folder))
    path = cache.path(grey, settings)
    stored = cache.load(grey, settings)
    if stored is not None:
        call.note(f"kernel taken from {path}")
        return FoundKernel(kernel=stored, path=path, is_from_cache=True)
    try:
        with call.bar(f"training {settings.model}", settings.steps) as advance_to:
            kernel = estimate_kernel(grey, settings, advance_to)
    except KernelGanError as error:
        raise ApplicationError(str(error)) from error
    cache.store(grey, settings, kernel)
    return FoundKernel(kernel=kernel, path=path, is_from_cache=False)
