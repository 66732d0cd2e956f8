"""Rows of a benchmark of many pictures: worked out by processes, written at once, counted."""

import csv
import json
import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from math import isfinite, nan
from pathlib import Path
from typing import Any, TypeVar

from scipy.stats import binomtest

Job = TypeVar("Job")
Result = TypeVar("Result")


def outcomes(
    work: Callable[[Job], Result], jobs: Sequence[Job], workers: int
) -> Iterator[tuple[Job, Result | BaseException]]:
    """Each job with its result, or with the error that it ended in, in order."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        waiting = [pool.submit(work, job) for job in jobs]
        for job, future in zip(jobs, waiting, strict=True):
            error = future.exception()
            yield job, future.result() if error is None else error


def written(rows: Iterable[Result], kind: type[Any], path: Path | None) -> Iterator[Result]:
    """Pass rows of a dataclass on, each written at once: ``.csv``, otherwise JSON lines."""
    if path is None:
        yield from rows
        return
    with path.open("w", encoding="utf-8", newline="") as file:
        names = [field.name for field in fields(kind)]
        table = csv.DictWriter(file, names, lineterminator="\n")
        if path.suffix == ".csv":
            table.writeheader()
        for row in rows:
            values: dict[str, Any] = asdict(row)  # type: ignore[call-overload]
            if path.suffix == ".csv":
                table.writerow(values)
            else:
                finite = {name: _or_none(value) for name, value in values.items()}
                file.write(json.dumps(finite, allow_nan=False) + "\n")
            file.flush()
            yield row


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """A share in %, with its 95 % interval by Wilson."""

    percent: float
    low: float
    high: float

    @classmethod
    def of(cls, hits: int, total: int) -> "Share":
        """Of so many; NaN of none."""
        if total == 0:
            return cls(percent=nan, low=nan, high=nan)
        interval = binomtest(hits, total).proportion_ci(method="wilson")
        return cls(percent=100 * hits / total, low=100 * interval.low, high=100 * interval.high)

    def __str__(self) -> str:
        return f"{self.percent:5.1f} [{self.low:4.1f}, {self.high:5.1f}]"


def _or_none(value: object) -> object:
    return None if isinstance(value, float) and not isfinite(value) else value
