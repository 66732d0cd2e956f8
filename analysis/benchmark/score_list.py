"""Collects the scores of a program in a track, group by group."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from analysis.benchmark.estimates import Estimate
from analysis.benchmark.measures import EVERYTHING
from analysis.benchmark.scores import Score
from analysis.benchmark.stored_models import Track
from simulation.arrays import IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreList:
    """The scores of a program in a track, as they are found."""

    program: str
    track: Track
    scores: list[Score] = field(default_factory=list)

    def add(
        self, group: str, measure: str, found: Estimate | None, answered: int, tasks: int
    ) -> None:
        """Add a score, unless there is no estimate."""
        if found is not None:
            self.scores.append(
                Score.of(
                    found,
                    program=self.program,
                    track=self.track,
                    group=group,
                    measure=measure,
                    answered=answered,
                    tasks=tasks,
                )
            )


def groups_of(
    labels: Sequence[Sequence[str]], main: str = EVERYTHING
) -> list[tuple[str, IntArray]]:
    """Return the groups of tasks and which tasks are in each: all of them, and those of each label.

    Parameters
    ----------
    labels
        Of each task, such as ``("kind tilted", "lens gaussian")``, one of each sort.
    main
        What the group of all is called.
    """
    found = [(main, np.arange(len(labels), dtype=np.int64))]
    for sort in zip(*labels, strict=True):
        found += [
            (label, np.flatnonzero(np.array(sort) == label).astype(np.int64))
            for label in sorted(set(sort))
        ]
    return found


Announce = Callable[[int], None]
"""Is told how many tasks are done."""
