"""A photograph as the same camera would take it from another pose, and its standard error."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from acquisition.files import FLOAT_IMAGES, Provenance
from acquisition.photographs import (
    Photograph,
    luma_plane,
    photograph_of,
    write_float_tiff,
    write_mask,
)
from analysis.validation import KernelCache, default_cache_folder
from calibration.psf import focus_scatter_px2, psf_steps
from simulation.arguments import check_fields
from simulation.arrays import AnyArray, Float32Array, FloatArray
from simulation.by_value import ByValue
from simulation.choices import KernelModel, Model
from simulation.followup import CaptureOptions, FollowUp, Rendering, light_on
from simulation.kernelgan import EstimatedKernel, KernelGanError, KernelGanSettings, estimate_kernel
from simulation.notebook import html_table
from simulation.psf import Psf, PsfField
from simulation.uncertainty import (
    SOURCES,
    KnownErrors,
    PixelUncertainty,
    SimulatedView,
    pixel_uncertainty,
)
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import Call, FilePath, NoiseLike, PsfLike, camera_noise, output_path
from standoff.library.psf import calibration_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundKernel:
    """A kernel that a model learned, and the file in which it is kept."""

    kernel: EstimatedKernel
    path: Path
    is_from_cache: bool


def found_kernel(
    call: Call, reference: AnyArray, settings: KernelGanSettings, folder: FilePath | None
) -> FoundKernel:
    """Return the kernel of a photograph: the one kept in ``folder``, or a newly trained one."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyOptions:
    """Errors of a simulation's inputs that the inputs do not state themselves.

    Parameters
    ----------
    reference_noise
        Noise of the reference: noise of a capture, the path of a noise.json, or a standard
        deviation in DN. By default the noise that the simulation adds, or that of a capture with
        several frames.
    focus_scatter_px2
        Standard deviation of the PSF's variance from capture to capture, in px²; by default that
        of the calibration.

    Examples
    --------
    >>> known = standoff.UncertaintyOptions(reference_noise=12.0, focus_scatter_px2=0.05)
    >>> far = standoff.simulate("before.tif", zoom=1.5, psf="psf.json", uncertainty=known)
    >>> far.uncertainty.err.shape
    (160, 213)
    """

    reference_noise: NoiseLike | float | None = None
    focus_scatter_px2: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulationUncertainty:
    """Standard error of each pixel of a simulated photograph, and the variances by source.

    ``err`` is in the photograph's levels and has its shape, NaN outside the reference;
    ``focus_scatter_px2`` is the focus scatter that was used, None if it is not known.
    """

    err: Float32Array = field(repr=False)
    pixels: PixelUncertainty
    focus_scatter_px2: float | None

    def to_json(self) -> dict[str, Any]:
        """Return the medians over the photograph as ``standoff simulate --json`` prints them."""
        sources = (*SOURCES, "added_noise")
        return {
            "median_dn": float(np.nanmedian(self.err)),
            "median_dn_by_source": {name: self.pixels.median_err(name) for name in sources},
            "stated_model_error": None if self.pixels.model is None else "model",
            "not_known": list(self.pixels.unknown),
            "focus_scatter_px2": self.focus_scatter_px2,
        }

    @property
    def sentence(self) -> str:
        """The medians in words."""
        named = zip((*SOURCES, "added_noise"), (*_WORDS, "added noise"), strict=True)
        medians = ((words, self.pixels.median_err(name)) for name, words in named)
        parts = ", ".join(f"{words} {err:.3g}" for words, err in medians if err is not None)
        return f"standard error {np.nanmedian(self.err):.3g} DN in the median ({parts})"


_WORDS = ("noise", "PSF", "focus", "stated model error")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Simulation:
    """A follow-up by the capture model, and the inputs that it was made from.

    ``psf`` is the PSF for all channels, even if each channel took its own (``is_by_channel``); None
    for models without a PSF. ``view`` is None for models that learn.
    """

    reference: AnyArray
    how: Rendering
    followup: FollowUp
    psf: Psf | PsfField | None = None
    view: Callable[[], SimulatedView] | None = None
    is_by_channel: bool = False


def simulation_uncertainty(
    call: Call,
    done: Simulation,
    psf: PsfLike,
    asked: tuple[CaptureOptions, UncertaintyOptions],
    photograph: tuple[Photograph, bool],
) -> SimulationUncertainty:
    """Return the standard error of a simulated photograph; a note names what is not known.

    ``photograph`` is the reference, and whether correction maps were applied to it.
    """
    camera, options = asked
    assert done.view is not None
    assert done.psf is not None
    view = done.view()
    if done.is_by_channel:
        call.note("the uncertainty of every channel is computed with one PSF, not with its own")
    calibration = calibration_of(psf)
    scatter = options.focus_scatter_px2
    if scatter is None and calibration is not None:
        scatter = focus_scatter_px2(calibration)
    errors = KnownErrors(
        noise_dn2=_reference_noise(done, options.reference_noise, photograph),
        psf_steps=None
        if calibration is None
        else psf_steps(calibration, done.psf, max(view.zoom, 1.0)),
        focus_scatter_px2=scatter,
    )
    found = pixel_uncertainty(view, done.reference, done.psf, errors, outside=done.followup.outside)
    found = _delivered(found, done, camera)
    err = found.err
    if err is None:
        raise ApplicationError(
            f"{photograph[0].name}: no error of this simulation is known; give "
            "--reference-noise, --focus-scatter or a psf.json with standard errors"
        )
    for note in _notes(found, psf):
        call.note(note)
    return SimulationUncertainty(
        err=err.astype(np.float32), pixels=found, focus_scatter_px2=scatter
    )


def _reference_noise(
    done: Simulation, given: NoiseLike | float | None, photograph: tuple[Photograph, bool]
) -> FloatArray | None:
    """Variance of the reference's noise in each pixel; None if it is not known."""
    levels = np.asarray(done.reference, dtype=np.float64)
    if isinstance(given, int | float):
        return np.full(levels.shape, float(given) ** 2)
    noise = camera_noise(given) or done.how.noise
    if noise is not None:
        return noise.variance_dn2(levels)
    taken, is_corrected = photograph
    if is_corrected:
        return None  # the variance is that of the levels before a flat field divided them
    own, frames = taken.variance_dn2, taken.frames
    return own / frames if own is not None and own.shape == levels.shape else None


def _delivered(
    found: PixelUncertainty, done: Simulation, camera: CaptureOptions
) -> PixelUncertainty:
    """The uncertainty of the image as the camera delivers it: its light, and noise added to it."""
    followup, noise = done.followup, done.how.noise
    light = light_on(camera, followup.image.shape)
    found = found.scaled(light)
    own = followup.own_variance_dn2
    if noise is None or own is None:
        return found
    black_dn = noise.black_level_dn
    whole = noise.variance_dn2((followup.image - black_dn) * light + black_dn)
    return replace(found, added_noise=np.maximum(whole - light**2 * own, 0.0))


def _notes(found: PixelUncertainty, psf: PsfLike) -> Iterator[str]:
    """What is not in the uncertainty, and what would bring it in."""
    source = fspath(psf) if isinstance(psf, str | PathLike) else "psf"
    if found.noise is None:
        yield (
            "the reference's noise is unknown, and so not included in the uncertainty; give "
            "--reference-noise"
        )
    if found.psf is None:
        yield f"{source}: the uncertainty excludes the error of this PSF, which is not stated"
    if found.focus is None:
        yield (
            "the uncertainty excludes the scatter of the focus from capture to capture, which is "
            "unknown; give --focus-scatter"
        )
    if found.model is None:
        yield "model paper states no error of its own; matched and lmmse do"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedPhotograph(ByValue):
    """A simulated follow-up; ``numpy.asarray`` of it is its image.

    Parameters
    ----------
    image
        The follow-up as the camera would deliver it, float32, in the levels of the reference.
    followup
        The output of the capture model, before the camera's own effects; with masks if a
        homography was simulated.
    source, pose, model
        Name of the reference, pose in words, and capture model.
    zoom
        Ratio of the distances; None if a homography was simulated.
    kernel
        The kernel of a model that learns; None for the others.
    uncertainty
        Standard error of each pixel; None unless it was asked for.
    notes
        Remarks, one sentence each.
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
    uncertainty: SimulationUncertainty | None = None

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
        """Shares of pixels that would be sharper than the reference, and that it does not show.

        Those that it does not show are outside its frame, or hidden. None of them is stated of a
        flat scene that is merely further away.
        """
        followup = self.followup
        if self.zoom is not None and followup.hidden is None:
            return {}
        masks = (
            ("nearer", followup.nearer),
            ("outside", followup.outside),
            ("hidden", followup.hidden),
        )
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
            **self.mask_fractions,
            **learned,
            "uncertainty": None if self.uncertainty is None else self.uncertainty.to_json(),
            "provenance": self.provenance.model_dump(mode="json"),
        }

    def write(self, path: FilePath) -> None:
        """Write the image as a float32 TIFF, whole or not at all.

        Raises
        ------
        ArgumentError
            If the name ends in neither ``.tif`` nor ``.tiff``.
        ImageFileError
            If the file cannot be written.
        """
        description = f"standoff simulate: {self.how}, of {Path(self.source).name}"
        write_float_tiff(output_path(path, "path", FLOAT_IMAGES), self.image, description)

    def write_nearer(self, path: FilePath) -> None:
        """Write the mask of pixels that would be sharper than the reference, as PNG.

        Raises
        ------
        ArgumentError
            If the follow-up is merely further away, so that there are no such pixels.
        ImageFileError
            If the file cannot be written.
        """
        if self.followup.nearer is None:
            raise ArgumentError("only a follow-up with a homography has a mask of nearer pixels")
        write_mask(output_path(path, "path", {".png"}), self.followup.nearer)

    def write_hidden(self, path: FilePath) -> None:
        """Write the mask of pixels that see what the reference does not show, as PNG.

        Raises
        ------
        ArgumentError
            If the scene was taken as flat.
        ImageFileError
            If the file cannot be written.
        """
        if self.followup.hidden is None or self.followup.outside is None:
            raise ArgumentError("only a follow-up of a scene with depth has hidden pixels")
        hidden = self.followup.hidden | self.followup.outside
        write_mask(output_path(path, "path", {".png"}), hidden)

    def write_uncertainty(self, path: FilePath) -> None:
        """Write the standard error of each pixel as a float32 TIFF, whole or not at all.

        Raises
        ------
        ArgumentError
            If the standard error was not asked for.
        ImageFileError
            If the file cannot be written.
        """
        if self.uncertainty is None:
            raise ArgumentError("the uncertainty was not computed; simulate with uncertainty")
        description = (
            f"standoff simulate: standard error of {self.how}, of {Path(self.source).name}"
        )
        write_float_tiff(output_path(path, "path", FLOAT_IMAGES), self.uncertainty.err, description)

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the follow-up as a screen shows it."""
        return photograph_of(self.image, f"{Path(self.source).name}: {self.how}").plot(ax)


_LONG = ("provenance", "kernel_covariance_px2")
