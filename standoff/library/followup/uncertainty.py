"""The standard error of a simulated photograph, from what its inputs say of themselves."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from typing import Any

import numpy as np

from calibration.psf import focus_scatter_px2, psf_steps
from simulation.arguments import check_fields
from simulation.arrays import AnyArray, Float32Array, FloatArray
from simulation.capture_noise import CaptureNoise
from simulation.followup import CaptureOptions, FollowUp, light_on
from simulation.psf import Psf, PsfField
from simulation.uncertainty import (
    SOURCES,
    KnownErrors,
    PixelUncertainty,
    SimulatedView,
    pixel_uncertainty,
)
from standoff.errors import ApplicationError
from standoff.library.call import Call
from standoff.library.inputs import NoiseLike, PsfLike, camera_noise
from standoff.library.psf import calibration_of
from standoff.photographs import Photograph


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyOptions:
    """What is known of a simulation's inputs beyond what they say themselves.

    Parameters
    ----------
    reference_noise
        Noise of the reference: a noise.json, what it says, or a standard deviation in DN. By
        default the noise that the simulation adds, or that of a capture with several frames.
    focus_scatter_px2
        Standard deviation, from capture to capture, of the PSF's variance; by default that of the
        calibration.

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
    """Standard error of each pixel of a simulated photograph.

    Parameters
    ----------
    err
        Standard error in the photograph's levels, of its shape; NaN outside the reference.
    pixels
        Variances by source.
    focus_scatter_px2
        What was reckoned with; None if it is not known.
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
    """A simulation that was done: what was simulated, from what, and how it was delivered."""

    view: SimulatedView
    photograph: Photograph
    reference: AnyArray
    psf: Psf | PsfField
    followup: FollowUp
    camera: CaptureOptions
    noise: CaptureNoise | None
    is_corrected: bool = False


def simulation_uncertainty(
    call: Call, done: Simulation, psf: PsfLike, options: UncertaintyOptions
) -> SimulationUncertainty:
    """Return the standard error of a simulated photograph; what is not known is noted.

    Parameters
    ----------
    call
        Takes the notes.
    done
        The simulation.
    psf
        What its PSF was taken from.
    options
        What else is known.

    Raises
    ------
    ApplicationError
        If nothing is known of any error.
    ValueError
        If a number in ``options`` is out of range.
    """
    calibration = calibration_of(psf)
    scatter = options.focus_scatter_px2
    if scatter is None and calibration is not None:
        scatter = focus_scatter_px2(calibration)
    errors = KnownErrors(
        noise_dn2=_reference_noise(done, options.reference_noise),
        psf_steps=None
        if calibration is None
        else psf_steps(calibration, done.psf, max(done.view.zoom, 1.0)),
        focus_scatter_px2=scatter,
    )
    found = pixel_uncertainty(
        done.view, done.reference, done.psf, errors, outside=done.followup.outside
    )
    found = _delivered(found, done)
    err = found.err
    if err is None:
        raise ApplicationError(
            f"{done.photograph.name}: nothing is known of any error of this simulation; give "
            "--reference-noise, --focus-scatter or a psf.json with standard errors"
        )
    for note in _notes(found, psf):
        call.note(note)
    return SimulationUncertainty(
        err=err.astype(np.float32), pixels=found, focus_scatter_px2=scatter
    )


def _reference_noise(done: Simulation, given: NoiseLike | float | None) -> FloatArray | None:
    """Variance of the reference's noise in each pixel; None if it is not known."""
    levels = np.asarray(done.reference, dtype=np.float64)
    if isinstance(given, int | float):
        return np.full(levels.shape, float(given) ** 2)
    noise = camera_noise(given) or done.noise
    if noise is not None:
        return noise.variance_dn2(levels)
    if done.is_corrected:
        return None  # the variance is that of the levels before a flat field divided them
    own, frames = done.photograph.variance_dn2, done.photograph.frames
    return own / frames if own is not None and own.shape == levels.shape else None


def _delivered(found: PixelUncertainty, done: Simulation) -> PixelUncertainty:
    """The uncertainty of the image as the camera delivers it: its light, and noise added to it."""
    followup, noise = done.followup, done.noise
    light = light_on(done.camera, followup.image.shape)
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
            "the reference's noise is not known and not in the uncertainty; give --reference-noise"
        )
    if found.psf is None:
        yield f"{source}: the error of this PSF is not stated and not in the uncertainty"
    if found.focus is None:
        yield (
            "how far the focus differs from capture to capture is not known and not in the "
            "uncertainty; give --focus-scatter"
        )
    if found.model is None:
        yield "model paper states no error of its own; matched and lmmse do"
