"""Errors of models by case, beside the best that is possible: ratios and a table."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import gmean

from simulation.arrays import FloatArray

FLOOR_DN2 = 0.01
"""Added to the ideal: a millionth of the scene's variance matters to no one."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelErrors:
    """Mean squared errors in DN^2 by case and column; the column ``ideal`` is among them."""

    cases: list[str] = field(default_factory=list)
    errors: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    counted: list[bool] = field(default_factory=list)

    def add(self, case: str, errors: dict[str, float], *, is_counted: bool) -> None:
        """Append one case; ``is_counted`` if means and worst cases are over it, too."""
        self.cases.append(case)
        self.counted.append(is_counted)
        for column, value in errors.items():
            self.errors[column].append(value)

    def at(self, index: int) -> dict[str, float]:
        """Errors of one case by column."""
        return {column: values[index] for column, values in self.errors.items()}

    def ratios(self, column: str) -> FloatArray:
        """Error over the ideal's and the floor, of the cases that are counted."""
        own, ideal = np.array(self.errors[column]), np.array(self.errors["ideal"])
        return np.asarray((own / (ideal + FLOOR_DN2))[np.array(self.counted)])

    def mean_ratio(self, column: str) -> float:
        """Geometric mean of the ratios."""
        return float(gmean(self.ratios(column)))

    def worst_ratio(self, column: str) -> float:
        """Largest of the ratios."""
        return float(self.ratios(column).max())

    def table(self, columns: Sequence[str]) -> str:
        """Markdown table of all cases, then the mean and the worst ratio."""
        columns = [name for name in columns if name in self.errors]
        lines = [f"| case | {' | '.join(columns)} |", "|---|" + "---:|" * len(columns)]
        for index, case in enumerate(self.cases):
            values = " | ".join(brief(self.errors[column][index]) for column in columns)
            lines.append(f"| {case} | {values} |")
        if any(self.counted):
            for name, summary in (
                ("geometric mean of ratio", self.mean_ratio),
                ("worst ratio", self.worst_ratio),
            ):
                values = " | ".join(brief(summary(column)) for column in columns)
                lines.append(f"| **{name}** | {values} |")
        return "\n".join(lines)


def brief(value: float) -> str:
    """Three digits, without an exponent where it can be helped."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}" if value >= 1e-4 else f"{value:.0e}"
