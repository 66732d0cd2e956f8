"""Figures of scores: the programs side by side, over the groups of tasks."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from analysis.benchmark._data_set import Track
from analysis.benchmark.scores import BenchmarkScores, Measure, Score
from simulation.figures import InlineFigure
from simulation.palette import PALETTE

_MARKERS = "osD^vP"
_WIDTH_IN, _ROW_IN, _HEAD_IN = 6.4, 0.34, 0.9
_SPREAD = 0.6
_RATIO_OF_LOG = 30.0


def score_figure(
    scores: BenchmarkScores, track: Track, measure: Measure, groups: Sequence[str]
) -> Figure:
    """Plot a measure of every program: a line for each group, with 95 % intervals.

    A triangle to the right is a value that is only known to be larger.
    """
    height_in = _HEAD_IN + _ROW_IN * len(groups) + 0.16 * len(scores.programs)
    figure = InlineFigure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    axes = figure.subplots()
    count = len(scores.programs)
    largest: list[float] = []
    for number, program in enumerate(scores.programs):
        aside = _SPREAD * ((number + 0.5) / count - 0.5)
        shown = False
        for row, group in enumerate(groups):
            score = scores.score(program.name, track, group, measure.name)
            if score is None:
                continue
            is_bound = score.relation == ">"
            axes.errorbar(
                score.value, row + aside, xerr=_reach(score), capsize=2, linewidth=1.2,
                fmt=">" if is_bound else _MARKERS[number % len(_MARKERS)], markersize=5,
                color=PALETTE[number % len(PALETTE)],
                markerfacecolor="none" if is_bound else None,
                label=None if shown else program.name,
            )  # fmt: skip
            shown = True
            largest.append(score.value)
    axes.set_yticks(range(len(groups)), groups)
    axes.set_ylim(len(groups) - 0.5, -0.5)
    axes.set_xlabel(measure.label)
    positive = [value for value in largest if value > 0]
    if measure.better == "less" and positive and max(positive) > _RATIO_OF_LOG * min(positive):
        axes.set_xscale("symlog", linthresh=min(positive))
        axes.set_xlim(0, None)
    figure.legend(loc="outside upper center", ncols=min(count, 4), fontsize=8)
    return figure


def _reach(score: Score) -> list[list[float]]:
    """From the value to the ends of its interval, as errorbar takes them."""
    low = score.value if score.low is None else score.low
    high = score.value if score.high is None else score.high
    return [[max(score.value - low, 0.0)], [max(high - score.value, 0.0)]]
