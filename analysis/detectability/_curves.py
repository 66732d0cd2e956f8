"""curves.json: curves of d' against zoom, how to select them, and how sure they are.

Errors of d' are in ln d', where they add up; ``docs/how-sure.md`` derives the sums.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from functools import reduce
from math import ceil, exp, hypot, log, sqrt
from typing import TYPE_CHECKING, Any, Final, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from acquisition.dataframe import dataframe
from analysis.choices import CurveObserver
from analysis.detectability._dprime import DPrimeSlopes, d_prime_between, student_factor
from analysis.errors import AnalysisError, NotDetectableError, ResultsFileError
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import read_document
from calibration.estimate import NORMAL_95
from simulation import Model
from simulation.arguments import CheckedModel, FilePath, checked
from simulation.arrays import FloatArray
from simulation.choices import PsfForm
from simulation.notebook import html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame


Source = Literal["scene", "psf", "focus", "noise", "registration"]

SOURCE_WORDS: Final[dict[Source, str]] = {
    "scene": "the choice of photographs of the scene",
    "psf": "the PSF's calibration",
    "focus": "the focus from capture to capture",
    "noise": "the noise",
    "registration": "the registration",
}

STATED: Final = "stated"
"""What ``focus_from`` says of a scatter that somebody stated."""

_TAILS = 0.025, 0.975
_PARTS = 121
_LEAST_POWER = 0.02
"""Of the variance of a decision, what slopes leave at the least: beyond, they say too little."""
_SMOOTHED, _LEAST_ERR = 0.1, 1e-9


def _equal_parts(count: int) -> FloatArray:
    return (np.arange(count) + 0.5) / count


_NORMAL: Final[FloatArray] = np.asarray(ndtri(_equal_parts(41)) / np.std(ndtri(_equal_parts(41))))
"""Of a standard normal distribution, values of equal probability, of variance 1."""
_EXPONENTIAL: Final[FloatArray] = np.asarray(-np.log(_equal_parts(61)))
"""Of an exponential distribution of mean 1, likewise."""


class ErrorSources(CheckedModel, StoredValues):
    """Errors of a camera; one that is not known is None, and no interval includes it.

    Parameters
    ----------
    psf_variance_err_px2
        Standard error of the PSF's variance, mean of x and y, by its calibration.
    psf_focus_share
        Error that the focus of the calibration's own captures adds to it, in units of
        ``focus_scatter_px2``; 0 if ``psf_variance_err_px2`` includes it.
    focus_scatter_px2
        Standard deviation of the PSF's variance from capture to capture.
    focus_from
        Source of ``focus_scatter_px2``, in words.
    focus_freedom
        Its degrees of freedom, if captures give it; None if it is stated.
    noise_relative_err
        Standard error of the noise, relative to the noise.
    registration_err_px
        Standard deviation of a pair's registration error along either axis.
    """

    psf_variance_err_px2: float | None = Field(default=None, ge=0)
    psf_focus_share: float = Field(default=0.0, ge=0)
    focus_scatter_px2: float | None = Field(default=None, ge=0)
    focus_from: str | None = None
    focus_freedom: float | None = Field(default=None, ge=1)
    noise_relative_err: float | None = Field(default=None, ge=0)
    registration_err_px: float | None = Field(default=None, ge=0)

    @property
    def widened_scatter_px2(self) -> float | None:
        """The focus scatter, widened by Student's quantile if it comes from captures."""
        if self.focus_scatter_px2 is None or self.focus_freedom is None:
            return self.focus_scatter_px2
        return self.focus_scatter_px2 * student_factor(self.focus_freedom)

    @property
    def whole_psf_err_px2(self) -> float | None:
        """Standard error of the PSF's variance, with the error by the focus of its captures."""
        if self.psf_variance_err_px2 is None:
            return None
        return hypot(
            self.psf_variance_err_px2, self.psf_focus_share * (self.widened_scatter_px2 or 0.0)
        )

    @property
    def unknown(self) -> tuple[Source, ...]:
        """The sources of error that are not known."""
        known: dict[Source, float | None] = {
            "psf": self.psf_variance_err_px2,
            "focus": self.focus_scatter_px2,
            "noise": self.noise_relative_err,
            "registration": self.registration_err_px,
        }
        return tuple(name for name, value in known.items() if value is None)


class CurveUncertainty(StoredValues):
    """Components of a curve's interval, at each of its zooms.

    Parameters
    ----------
    sources
        The camera's errors, as far as they are known.
    scene
        Standard error of ln d' from the choice of photographs, widened by Student's quantile.
    slopes
        Derivatives of d' with respect to the other errors.
    """

    sources: ErrorSources = ErrorSources()
    scene: list[float]
    slopes: list[DPrimeSlopes]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.scene) != len(self.slopes):
            raise ValueError("an uncertainty must have as many slopes as errors of the scene")
        return self

    def slopes_at(self, zooms: list[float], zoom: float) -> DPrimeSlopes:
        """Slopes at a zoom, linear between those at the curve's."""

        def at(name: str) -> float:
            return float(np.interp(zoom, zooms, [getattr(one, name) for one in self.slopes]))

        return DPrimeSlopes(**{one.name: at(one.name) for one in fields(DPrimeSlopes)})

    def errors(self, zooms: list[float], zoom: float) -> "DPrimeErrors":
        """Errors of ln d' at a zoom."""
        known, slopes = self.sources, self.slopes_at(zooms, zoom)
        variances: dict[Source, float] = {"scene": float(np.interp(zoom, zooms, self.scene)) ** 2}
        if known.whole_psf_err_px2 is not None:
            variances["psf"] = (slopes.psf_per_px2 * known.whole_psf_err_px2) ** 2
        if known.noise_relative_err is not None:
            variances["noise"] = (slopes.noise * known.noise_relative_err) ** 2
        spreads: dict[Source, _Spread] = {}
        if known.widened_scatter_px2:
            spreads["focus"] = focus_spread(slopes, known.widened_scatter_px2)
        if known.registration_err_px:
            share = slopes.registration_per_px2 * known.registration_err_px**2
            spreads["registration"] = registration_spread(share)
        return DPrimeErrors(variances=variances, spreads=spreads)


class BudgetShare(StoredValues):
    """Share of a source in the variance of ln d', from 0 to 1."""

    source: Source
    share: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Spread:
    """A distribution of additions to ln d', as values and their probabilities, shape (n,)."""

    values: FloatArray
    weights: FloatArray

    @property
    def variance(self) -> float:
        """Of the addition."""
        mean = float(self.weights @ self.values)
        return max(float(self.weights @ (self.values - mean) ** 2), 0.0)

    def plus(self, other: "_Spread") -> "_Spread":
        """Sum of two independent additions."""
        return _Spread(
            values=np.add.outer(self.values, other.values).ravel(),
            weights=np.outer(self.weights, other.weights).ravel(),
        ).compressed()

    def compressed(self) -> "_Spread":
        """The same distribution as the means of few parts of equal probability."""
        if len(self.values) <= _PARTS:
            return self
        order = np.argsort(self.values)
        weights = self.weights[order]
        part = np.minimum((np.cumsum(weights) - weights / 2) * _PARTS, _PARTS - 1).astype(np.int64)
        shares = np.bincount(part, weights, minlength=_PARTS)
        sums = np.bincount(part, weights * self.values[order], minlength=_PARTS)
        is_met = shares > 0
        return _Spread(
            values=np.asarray(sums[is_met] / shares[is_met], np.float64),
            weights=np.asarray(shares[is_met], np.float64),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class DPrimeErrors:
    """Errors of ln d': variances of those that are normal, and distributions of the others."""

    variances: dict[Source, float]
    spreads: dict[Source, _Spread] = field(default_factory=dict)

    @classmethod
    def of_interval(cls, low: float, d_prime: float, high: float) -> Self:
        """Errors that correspond to a 95 % interval, all of them attributed to the scene."""
        if not 0 < low <= d_prime <= high:
            return cls(variances={"scene": 0.0})
        return cls(variances={"scene": (log(high / low) / (2 * NORMAL_95)) ** 2})

    @property
    def standard_error(self) -> float:
        """Standard error of ln d', all sources together."""
        return sqrt(sum(self._by_source.values()))

    @property
    def budget(self) -> tuple[BudgetShare, ...]:
        """Shares of the sources, the largest first."""
        whole = sum(self._by_source.values())
        shares = [
            BudgetShare(source=name, share=one / whole if whole > 0 else 0.0)
            for name, one in self._by_source.items()
        ]
        return tuple(sorted(shares, key=lambda one: -one.share))

    def interval(self, d_prime: float) -> tuple[float, float]:
        """The 95 % interval of a d'."""
        reach = NORMAL_95 * self._normal_err
        if not self.spreads:
            return d_prime * exp(-reach), d_prime * exp(reach)
        spread = self._spread
        bounds = (
            float(spread.values.min()) - 2 * reach - 1,
            float(spread.values.max()) + 2 * reach + 1,
        )
        low, high = (
            brentq(lambda x, share=share: self._below(x) - share, *bounds, xtol=1e-7)
            for share in _TAILS
        )
        return d_prime * exp(low), d_prime * exp(high)

    def probability_of(self, min_d_prime: float, d_prime: float) -> float:
        """Probability that d' reaches a threshold where the curve gives ``d_prime``."""
        if d_prime <= 0:
            return 0.0
        margin = log(d_prime / min_d_prime)
        if not self.spreads and self._normal_err == 0:
            return float(margin >= 0)
        return min(max(1 - self._below(-margin), 0.0), 1.0)

    @property
    def _by_source(self) -> dict[Source, float]:
        return {**self.variances, **{name: one.variance for name, one in self.spreads.items()}}

    @property
    def _normal_err(self) -> float:
        return sqrt(sum(self.variances.values()))

    @property
    def _spread(self) -> _Spread:
        return reduce(
            _Spread.plus, self.spreads.values(), _Spread(values=np.zeros(1), weights=np.ones(1))
        )

    def _below(self, addition: float) -> float:
        """Probability of a smaller addition to ln d'."""
        spread = self._spread
        # Between the values of a distribution that nothing else blurs, it is smooth as well.
        err = max(self._normal_err, _SMOOTHED * sqrt(spread.variance), _LEAST_ERR)
        return float(spread.weights @ ndtr((addition - spread.values) / err))


def focus_spread(slopes: DPrimeSlopes, scatter_px2: float) -> _Spread:
    """Distribution of what the focus errors of the two photographs add to ln d'.

    ``scatter_px2``: standard deviation of the variance that focus adds, from capture to capture.
    """
    f, r = np.meshgrid(scatter_px2 * _NORMAL, scatter_px2 * _NORMAL)
    power = (
        1
        + 2 * slopes.with_followup_per_px2 * f
        + 2 * slopes.with_reference_per_px2 * r
        + slopes.followup_per_px4 * f**2
        + slopes.reference_per_px4 * r**2
        + 2 * slopes.both_per_px4 * f * r
    )
    values = slopes.signal_per_px2 * f - 0.5 * np.log(np.maximum(power, _LEAST_POWER))
    return _Spread(
        values=values.ravel(), weights=np.full(values.size, 1 / values.size)
    ).compressed()


def registration_spread(share: float) -> _Spread:
    """Distribution of what a registration error adds to ln d'.

    ``share`` is the relative increase of the decision's variance by the mean square of the error.
    Half the sum of the squares along both axes is exponentially distributed.
    """
    values = -0.5 * np.log1p(max(share, 0.0) * _EXPONENTIAL)
    return _Spread(values=values, weights=np.full(values.size, 1 / values.size))


_CURVES_SCHEMA: Final = "standoff.detectability/1"

_ENOUGH = 0.1
"""Half of an interval of d', over d', that is narrow enough."""

_SEEN = ("seen_sigma_px", "seen_dn")
_ALONG_ZOOM = ("dprime", "dprime_low", "dprime_high", "auc")
_SCENE = ("dprime_low_scene", "dprime_high_scene")

_NOTE = (
    "Every d' is an upper bound: sampling, sharpness, noise and the artefact of the alignment are "
    "in the model; exposure, registration error, gloss, parallax, defocus and motion are not. "
    "Between two zooms, 1/d' is interpolated linearly."
)


class AmbiguousCurveError(AnalysisError, ValueError):
    """A `CurveChoice` matches more than one curve, or none.

    ``fitting`` are the matching curves, ``open_choices`` the values in which they differ, by name.
    """

    def __init__(
        self,
        message: str,
        *,
        fitting: tuple["DetectabilityCurve", ...],
        open_choices: dict[str, tuple[str | float, ...]],
    ) -> None:
        super().__init__(message)
        self.fitting = fitting
        self.open_choices = open_choices


class CurveChoice(CheckedModel, StoredValues):
    """Selects one curve by model, observer, noise and contrast in DN; None matches any value.

    Examples
    --------
    >>> choice = standoff.CurveChoice(observer="hotelling", noise_dn=12.0)
    """

    model: Model | None = None
    observer: CurveObserver | None = None
    noise_dn: float | None = None
    contrast_dn: float | None = None


class DetectabilityCurve(StoredValues):
    """d' against zoom for one model, observer, noise and contrast; an upper bound.

    ``dprime_low`` and ``dprime_high`` are the 95 % interval with every error that ``uncertainty``
    holds; those ending in ``_scene`` include only the choice of photographs, as do all in older
    files. For observer ``changes``, d' is what a comparison of photographs is expected to reach;
    ``seen_sigma_px`` and ``seen_dn`` are the width, in follow-up px, and the peak with which the
    follow-up shows a Gaussian change; None for others. For observer ``detector``, it is the d' with
    the AUC of the detector that ``detector`` names, and not a bound.
    """

    model: Model
    observer: CurveObserver
    detector: str | None = Field(default=None, exclude=True)
    noise_dn: float = Field(gt=0)
    contrast_dn: float = Field(gt=0)
    signal_sigma_px: float | None
    zoom: list[float] = Field(min_length=1)
    dprime: list[float]
    dprime_low: list[float]
    dprime_high: list[float]
    dprime_low_scene: list[float] | None = None
    dprime_high_scene: list[float] | None = None
    auc: list[float]
    uncertainty: CurveUncertainty | None = Field(default=None, repr=False)
    seen_sigma_px: list[float] | None = None
    seen_dn: list[float] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in (*_ALONG_ZOOM, *_SCENE):
            values = getattr(self, name)
            if values is not None and len(values) != len(self.zoom):
                raise ValueError(f"{name} has {len(values)} values, zoom {len(self.zoom)}")
        if self.uncertainty is not None and len(self.uncertainty.scene) != len(self.zoom):
            raise ValueError("uncertainty must have a value at each zoom")
        for name in _SEEN:
            seen = getattr(self, name)
            if seen is not None and (len(seen) != len(self.zoom) or not min(seen) > 0):
                raise ValueError(f"{name} must be positive at each zoom")
        if self.zoom[0] < 1 or any(np.diff(self.zoom) <= 0):
            raise ValueError("zoom must increase and start at 1 or more")
        if min(*self.dprime, *self.dprime_low, *self.dprime_high) < 0:
            raise ValueError("d' and its interval must not be negative")
        return self

    def __repr__(self) -> str:
        first, last = (f"{self.dprime[k]:.3g} at zoom {self.zoom[k]:g}" for k in (0, -1))
        return f"<d' of {self.name}: {first}, {last}>"

    @property
    def choice(self) -> CurveChoice:
        """The choice that selects this curve from a file."""
        return CurveChoice(
            model=self.model,
            observer=self.observer,
            noise_dn=self.noise_dn,
            contrast_dn=self.contrast_dn,
        )

    @property
    def name(self) -> str:
        """Description of the curve, in words."""
        return (
            f"{self.model}, {self.detector or self.observer}, noise {self.noise_dn:g} DN, "
            f"contrast {self.contrast_dn:g} DN"
        )

    def d_prime_at(self, zoom: FloatArray | float) -> FloatArray:
        """Interpolate d' between the curve's zooms, 1/d' linear in zoom; NaN beyond the last zoom.

        Below the first zoom, and below 1, the first value holds: a nearer follow-up is no worse.
        ``d_prime_between`` says why.
        """
        value = self.between(self.dprime, zoom)
        return np.asarray(np.where(np.asarray(zoom) > self.zoom[-1] + 1e-9, np.nan, value))

    def with_sources(self, sources: ErrorSources) -> "DetectabilityCurve":
        """Return the curve with the interval that follows from these errors of the camera.

        A curve of an older file, which has no ``uncertainty``, is returned unchanged.
        """
        if self.uncertainty is None:
            return self
        known = self.uncertainty.model_copy(update={"sources": sources})
        ends = [
            known.errors(self.zoom, zoom).interval(d_prime)
            for zoom, d_prime in zip(self.zoom, self.dprime, strict=True)
        ]
        low, high = ([end[k] for end in ends] for k in (0, 1))
        update = {"uncertainty": known, "dprime_low": low, "dprime_high": high}
        return self.model_copy(update=update)

    def knowing(
        self, *, focus_scatter_px2: float | None = None, registration_err_px: float | None = None
    ) -> "DetectabilityCurve":
        """Return the curve with these errors in its interval; None leaves an error as it is."""
        if self.uncertainty is None:
            return self
        known: dict[str, object] = {}
        if focus_scatter_px2 is not None:
            known = {
                "focus_scatter_px2": focus_scatter_px2,
                "focus_from": STATED,
                "focus_freedom": None,
            }
        if registration_err_px is not None:
            known["registration_err_px"] = registration_err_px
        return self.with_sources(self.uncertainty.sources.model_copy(update=known))

    def errors_at(self, zoom: float) -> DPrimeErrors:
        """Return the errors of ln d' at a zoom; for an older curve, those in its interval."""
        if self.uncertainty is not None:
            return self.uncertainty.errors(self.zoom, zoom)
        low, middle, high = (
            float(self.between(values, zoom))
            for values in (self.dprime_low, self.dprime, self.dprime_high)
        )
        return DPrimeErrors.of_interval(low, middle, high)

    def between(self, values: ArrayLike, zoom: ArrayLike) -> FloatArray:
        """Interpolate values given at the curve's zooms in the same way as d'."""
        return d_prime_between(self.zoom, values, zoom)

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of d' against zoom with its interval."""
        from analysis.detectability._plot import curves_figure  # matplotlib, for whoever looks

        return curves_figure([self], "noise_dn", ax)

    def largest_zoom(self, min_dprime: float) -> float | None:
        """Largest zoom up to which ``d_prime_at`` stays at the threshold or above.

        None if d' is below from the start; the last zoom of the curve if d' never falls below.
        """
        below = np.flatnonzero(np.asarray(self.dprime) < min_dprime)
        if len(below) == 0:
            return self.zoom[-1]
        first = int(below[0])
        if first == 0:
            return None
        (z0, z1), (d0, d1) = self.zoom[first - 1 : first + 1], self.dprime[first - 1 : first + 1]
        # (1/m - 1/d0) / (1/d1 - 1/d0), without a division by a d1 of 0.
        return z0 + (z1 - z0) * (d1 / min_dprime) * ((d0 - min_dprime) / (d0 - d1))

    def contrast_found(self, zoom: float, min_dprime: float) -> float:
        """Least contrast in DN at which d' reaches ``min_dprime`` at a zoom.

        Raises
        ------
        NotDetectableError
            If d' is 0 there: no contrast will do.
        """
        d_prime = float(self.d_prime_at(zoom))
        if d_prime == 0:
            raise NotDetectableError(
                f"d' is 0 at zoom {zoom:.3g}: no contrast is detectable there",
                zoom=zoom,
                d_prime=0.0,
            )
        return self.contrast_dn * min_dprime / d_prime


class DetectabilityCurves(ResultsDocument):
    """Curves of several models, observers, noises and contrasts: the document of curves.json.

    ``images`` to ``psf_form`` say what the curves were computed from; None if not known.
    ``photographs_needed`` is the approximate number of photographs of the scene with which the 95 %
    interval of every d' would be within 10 %; None if the present number suffices.
    """

    schema_name: Literal["standoff.detectability/1"] = Field(default=_CURVES_SCHEMA, alias="schema")
    note: str = _NOTE
    images: int | None = None
    reference_zoom: float | None = None
    window_px: int | None = None
    signal: str | None = None
    psf_form: PsfForm | None = None
    photographs_needed: int | None = None
    curves: list[DetectabilityCurve] = Field(min_length=1)

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(f"{one.model} {one.observer}" for one in self.curves))
        zooms = self.curves[0].zoom
        return f"<{len(self.curves)} curves of d', zoom {zooms[0]:g} to {zooms[-1]:g}: {kinds}>"

    @property
    def _worst_scene(self) -> tuple[float, str]:
        """Half of the widest 95 % interval that photographs leave, over d', and where it is."""
        known = [
            (NORMAL_95 * err, f"{curve.name}, zoom {zoom:g}")
            for curve in self.curves
            if curve.uncertainty is not None
            for zoom, err in zip(curve.zoom, curve.uncertainty.scene, strict=True)
        ]
        return max(known, default=(0.0, ""))

    @property
    def too_few_sentence(self) -> str | None:
        """Remark if the photographs are too few; None if they are not."""
        half_width, where = self._worst_scene
        if self.photographs_needed is None:
            return None
        have = "1 photograph leaves" if self.images == 1 else f"{self.images} photographs leave"
        return (
            f"{have} d' uncertain by up to {100 * half_width:.0f} % (95 %; {where}); about "
            f"{self.photographs_needed} of the scene would bring that below {100 * _ENOUGH:.0f} %"
        )

    @property
    def unknown_sentence(self) -> str | None:
        """Remark on errors that are not known, so that no interval includes them; None without."""
        known = self.curves[0].uncertainty
        if known is None or not known.sources.unknown:
            return None
        named = " and ".join(SOURCE_WORDS[name] for name in known.sources.unknown)
        return f"unknown, and so not included in the intervals: {named}"

    def with_need(self) -> "DetectabilityCurves":
        """Return the curves with ``photographs_needed``."""
        half_width, _ = self._worst_scene
        if self.images is None or half_width <= _ENOUGH:
            return self
        needed = ceil(self.images * (half_width / _ENOUGH) ** 2)
        return self.model_copy(update={"photographs_needed": needed})

    def _repr_html_(self) -> str:
        rows = [(one.name, *(f"{d_prime:.3g}" for d_prime in one.dprime)) for one in self.curves]
        zooms = (f"{zoom:g}" for zoom in self.curves[0].zoom)
        return html_table("d' against zoom, an upper bound", ("zoom", *zooms), rows)

    def to_dataframe(self) -> "DataFrame":
        """Return the curves as a pandas table, one row per curve and zoom.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(self.rows())

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield the lines of the table, one for each curve and zoom."""
        each = ("zoom", *_ALONG_ZOOM)
        for curve in self.curves:
            shared = curve.model_dump(exclude={*each, *_SEEN, *_SCENE, "uncertainty"})
            for values in zip(*(getattr(curve, name) for name in each), strict=True):
                yield {**shared, **dict(zip(each, values, strict=True))}

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of d' against zoom by noise (Figure 4), else by contrast (Figure 5)."""
        from analysis.detectability._plot import curves_figure  # matplotlib, for whoever looks

        first = self.curves[0]
        if any(one.noise_dn != first.noise_dn for one in self.curves):
            shown = [one for one in self.curves if one.contrast_dn == first.contrast_dn]
            return curves_figure(shown, "noise_dn", ax)
        return curves_figure(self.curves, "contrast_dn", ax)

    def chosen(self, choice: CurveChoice) -> DetectabilityCurve:
        """Return the one curve that matches a choice.

        Raises
        ------
        AmbiguousCurveError
            If no curve or more than one matches; the message says how they differ.
        """
        wanted = choice.model_dump(exclude_none=True)
        fitting = [
            curve
            for curve in self.curves
            if all(_agrees(getattr(curve, name), value) for name, value in wanted.items())
        ]
        if len(fitting) == 1:
            return fitting[0]
        among = fitting or self.curves
        open_choices = {
            name: values
            for name in CurveChoice.model_fields
            if len(values := tuple(sorted({getattr(curve, name) for curve in among}))) > 1
        }
        told = [
            f"--{name.removesuffix('_dn')} ("
            + ", ".join(f"{one:g}" if isinstance(one, float) else str(one) for one in values)
            + ")"
            for name, values in open_choices.items()
        ]
        choices = " and ".join(told)
        remedy = f"choose one with {choices}" if told else "they do not differ; use another file"
        message = (
            f"{len(fitting)} curves match; {remedy}"
            if fitting
            else f"no curve matches; there are {'; '.join(curve.name for curve in self.curves[:8])}"
        )
        raise AmbiguousCurveError(message, fitting=tuple(fitting), open_choices=open_choices)


@checked
def read_curves(path: FilePath) -> DetectabilityCurves:
    """Read a curves.json.

    Parameters
    ----------
    path
        Path of the file, as ``write_curves`` and ``standoff detectability`` write it.

    Returns
    -------
    DetectabilityCurves
        The curves; functions with ``curve=`` take them.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> len(standoff.read_curves("curves.json").curves)
    1
    """
    return read_document(
        path, DetectabilityCurves, ResultsFileError, "write it with standoff detectability"
    )


def _agrees(value: object, wanted: object) -> bool:
    if isinstance(value, float) and isinstance(wanted, float):
        return abs(value - wanted) <= 1e-6 * max(abs(wanted), 1.0)
    return value == wanted
