"""How sure a d' is: its standard error by source, its interval, and what a threshold makes of it.

Everything is in ln d', whose errors add up; ``docs/how-sure.md`` derives the sums.
"""

from dataclasses import dataclass
from math import exp, inf, log, sqrt
from typing import Final, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.special import ndtr

from analysis.detectability.sensitivity import DPrimeSlopes
from analysis.results_file import StoredValues
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
_NODES, _WEIGHTS = np.polynomial.laguerre.laggauss(32)


class ErrorSources(StoredValues):
    """What is known of a camera's errors; None where it is not, and then no interval holds it.

    Parameters
    ----------
    psf_variance_err_px2
        Standard error of the calibration's mean variance of the PSF.
    focus_scatter_px2
        Standard deviation of that variance from capture to capture.
    focus_from
        What states it, in words.
    noise_relative_err
        Standard error of the noise over the noise.
    registration_err_px
        Standard deviation of a pair's registration error along either axis.
    """

    psf_variance_err_px2: float | None = Field(default=None, ge=0)
    focus_scatter_px2: float | None = Field(default=None, ge=0)
    focus_from: str | None = None
    noise_relative_err: float | None = Field(default=None, ge=0)
    registration_err_px: float | None = Field(default=None, ge=0)

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
    psf_per_px2, focus_per_px2, focus_loss_per_px4, registration_loss_per_px2, noise
        As in `DPrimeSlopes`; ``focus_per_px2`` is that of both photographs together, each with a
        focus of its own.
    """

    sources: ErrorSources = ErrorSources()
    scene: list[float]
    psf_per_px2: list[float]
    focus_per_px2: list[float]
    focus_loss_per_px4: list[float]
    registration_loss_per_px2: list[float]
    noise: list[float]

    @model_validator(mode="after")
    def _check(self) -> Self:
        lengths = {len(values) for name, values in self if name != "sources"}
        if len(lengths) > 1:
            raise ValueError("all lists of an uncertainty must have a value at each zoom")
        return self

    @classmethod
    def of(cls, sources: ErrorSources, scene: list[float], slopes: list[DPrimeSlopes]) -> Self:
        """Put together the slopes at each zoom."""
        return cls(
            sources=sources,
            scene=scene,
            psf_per_px2=[one.psf_per_px2 for one in slopes],
            focus_per_px2=[
                sqrt(one.followup_per_px2**2 + one.reference_per_px2**2) for one in slopes
            ],
            focus_loss_per_px4=[one.focus_loss_per_px4 for one in slopes],
            registration_loss_per_px2=[one.registration_loss_per_px2 for one in slopes],
            noise=[one.noise for one in slopes],
        )

    def errors(self, zooms: list[float], zoom: float) -> "DPrimeErrors":
        """Errors of ln d' at a zoom, linear between those of the curve."""

        def at(values: list[float]) -> float:
            return float(np.interp(zoom, zooms, values))

        known = self.sources
        variances: dict[Source, float] = {"scene": at(self.scene) ** 2}
        shift = 0.0
        if known.psf_variance_err_px2 is not None:
            variances["psf"] = (at(self.psf_per_px2) * known.psf_variance_err_px2) ** 2
        if known.focus_scatter_px2 is not None:
            scatter_px4 = known.focus_scatter_px2**2
            loss = _loss(at(self.focus_loss_per_px4) * scatter_px4)
            shift += loss.mean
            variances["focus"] = at(self.focus_per_px2) ** 2 * scatter_px4 + loss.variance
        if known.noise_relative_err is not None:
            variances["noise"] = (at(self.noise) * known.noise_relative_err) ** 2
        if known.registration_err_px is not None:
            loss = _loss(at(self.registration_loss_per_px2) * known.registration_err_px**2)
            shift += loss.mean
            variances["registration"] = loss.variance
        return DPrimeErrors(shift=shift, variances=variances)


class BudgetShare(StoredValues):
    """Share of a source in the variance of ln d', from 0 to 1."""

    source: Source
    share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DPrimeErrors:
    """Errors of ln d': its mean less that of the curve, and its variance by source."""

    shift: float
    variances: dict[Source, float]

    @classmethod
    def of_interval(cls, low: float, d_prime: float, high: float) -> Self:
        """Errors that a 95 % interval stands for, of which the scene is the only known source."""
        if not 0 < low <= d_prime <= high:
            low = high = 1.0 if d_prime <= 0 else d_prime
        return cls(shift=0.0, variances={"scene": (log(high / low) / (2 * NORMAL_95)) ** 2})

    @property
    def standard_error(self) -> float:
        """Of ln d', all sources together."""
        return sqrt(sum(self.variances.values()))

    @property
    def budget(self) -> tuple[BudgetShare, ...]:
        """Shares of the sources, the largest first."""
        whole = sum(self.variances.values())
        shares = [
            BudgetShare(source=name, share=one / whole if whole > 0 else 0.0)
            for name, one in self.variances.items()
        ]
        return tuple(sorted(shares, key=lambda one: -one.share))

    def interval(self, d_prime: float) -> tuple[float, float]:
        """The 95 % interval of a d'."""
        reach = NORMAL_95 * self.standard_error
        return d_prime * exp(self.shift - reach), d_prime * exp(self.shift + reach)

    def probability_of(self, min_d_prime: float, d_prime: float) -> float:
        """Probability that the d' of a curve's value reaches a threshold."""
        if d_prime <= 0:
            return 0.0
        margin, err = log(d_prime / min_d_prime) + self.shift, self.standard_error
        if err == 0:
            return float(margin >= 0)
        return float(ndtr(margin / err))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Loss:
    mean: float
    variance: float


def _loss(share: float) -> _Loss:
    """Mean and variance of ``-ln(1 + share u) / 2``, u exponentially distributed with mean 1.

    Half the sum of the squares of two standard normal numbers is: the errors along both axes, or of
    both photographs' focus.
    """
    if not share < inf:
        return _Loss(mean=-inf, variance=inf)
    values: FloatArray = -0.5 * np.log1p(share * _NODES)
    mean = float(_WEIGHTS @ values)
    return _Loss(mean=mean, variance=max(float(_WEIGHTS @ values**2) - mean**2, 0.0))
