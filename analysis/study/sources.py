"""A predicted error by its sources, and what of a plan makes each of them smaller."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Literal

from analysis.study.document import BudgetShare, PredictedQuantity, Quantity

Source = Literal[
    "pixel noise of the edges",
    "focus from capture to capture",
    "photographs of the scene",
    "noise of the camera",
    "pixel noise of the board",
    "heights read back",
]

Lever = Literal["frames", "edges", "runs", "photographs"]

LEVERS: Mapping[Source, frozenset[Lever]] = {
    "pixel noise of the edges": frozenset({"frames", "edges", "runs"}),
    "focus from capture to capture": frozenset({"runs"}),
    "photographs of the scene": frozenset({"photographs"}),
    "noise of the camera": frozenset(),
    "pixel noise of the board": frozenset({"frames", "runs"}),
    "heights read back": frozenset({"runs"}),
}
"""What divides the variance by a source: twice as many of it, half the variance."""

NORMAL_95 = 1.959963984540054


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """A quantity, and the variances of its predicted error by source.

    ``value``: what is known of it; None if nothing is. ``variances``: in the quantity's unit,
    squared; empty if the plan does not determine it. ``half_width_factor``: half a 95 % interval in
    standard errors. ``undetermined``: why there is no error.
    """

    quantity: Quantity
    value: float | None
    variances: Mapping[Source, float]
    half_width_factor: float = NORMAL_95
    undetermined: str | None = None

    @property
    def err(self) -> float:
        """Standard error by all sources."""
        return sqrt(sum(self.variances.values()))

    @property
    def half_width_95(self) -> float:
        """Half a 95 % interval."""
        return self.half_width_factor * self.err

    def share(self, source: Source) -> float:
        """Share of a source in the variance."""
        total = sum(self.variances.values())
        return self.variances.get(source, 0.0) / total if total > 0 else 0.0

    @property
    def largest(self) -> Source | None:
        """Source of most of the variance; None where there is none."""
        return max(self.variances, key=lambda source: self.variances[source], default=None)

    def document(self) -> PredictedQuantity:
        """Return it as the document lists it."""
        if self.undetermined is not None or not self.variances:
            return PredictedQuantity(
                quantity=self.quantity,
                value=self.value,
                undetermined=self.undetermined or "the plan does not determine it",
            )
        value, err, half = self.value, self.err, self.half_width_95
        shares = {source: self.share(source) for source in self.variances}
        return PredictedQuantity(
            quantity=self.quantity,
            value=value,
            err=err,
            relative_err=None if not value else err / abs(value),
            half_width_95=half,
            interval_95=None if value is None else (value - half, value + half),
            budget=tuple(
                BudgetShare(source=source, share=share)
                for source, share in sorted(shares.items(), key=lambda pair: -pair[1])
            ),
        )
