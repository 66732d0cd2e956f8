"""Go, no go or unsure: what the errors of d' make of a threshold."""

from dataclasses import replace
from typing import Final, Literal

import numpy as np
from scipy.optimize import brentq

from analysis.detectability import (
    SOURCE_WORDS,
    BudgetShare,
    DetectabilityCurve,
    Source,
    focus_spread,
)
from analysis.results_file import StoredValues

Verdict = Literal["go", "no go", "unsure"]

CONFIDENCE: Final = 0.95
"""Probability from which a verdict is given: go where d' reaches the threshold with it, no go where
it falls short with it."""

_MOST_SCATTER_PX2 = 1.0
"""A focus that scatters more changes the PSF of most lenses beyond what slopes describe."""
_TRIED_PX2 = np.geomspace(0.002, _MOST_SCATTER_PX2, 14).tolist()

_REMEDIES: Final[dict[Source, str]] = {
    "scene": "more photographs of the scene",
    "psf": "more edges, frames and captures for the PSF",
    "focus": "a focus that repeats better, or the mean of several captures",
    "noise": "more frames for the noise",
    "registration": "more texture, or points, to register by",
}


class PoseDecision(StoredValues):
    """How sure a verdict on a pose is.

    Parameters
    ----------
    verdict
        ``go`` or ``no go`` where that is right with 95 %, else ``unsure``.
    probability
        That d' reaches the threshold.
    dprime_interval_95
        Of the decisive d'.
    budget
        Shares of the sources in the variance of ln d', the largest first.
    unknown_sources
        Sources of which nothing is known, and which neither interval nor verdict holds.
    focus_turning_px2
        Where the scatter of the focus is not known: the one from which on the verdict is another;
        None where none up to 1 px^2 turns it.
    """

    verdict: Verdict
    probability: float
    dprime_interval_95: tuple[float, float]
    budget: tuple[BudgetShare, ...]
    unknown_sources: tuple[Source, ...] = ()
    focus_turning_px2: float | None = None

    @property
    def sentence(self) -> str:
        """The verdict's probability, what decides it, and what would make it surer."""
        low, high = self.dprime_interval_95
        said = f"{self.probability_text}; d' {low:.2f} to {high:.2f} (95 %)"
        if not self.budget or self.budget[0].share == 0:
            return f"{said}; nothing is known of its errors"
        first = self.budget[0]
        said += f", {100 * first.share:.0f} % of it from {SOURCE_WORDS[first.source]}"
        if self.verdict == "unsure":
            said += f"; {_REMEDIES[first.source]} would shrink it"
        return said

    @property
    def probability_text(self) -> str:
        """The probability in words, never as certain as a rounded 100 %."""
        percent = 100 * self.probability
        if percent > 99.9:
            return "d' reaches the threshold with more than 99.9 %"
        if percent < 0.1:
            return "d' reaches the threshold with less than 0.1 %"
        return f"d' reaches the threshold with {percent:.3g} %"

    @property
    def unknown_sentence(self) -> str | None:
        """What the verdict does not hold; None where all sources are known."""
        if not self.unknown_sources:
            return None
        named = " and ".join(SOURCE_WORDS[name] for name in self.unknown_sources)
        said = f"not in it, as nothing is known of it: {named}"
        if "focus" not in self.unknown_sources:
            return said
        if self.focus_turning_px2 is None:
            return f"{said}; no scatter of the focus up to {_MOST_SCATTER_PX2:g} px^2 would turn it"
        return (
            f"{said}; with a focus that scatters by {self.focus_turning_px2:.2g} px^2 or more the "
            f"verdict is {'no go' if self.verdict == 'unsure' else 'unsure'}"
        )


def decide(
    curve: DetectabilityCurve, zoom: float, d_prime: float, min_d_prime: float
) -> PoseDecision:
    """Decide on a d' that was read off a curve.

    Parameters
    ----------
    curve
        Which knows its errors.
    zoom
        Where it was read.
    d_prime
        As read; 0 beyond the curve.
    min_d_prime
        Threshold.
    """
    errors = curve.errors_at(zoom)
    probability = errors.probability_of(min_d_prime, d_prime)
    verdict = verdict_of(probability)
    unknown = () if curve.uncertainty is None else curve.uncertainty.sources.unknown
    turning = None
    if "focus" in unknown:
        turning = _turning_scatter(curve, zoom, d_prime, min_d_prime, verdict)
    return PoseDecision(
        verdict=verdict,
        probability=probability,
        dprime_interval_95=errors.interval(d_prime),
        budget=errors.budget,
        unknown_sources=unknown,
        focus_turning_px2=turning,
    )


def verdict_of(probability: float) -> Verdict:
    """Return the verdict for the probability that d' reaches the threshold."""
    if probability >= CONFIDENCE:
        return "go"
    return "no go" if probability <= 1 - CONFIDENCE else "unsure"


def _turning_scatter(
    curve: DetectabilityCurve, zoom: float, d_prime: float, min_d_prime: float, verdict: Verdict
) -> float | None:
    """Least scatter of the focus that turns a verdict; None for none, or beyond the curve."""
    assert curve.uncertainty is not None
    if d_prime <= 0:
        return None
    errors = curve.errors_at(zoom)
    slopes = curve.uncertainty.slopes_at(curve.zoom, zoom)

    def probability(scatter_px2: float) -> float:
        focus = focus_spread(slopes, scatter_px2)
        spreads = {**errors.spreads, "focus": focus}
        return replace(errors, spreads=spreads).probability_of(min_d_prime, d_prime)

    before, turned = 0.0, verdict
    for scatter_px2 in _TRIED_PX2:
        turned = verdict_of(probability(scatter_px2))
        if turned != verdict:
            break
        before = scatter_px2
    else:
        return None
    bound = CONFIDENCE if "go" in (verdict, turned) else 1 - CONFIDENCE
    return float(brentq(lambda s: probability(s) - bound, before, scatter_px2, xtol=1e-4))
