"""How all benchmarks time: after one run that warms up, pieces of work in turn, one clock."""

import time
from collections.abc import Callable, Sequence
from math import inf
from statistics import median

Work = Callable[[], object]


def best_s(
    work: Work, seconds: float = 1.0, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Shortest of as many runs as fit into ``seconds``, and of at least one."""
    return shortest_s([work], seconds, clock)[0]


def shortest_s(
    works: Sequence[Work], seconds: float, clock: Callable[[], float] = time.perf_counter
) -> list[float]:
    """Shortest run of each, called in turn so that all of them meet the same machine."""
    for work in works:
        work()
    shortest, end_s = [inf] * len(works), time.perf_counter() + seconds
    while True:
        for index, work in enumerate(works):
            start_s = clock()
            work()
            shortest[index] = min(shortest[index], clock() - start_s)
        if time.perf_counter() >= end_s:
            return shortest


def medians_s(
    works: Sequence[Work],
    rounds: int,
    clock: Callable[[], float] = time.perf_counter,
    *,
    is_warm: bool = False,
) -> list[float]:
    """Median run of each, called in turn; ``is_warm`` leaves the run that warms up away."""
    times_s: list[list[float]] = [[] for _ in works]
    if not is_warm:
        for work in works:
            work()
    for _ in range(rounds):
        for work, times in zip(works, times_s, strict=True):
            start_s = clock()
            work()
            times.append(clock() - start_s)
    return [median(times) for times in times_s]


def median_s(work: Work, rounds: int) -> float:
    """Median of ``rounds`` runs, after one that warms up."""
    return medians_s([work], rounds)[0]
