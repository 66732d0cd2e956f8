"""How sure a d' is: its standard error by source, its interval, and what a threshold makes of it.

Everything is in ln d', whose errors add up; ``docs/how-sure.md`` derives the sums.
"""

from dataclasses import dataclass, field, fields
from functools import reduce
from math import exp, hypot, log, sqrt
from typing import Final, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri, stdtrit

from analysis.detectability.sensitivity import DPrimeSlopes
from analysis.results_file import StoredValues
from simulation.arguments import CheckedModel
from simulation.arrays import FloatArray

Source = Literal["scene", "psf", "focus", "noise", "registration"]

SOURCES: Final[tuple[Source, ...]] = ("scene", "psf", "focus", "noise", "registration")

SOURCE_WORDS: Final[dict[Source, str]] = {
    "scene": "the choice of photographs of the scene",
    "psf": "the PSF's calibration",
    "focus": "the focus from capture to capture",
    "noise": "the noise",
    "registration": "the registration",
}

STATED: Final = "stated"
"""What ``focus_from`` says of a scatter that somebody stated."""

NORMAL_95 = 1.959963984540054
_TAILS = 0.025, 0.975
_PARTS = 121
_LEAST_POWER = 0.02
"""Of the variance of a decision, what slopes leave at the least: beyond, they say too little."""
_SMOOTHED, _LEAST_ERR = 0.1, 1e-9


def student_factor(freedom: float) -> float:
    """Student's 97.5 % quantile over the normal one."""
    return float(stdtrit(freedom, 0.975)) / NORMAL_95


def _equal_parts(count: int) -> FloatArray:
    return (np.arange(count) + 0.5) / count


_NORMAL: Final[FloatArray] = np.asarray(ndtri(_equal_parts(41)) / np.std(ndtri(_equal_parts(41))))
"""Of a standard normal distribution, values of equal probability, of variance 1."""
_EXPONENTIAL: Final[FloatArray] = np.asarray(-np.log(_equal_parts(61)))
"""Of an exponential distribution of mean 1, likewise."""


class ErrorSources(CheckedModel, StoredValues):
    """What is known of a camera's errors; None where it is not, and then no interval holds it.

    Parameters
    ----------
    psf_variance_err_px2
        Standard error of the calibration's mean variance of the PSF.
    psf_focus_share
        What the focus of the calibration's own captures adds to that error, over their scatter; 0
        where ``psf_variance_err_px2`` holds it.
    focus_scatter_px2
        Standard deviation of that variance from capture to capture.
    focus_from
        What states it, in words.
    focus_freedom
        Degrees of freedom with which captures tell it; None where it is stated.
    noise_relative_err
        Standard error of the noise over the noise.
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
        """The scatter of the focus, widened by Student's quantile where captures tell it."""
        if self.focus_scatter_px2 is None or self.focus_freedom is None:
            return self.focus_scatter_px2
        return self.focus_scatter_px2 * student_factor(self.focus_freedom)

    @property
    def whole_psf_err_px2(self) -> float | None:
        """Standard error of the PSF's variance, with what its captures' focus leaves in it."""
        if self.psf_variance_err_px2 is None:
            return None
        return hypot(
            self.psf_variance_err_px2, self.psf_focus_share * (self.widened_scatter_px2 or 0.0)
        )

    @property
    def unknown(self) -> tuple[Source, ...]:
        """The sources of which nothing is known."""
        known = {
            "psf": self.psf_variance_err_px2,
            "focus": self.focus_scatter_px2,
            "noise": self.noise_relative_err,
            "registration": self.registration_err_px,
        }
        return tuple(name for name in SOURCES if name in known and known[name] is None)


class CurveUncertainty(StoredValues):
    """What a curve's interval is made of, at each of its zooms.

    Parameters
    ----------
    sources
        What is known of the camera's errors.
    scene
        Standard error of ln d' from the choice of photographs, widened by Student's quantile.
    slopes
        How d' follows the other errors.
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
        spreads: dict[Source, Spread] = {}
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
class Spread:
    """A distribution of additions to ln d', as values and their probabilities, shape (n,)."""

    values: FloatArray
    weights: FloatArray

    @property
    def variance(self) -> float:
        """Of the addition."""
        mean = float(self.weights @ self.values)
        return max(float(self.weights @ (self.values - mean) ** 2), 0.0)

    def plus(self, other: "Spread") -> "Spread":
        """Sum of two independent additions."""
        return Spread(
            values=np.add.outer(self.values, other.values).ravel(),
            weights=np.outer(self.weights, other.weights).ravel(),
        ).compressed()

    def compressed(self) -> "Spread":
        """The same distribution as the means of few parts of equal probability."""
        if len(self.values) <= _PARTS:
            return self
        order = np.argsort(self.values)
        weights = self.weights[order]
        part = np.minimum((np.cumsum(weights) - weights / 2) * _PARTS, _PARTS - 1).astype(np.int64)
        shares = np.bincount(part, weights, minlength=_PARTS)
        sums = np.bincount(part, weights * self.values[order], minlength=_PARTS)
        is_met = shares > 0
        return Spread(
            values=np.asarray(sums[is_met] / shares[is_met], np.float64),
            weights=np.asarray(shares[is_met], np.float64),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class DPrimeErrors:
    """Errors of ln d': variances of those that are normal, and distributions of the others."""

    variances: dict[Source, float]
    spreads: dict[Source, Spread] = field(default_factory=dict)

    @classmethod
    def of_interval(cls, low: float, d_prime: float, high: float) -> Self:
        """Errors that a 95 % interval stands for, of which the scene is the only known source."""
        if not 0 < low <= d_prime <= high:
            return cls(variances={"scene": 0.0})
        return cls(variances={"scene": (log(high / low) / (2 * NORMAL_95)) ** 2})

    @property
    def standard_error(self) -> float:
        """Of ln d', all sources together."""
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
        """Probability that the d' that a curve gives as ``d_prime`` reaches a threshold."""
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
    def _spread(self) -> Spread:
        return reduce(
            Spread.plus, self.spreads.values(), Spread(values=np.zeros(1), weights=np.ones(1))
        )

    def _below(self, addition: float) -> float:
        """Probability of a smaller addition to ln d'."""
        spread = self._spread
        # Between the values of a distribution that nothing else blurs, it is smooth as well.
        err = max(self._normal_err, _SMOOTHED * sqrt(spread.variance), _LEAST_ERR)
        return float(spread.weights @ ndtr((addition - spread.values) / err))


def focus_spread(slopes: DPrimeSlopes, scatter_px2: float) -> Spread:
    """What two photographs, each with a focus of its own, make of ln d'.

    Parameters
    ----------
    slopes
        Of d'.
    scatter_px2
        Standard deviation of the variance that focus adds, from capture to capture.
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
    return Spread(values=values.ravel(), weights=np.full(values.size, 1 / values.size)).compressed()


def registration_spread(share: float) -> Spread:
    """What a registration error makes of ln d'.

    ``share`` is what its mean square adds to the variance of the decision, over that. Half the sum
    of the squares along both axes is exponentially distributed.
    """
    values = -0.5 * np.log1p(max(share, 0.0) * _EXPONENTIAL)
    return Spread(values=values, weights=np.full(values.size, 1 / values.size))
