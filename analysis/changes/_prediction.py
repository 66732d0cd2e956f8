"""The limit that is expected of a comparison before there is a pair, and the one that a pair shows.

A comparison's filters make of white noise and of a spot what is known in closed form; what it
leaves of two photographs without noise is aliasing, and a kernel's limits.
"""

from dataclasses import dataclass
from math import exp, inf, log, pi, sqrt
from typing import TYPE_CHECKING, Literal

import numpy as np

from analysis.changes._levels import usual_widths
from analysis.changes._photograph_pair import ChangeOptions, PhotographPair
from analysis.changes._significance import POWER, FilterWidth, equally_strict, response
from analysis.changes.matching import (
    FitRules,
    Smoothing,
    VarianceTerms,
    fit_pair,
    sampled,
    smoothed,
    smoothing_for,
)
from analysis.choices import FALSE_ALARMS
from analysis.detection_limits import AGREEING_RATIO, PredictedLimit
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray

if TYPE_CHECKING:
    from analysis.changes._comparison import Comparison
    from analysis.changes._levels import LimitMaps


_FRAME_PX = 100_000
"""Of the frame whose rate of false alarms and whose wide filters are meant: of 200,000 pixels a
spot of 6 px has a limit that is lower by 2 %, a narrower one by less."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedFilters:
    """The filters of a comparison on the follow-up's pixels.

    ``zoom``: reference pixels to one of the follow-up, along a line. ``smoothing``: of the
    reference, the source, and of the follow-up, the target.
    """

    zoom: float
    smoothing: Smoothing

    @property
    def widths(self) -> tuple[FilterWidth, ...]:
        """The widths, with the allowances that a frame of usual size gives them."""
        plain = usual_widths(self.smoothing.target_px, _FRAME_PX)
        return equally_strict(plain, FALSE_ALARMS / _FRAME_PX)

    def noise_gain(self, width: FilterWidth) -> float:
        """Variance behind a filter for white noise of variance 1 in both photographs.

        A Gaussian of width w leaves 1 / (4 pi w^2) of it. The reference is behind another one, and
        has z^2 of its pixels to one of the follow-up.
        """
        source_px2 = self.smoothing.source_px**2 + width.width_px**2 - self.smoothing.target_px**2
        return (1 / width.width_px**2 + 1 / (self.zoom**2 * source_px2)) / (4 * pi)

    def response(self, width: FilterWidth, spot_sigma_px: float) -> float:
        """Peak behind a filter of a spot of peak 1 and this width, as the follow-up shows it."""
        return float(response(np.array(spot_sigma_px), width))

    def limit_per_height(self, spot_sigma_px: float, noise_dn: float) -> float:
        """Amplitude by which a spot stands out by one standard deviation of white noise.

        ``noise_dn``: standard deviation of the noise of either photograph.
        """
        return min(
            noise_dn
            * sqrt(self.noise_gain(width))
            * width.allowance
            / self.response(width, spot_sigma_px)
            for width in self.widths
        )

    def averaging(self, width: FilterWidth, lags: int) -> FloatArray:
        """Weights of the autocovariance of the narrowest difference that a wider one adds up.

        Shape ``(2 lags + 1, 2 lags + 1)``, lag 0 in the middle; over all lags their sum is 1.
        """
        more_px2 = width.width_px**2 - self.smoothing.target_px**2
        lag = np.arange(-lags, lags + 1)
        line = np.exp(-(lag**2) / (4 * more_px2)) / sqrt(4 * pi * more_px2)
        return np.asarray(np.outer(line, line))


_SLACK = 1.03
"""Registration and tilt move a zoom by so much from the one that was meant."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitCurve:
    """Expected limits of the change of a curve of d', by zoom.

    ``zoom``: rising, from 1. ``spot_sigma_px``: width with which the follow-up shows the change, in
    its pixels. ``dn_per_height``: amplitude, as the follow-up shows it, by which the change stands
    out by one standard deviation; infinite where it is not found. ``noise_dn``: standard deviation
    of the noise that was assumed in either photograph.
    """

    zoom: tuple[float, ...]
    spot_sigma_px: tuple[float, ...]
    dn_per_height: tuple[float, ...]
    noise_dn: float

    def holds_at(self, zoom: float) -> bool:
        """Whether the curve says anything of a zoom."""
        return self.zoom[0] / _SLACK <= zoom <= self.zoom[-1] * _SLACK

    def spot_at(self, zoom: float) -> float:
        """Width with which a follow-up shows the change."""
        return float(np.interp(zoom, self.zoom, self.spot_sigma_px))

    def limit_at(self, zoom: float) -> float:
        """Amplitude by which it stands out by one standard deviation: 1/d' is linear in zoom."""
        return float(np.interp(zoom, self.zoom, self.dn_per_height))


Source = Literal["focus", "light", "registration", "texture"]

_SUBSTANTIAL = 0.3
"""Share of the logarithm of the ratio that a source explains if it is named."""

_LEAST_SHARE = 0.02
"""Share of the variance beside noise below which nothing is known of its kind."""

_LEAST_SPOT_PX = 0.3


def meet(
    curve: LimitCurve, zoom: float, compared: "Comparison", limits: "LimitMaps"
) -> PredictedLimit | None:
    """Hold the limit that a pair shows against the predicted one; None where nothing was predicted.

    Both are of one change of the scene, in levels of a follow-up with the sharpness and the light
    that were assumed.
    """
    if not curve.holds_at(zoom) or not curve.limit_at(zoom) < inf:
        return None
    met = _Met.of(curve, zoom, compared)
    limit = limits.limit_dn(met.shown_sigma_px)
    median = float(np.median(limit[np.isfinite(limit)]))
    predicted = limits.height_for(POWER) * curve.limit_at(zoom)
    shown = median * met.dilution / met.gain
    factors = met.factors(shown / predicted)
    return PredictedLimit(
        spot_sigma_px=met.sigma_px,
        noise_dn=curve.noise_dn,
        median_dn=predicted,
        shown_dn=shown,
        ratio=shown / predicted,
        factors={source: exp(value) for source, value in factors.items()},
        lost_to=met.losses(factors, log(shown / predicted)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Met:
    """What a comparison measured beside what the prediction assumed.

    ``sigma_px, shown_sigma_px``: width with which the follow-up should show the change, and with
    which it does. ``noise_dn``: of either photograph, as assumed. ``expected, found``: filters as
    they should be, and as they are.
    """

    compared: "Comparison"
    sigma_px: float
    shown_sigma_px: float
    noise_dn: float
    expected: ExpectedFilters
    found: ExpectedFilters

    @classmethod
    def of(cls, curve: LimitCurve, zoom: float, compared: "Comparison") -> "_Met":
        """Take from a comparison what it says of focus."""
        # A change of focus counts where the comparison says that it is one.
        extra_px2 = compared.extra_blur_px2 if compared.kernel == "both" else 0.0
        sigma = curve.spot_at(zoom)
        own, other = compared.smoothing.target_px, compared.smoothing.source_px
        if not compared.is_on_followup:
            own, other = other, own
        blur_px2 = other**2 - own**2
        return cls(
            compared=compared,
            sigma_px=sigma,
            shown_sigma_px=sqrt(max(sigma**2 + extra_px2, _LEAST_SPOT_PX**2)),
            noise_dn=curve.noise_dn,
            expected=ExpectedFilters(zoom=zoom, smoothing=smoothing_for(blur_px2 - extra_px2)),
            found=ExpectedFilters(zoom=zoom, smoothing=Smoothing(source_px=other, target_px=own)),
        )

    @property
    def dilution(self) -> float:
        """Peak of the change as it should be shown, to one as it is."""
        return (self.shown_sigma_px / self.sigma_px) ** 2

    @property
    def gain(self) -> float:
        """Light of the follow-up over that of the reference."""
        return abs(self.compared.gain)

    @property
    def noise_ratio(self) -> float:
        """Noise of the difference, to the assumed one in the light of the reference.

        That of single pixels counts. Where it is less than assumed, compression may have taken it
        away, and what is left is no less than what it made of it.
        """
        gains, light = self.compared.scatter.gains, self.gain
        if not self.compared.is_on_followup:
            light = 1 / light
        expected = self.noise_dn**2 * (gains.target + gains.source / light**2)
        scatter = self.compared.scatter
        white, whole = (sqrt(dn2 / expected) for dn2 in (scatter.white_dn2, scatter.noise_dn2))
        ratio = white if white > 1 else min(whole, 1.0)
        # In the follow-up's levels.
        return ratio if self.compared.is_on_followup else ratio / light

    def factors(self, ratio: float) -> dict[Source, float]:
        """By what each source raised the limit, as logarithms.

        Focus and noise are worked out; what they do not explain is shared as the variance beside
        noise is.
        """
        focus = log(
            self.found.limit_per_height(self.shown_sigma_px, 1.0)
            * self.dilution
            / self.expected.limit_per_height(self.sigma_px, 1.0)
        )
        light = log(max(self.noise_ratio, 1e-6) / self.gain)
        rest, scatter = log(ratio) - focus - light, self.compared.scatter
        beside = scatter.displaced_share + scatter.unlike_share
        if beside < _LEAST_SHARE:
            return {"focus": focus, "light": light, "registration": 0.0, "texture": 0.0}
        return {
            "focus": focus,
            "light": light,
            "registration": rest * scatter.displaced_share / beside,
            "texture": rest * scatter.unlike_share / beside,
        }

    def losses(self, factors: dict[Source, float], log_ratio: float) -> tuple[str, ...]:
        """Name what explains a substantial part of a loss, the most first."""
        if log_ratio < log(AGREEING_RATIO):
            return ()
        order = sorted(factors, key=lambda source: -factors[source])
        return tuple(
            self._sentence(source) for source in order if factors[source] > _SUBSTANTIAL * log_ratio
        )

    def _sentence(self, source: Source) -> str:
        compared = self.compared
        match source:
            case "focus":
                said = "softer" if compared.extra_blur_px2 > 0 else "sharper"
                return (
                    f"the follow-up is {said} by {abs(compared.extra_blur_px2):.2f} px^2 of blur "
                    "than the calibrated PSF predicts (focus)"
                )
            case "light":
                if abs(log(self.gain)) > abs(log(self.noise_ratio)):
                    return f"the follow-up has {self.gain:.2f} times the light (light)"
                return f"the noise is {self.noise_ratio:.2f} times the one assumed (light)"
            case "registration":
                return (
                    "wrong positions cause "
                    f"{100 * compared.scatter.displaced_share:.0f} % of the variance (registration)"
                )
            case "texture":
                return (
                    "fine detail, aliased or compressed, causes "
                    f"{100 * compared.scatter.unlike_share:.0f} % of the variance (texture)"
                )


_LEAST_PIXELS = 1000

_SAMPLE_PX = 6000
"""Pixels that the kernel is fitted to. Without noise, 25,000 leave as much to 2 % (text and texture
through a lens of f/8), in four times the time."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Unexplained:
    """The difference that remains without any noise.

    ``difference_dn``: behind the narrowest filter, on the part of the follow-up that was compared;
    0 where it was not. ``typical_dn2``: variance that the comparison gives it at the median place.
    Most of what is unexplained lies along a scene's edges, and the mean is that of few places.
    """

    difference_dn: FloatArray
    typical_dn2: float

    @property
    def at_the_median_place(self) -> FloatArray:
        """The difference, scaled to the variance at the median place."""
        mean_dn2 = float(np.mean(self.difference_dn**2))
        if mean_dn2 == 0:
            return self.difference_dn
        return np.asarray(self.difference_dn * np.sqrt(min(self.typical_dn2 / mean_dn2, 1.0)))


def unexplained(
    reference_dn: FloatArray, followup_dn: FloatArray, matrix: FloatArray, smoothing: Smoothing
) -> _Unexplained:
    """Match two photographs of one scene as a comparison does, and return what is left.

    ``reference_dn, followup_dn``: without noise, shape ``(rows, cols)``; the follow-up is the
    coarser one. ``matrix``: follow-up pixel ``(x, y, 1)`` to reference pixel, shape ``(3, 3)``.
    """
    pose = DistortedPose(
        matrix=matrix,
        k1=0.0,
        reference_shape=(reference_dn.shape[0], reference_dn.shape[1]),
        followup_shape=(followup_dn.shape[0], followup_dn.shape[1]),
    )
    pair = PhotographPair.of(reference_dn, followup_dn, pose, ChangeOptions())
    valid = pair.valid(smoothing)
    if np.count_nonzero(valid) < _LEAST_PIXELS:
        rows, cols = followup_dn.shape
        raise ValueError(
            f"a follow-up of {cols} x {rows} px is too small to be compared; observer changes "
            "needs larger photographs, or smaller zooms"
        )
    seen, target = pair.seen(smoothing.source_px), smoothed(pair.target, smoothing.target_px)
    terms = VarianceTerms.of(seen, pair.source, pair.target, pair.positions)
    told = np.zeros_like(valid)
    told[sampled(valid, _SAMPLE_PX)] = True
    fit = fit_pair(seen, target, terms, told, None, FitRules(smoothing_px=smoothing.target_px))
    difference = np.where(valid, fit.model.difference(seen, target), 0.0)
    rows, cols = (np.flatnonzero(valid.any(axis=axis)) for axis in (1, 0))
    return _Unexplained(
        difference_dn=difference[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1],
        typical_dn2=float(np.median(terms.variance(fit.sizes)[valid])),
    )
