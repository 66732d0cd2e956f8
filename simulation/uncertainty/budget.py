"""The standard error of a simulated follow-up at each pixel, and where it comes from."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite

import numpy as np

from simulation.arrays import AnyArray, BoolArray, FloatArray
from simulation.psf import Psf, PsfField
from simulation.uncertainty.curvature import second_derivatives
from simulation.uncertainty.expected_error import model_variance
from simulation.uncertainty.psf_steps import PsfStep
from simulation.uncertainty.view import SimulatedView

SOURCES = ("noise", "psf", "focus", "model")
_ADDED = "added_noise"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownErrors:
    """What is known of the errors of a simulation's inputs; None for what is not.

    Parameters
    ----------
    noise_dn2
        Variance of the reference's noise in each pixel, of its shape, independent of each other.
    psf_steps
        Independent steps of one standard error of the PSF.
    focus_scatter_px2
        Standard deviation, from capture to capture, of the PSF's variance along either axis.

    Raises
    ------
    ValueError
        If a variance or the scatter is negative or not finite.
    """

    noise_dn2: FloatArray | None = None
    psf_steps: Sequence[PsfStep] | None = None
    focus_scatter_px2: float | None = None

    def __post_init__(self) -> None:
        scatter = self.focus_scatter_px2
        if scatter is not None and not (scatter >= 0 and isfinite(scatter)):
            raise ValueError(f"focus_scatter_px2 must not be negative, got {scatter}")
        noise = self.noise_dn2
        if noise is not None and not (np.isfinite(noise).all() and np.all(noise >= 0)):
            raise ValueError("the variances of the noise must be finite and not negative")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelUncertainty:
    """Variance of each pixel of a simulated follow-up, by source.

    Parameters
    ----------
    noise, psf, focus
        What the reference's noise, the PSF's statistical error and the focus of both photographs
        contribute; None for what is not known.
    model
        Squared error that the model expects of itself; None for a model that states none. It is an
        average over scenes of one kind, and not the error of this one.
    outside
        Pixels that show nothing of the reference: their errors are NaN.
    added_noise
        What was added to the follow-up as the noise of a capture; None for nothing.
    """

    noise: FloatArray | None = field(repr=False)
    psf: FloatArray | None = field(repr=False)
    focus: FloatArray | None = field(repr=False)
    model: FloatArray | None = field(repr=False)
    outside: BoolArray | None = field(default=None, repr=False)
    added_noise: FloatArray | None = field(default=None, repr=False)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Sources that are not in it."""
        return tuple(name for name in SOURCES if getattr(self, name) is None)

    @property
    def err(self) -> FloatArray | None:
        """Standard error of each pixel by all sources known; None if there are none."""
        return self._err((*SOURCES, _ADDED))

    @property
    def err_without_model(self) -> FloatArray | None:
        """Standard error without the model's own stated error."""
        return self._err((*SOURCES[:-1], _ADDED))

    def median_err(self, source: str) -> float | None:
        """Median over the follow-up of the standard error by one source; None if not known."""
        err = self._err((source,))
        return None if err is None else float(np.nanmedian(err))

    def scaled(self, light: FloatArray | float) -> "PixelUncertainty":
        """Return that of the follow-up with ``light`` times the light."""
        square = np.asarray(light) ** 2
        known = {name: getattr(self, name) for name in (*SOURCES, _ADDED)}
        return PixelUncertainty(
            **{name: None if one is None else one * square for name, one in known.items()},
            outside=self.outside,
        )

    def _err(self, sources: Sequence[str]) -> FloatArray | None:
        known = [one for one in (getattr(self, name) for name in sources) if one is not None]
        if not known:
            return None
        err = np.sqrt(np.sum(known, axis=0))
        if self.outside is not None:
            err[self.outside] = np.nan
        return np.asarray(err)


def pixel_uncertainty(
    view: SimulatedView,
    reference: AnyArray,
    psf: Psf | PsfField,
    errors: KnownErrors,
    outside: BoolArray | None = None,
) -> PixelUncertainty:
    """Propagate the errors of a simulation's inputs to each pixel of it.

    Parameters
    ----------
    view
        What is simulated, and by which model.
    reference
        Shape ``(rows, cols)`` or ``(rows, cols, channels)``, linear in light.
    psf
        As calibrated.
    errors
        What is known of noise, PSF and focus.
    outside
        Pixels of the follow-up that show nothing of the reference.

    Raises
    ------
    ValueError
        As the simulation itself.
    """
    exact = np.asarray(reference, dtype=np.float64)
    noise = errors.noise_dn2
    return PixelUncertainty(
        noise=None if noise is None else view.noise_variance(noise, psf),
        psf=None if errors.psf_steps is None else _psf_variance(view, exact, errors.psf_steps),
        focus=_focus_variance(view, exact, psf, errors.focus_scatter_px2),
        model=_model_variance(view, exact, psf, noise),
        outside=outside,
    )


def _psf_variance(
    view: SimulatedView, reference: FloatArray, steps: Sequence[PsfStep]
) -> FloatArray:
    variance = np.zeros((view.size[1], view.size[0], *reference.shape[2:]))
    for step in steps:
        change = view.rendered(reference, step.plus) - view.rendered(reference, step.minus)
        variance += (change / step.length) ** 2
    return variance


def _focus_variance(
    view: SimulatedView,
    reference: FloatArray,
    psf: Psf | PsfField,
    scatter_px2: float | None,
) -> FloatArray | None:
    """Variance by the focus of the reference and, independent of it, of the follow-up."""
    if scatter_px2 is None:
        return None
    xx, xy, yy = (view.rendered(part, psf) for part in second_derivatives(reference))
    stretch = view.survey()[..., 2:]
    if reference.ndim == 3:
        stretch = stretch[:, :, None, :]
    far = stretch[..., 0] * xx + 2 * stretch[..., 1] * xy + stretch[..., 2] * yy
    near = xx + yy
    return np.asarray((0.5 * scatter_px2) ** 2 * (far**2 + near**2))


def _model_variance(
    view: SimulatedView, reference: FloatArray, psf: Psf | PsfField, noise: FloatArray | None
) -> FloatArray | None:
    if reference.ndim == 2:
        return model_variance(view, psf, reference, noise)
    planes = [
        model_variance(view, psf, reference[:, :, k], None if noise is None else noise[:, :, k])
        for k in range(reference.shape[2])
    ]
    known = [plane for plane in planes if plane is not None]
    return np.stack(known, axis=-1) if known else None
