"""The limit that was predicted beside the one that a pair shows, and what made the difference."""

from dataclasses import dataclass
from math import exp, inf, log, sqrt
from typing import TYPE_CHECKING, Literal

import numpy as np

from analysis.changes.detection import POWER
from analysis.changes.matching import Smoothing, smoothing_for
from analysis.changes.prediction.filters import ExpectedFilters
from analysis.changes.prediction.limit_curve import LimitCurve
from analysis.detection_limits import AGREEING_RATIO, PredictedLimit

if TYPE_CHECKING:
    from analysis.changes.comparison import Comparison
    from analysis.changes.detection import LimitMaps

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

    Parameters
    ----------
    curve
        What was predicted.
    zoom
        Of the pair, follow-up over reference.
    compared, limits
        The comparison and what it would have found.
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

    Parameters
    ----------
    compared
        The comparison.
    sigma_px, shown_sigma_px
        Width with which the follow-up should show the change, and with which it does.
    noise_dn
        Of either photograph, as assumed.
    expected, found
        Filters as they should be, and as they are.
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
                    "wrong positions make "
                    f"{100 * compared.scatter.displaced_share:.0f} % of the variance (registration)"
                )
            case "texture":
                return (
                    "fine detail, aliased or compressed, makes "
                    f"{100 * compared.scatter.unlike_share:.0f} % of the variance (texture)"
                )
