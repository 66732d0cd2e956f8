"""What benchmarks share: options, text for people, figures as JSON lines, times, rows.

    @benchmark("numpy", "scipy", note="{width_px} px wide")
    def main(record: Recorder, *, width_px: Annotated[int, "of the frames"] = 780) -> None:
        record.say("a table for people")
        record.figure("fit of one edge", 0.9, "ms", peer="scipy", peer_value=11.0)

The function's keyword-only parameters are the options of ``python -m benchmarks.ROOM.NAME``.
Besides, ``--quick`` asks for the least work that still gives every figure; ``--json FILE`` appends
the environment and each figure to a file, one document a line, as soon as it is known.
"""

import argparse
import csv
import inspect
import json
import multiprocessing
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from math import inf, isfinite
from pathlib import Path
from statistics import median
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints
from unittest.mock import patch

CPU_INFO = Path("/proc/cpuinfo")

Job = TypeVar("Job")
Result = TypeVar("Result")
T = TypeVar("T")
Work = Callable[[], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One measured number, and what its peer needs or gets in the same run."""

    benchmark: str
    name: str
    value: float
    unit: str
    peer: str | None = None
    peer_value: float | None = None

    @property
    def ratio(self) -> float | None:
        """Peer over ours: how many times faster, or more exact, we are."""
        if self.peer_value is None or not self.value > 0:
            return None
        return self.peer_value / self.value


class Recorder:
    """Prints what a benchmark says and keeps its figures."""

    def __init__(self, benchmark: str, *, is_quick: bool, json_path: Path | None) -> None:
        self.benchmark = benchmark
        self.is_quick = is_quick
        self.figures: list[Figure] = []
        self._json_path = json_path

    def pick(self, full: T, quick: T) -> T:
        """Return how much of something to do."""
        return quick if self.is_quick else full

    def say(self, text: str = "") -> None:
        """Print a line or a table at once."""
        print(text, flush=True)

    def figure(
        self,
        name: str,
        value: float,
        unit: str,
        peer: str | None = None,
        peer_value: float | None = None,
    ) -> None:
        """Print and keep one number; with its peer's in the same unit, smaller being better."""
        figure = Figure(
            benchmark=self.benchmark,
            name=name,
            value=float(value),
            unit=unit,
            peer=peer,
            peer_value=None if peer_value is None else float(peer_value),
        )
        beside = "" if figure.peer_value is None else f"; {peer} {number_text(figure.peer_value)}"
        self.say(f"= {name}: {number_text(figure.value)} {unit}".rstrip() + beside)
        self.figures.append(figure)
        self.write(asdict(figure))

    def time(
        self, name: str, seconds: float, peer: str | None = None, peer_s: float | None = None
    ) -> None:
        """Keep a time in ms, beside that of a peer in the same run."""
        peer_ms = None if peer_s is None else 1e3 * peer_s
        self.figure(name, 1e3 * seconds, "ms", peer=peer, peer_value=peer_ms)

    def race(self, name: str, ours: Work, peer: str, theirs: Work, seconds: float) -> None:
        """Keep the shortest times of two pieces of work that take turns."""
        ours_s, peer_s = shortest_s([ours, theirs], seconds)
        self.time(name, ours_s, peer, peer_s)

    def write(self, document: dict[str, object]) -> None:
        """Append a line to the file of figures, where one is asked for."""
        if self._json_path is not None:
            with self._json_path.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps(document) + "\n")


def number_text(value: float) -> str:
    """Write three digits, without an exponent where a person would not write one."""
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        digits = f"{value:.3g}"
        return f"{float(digits):.0f}" if "e" in digits else digits
    return f"{value:.1e}"


def benchmark(
    *packages: str, note: str = ""
) -> Callable[[Callable[..., None]], Callable[[], None]]:
    """Make a function the benchmark of its module, which runs where the module is the program.

    ``packages`` are those whose versions are recorded; ``note`` may name options in braces.
    """

    def declared(function: Callable[..., None]) -> Callable[[], None]:
        def main() -> None:
            options = vars(_parser(function).parse_args())
            is_quick, json_path = options.pop("quick"), options.pop("json")
            name = Path(function.__code__.co_filename).stem
            record = Recorder(name, is_quick=is_quick, json_path=json_path)
            facts = environment(packages)
            remark = "; ".join(filter(None, (note.format(**options), "quick" * is_quick)))
            record.say(environment_line(facts) + (f"; {remark}" if remark else ""))
            head = {"benchmark": name, "environment": facts, "note": remark}
            record.write({**head, "commit": measured_commit()})
            function(record, **options)
            record.write({"benchmark": name, "figures": len(record.figures)})

        if function.__module__ == "__main__":
            main()
        return main

    return declared


def _parser(function: Callable[..., None]) -> argparse.ArgumentParser:
    """Options common to all benchmarks, and the keyword-only parameters of one."""
    parser = argparse.ArgumentParser(
        description=sys.modules[function.__module__].__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--quick", action="store_true", help="do the least work that gives every figure"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="append figures as JSON lines")
    hints = get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind is parameter.KEYWORD_ONLY:
            keys = _argument(hints[name], parameter.default)
            parser.add_argument(f"--{name.replace('_', '-')}", **keys)
    return parser


def _argument(hint: object, default: object) -> dict[str, Any]:
    """What argparse is to know of a parameter."""
    keys: dict[str, Any] = {"default": default}
    if get_origin(hint) is Annotated:
        hint, keys["help"] = get_args(hint)
    if hint is bool:
        return keys | {"action": "store_true"}
    if get_origin(hint) is UnionType:
        (hint,) = (one for one in get_args(hint) if one is not NoneType)
    if get_origin(hint) is list:
        keys["action"] = "append"
        (hint,) = get_args(hint)
    if get_origin(hint) is Literal:
        values = [one for one in get_args(hint) if one is not None]
        return keys | {"choices": values, "type": type(values[0])}
    return keys | {"type": hint}


def environment(packages: Iterable[str] = ()) -> dict[str, str]:
    """Processor, cores, system, Python and the versions of packages; no date, no machine name."""
    facts = {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
    }
    return facts | {name: version(name) for name in packages}


MEASURED = (
    "acquisition",
    "analysis",
    "benchmarks",
    "calibration",
    "hil_mocks",
    "simulation",
    "standoff",
)
"""What figures are of: a commit that changes documents or tests alone leaves them as they are."""


def measured_commit(checkout: Path = Path(__file__).parents[1]) -> str:
    """The last commit that changed what is measured, with a + if files differ from it; or nothing.

    Outside a checkout of git, nobody knows.
    """
    try:
        last, edited = (
            subprocess.run(
                ["git", *words, "--", *MEASURED],
                cwd=checkout,
                capture_output=True,
                text=True,
                check=True,
            ).stdout.strip()
            for words in (("log", "-1", "--format=%h"), ("status", "--porcelain"))
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return last + "+" * bool(edited)


def environment_line(facts: dict[str, str]) -> str:
    """Write the facts in one line of text."""
    named = {key: value for key, value in facts.items() if key not in ("processor", "cores")}
    system = named.pop("system")
    versions = ", ".join(f"{name} {number}" for name, number in named.items())
    return f"{facts['processor']}, {facts['cores']} cores, {system}; {versions}"


def _processor() -> str:
    if CPU_INFO.exists():
        for line in CPU_INFO.read_text().splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name" and value.strip():
                return value.strip()
    return platform.processor() or platform.machine()


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


def real_data(folder: str) -> Path | None:
    """A folder of real photographs, where ``STANDOFF_REAL_DATA`` names one that holds it."""
    named = os.environ.get("STANDOFF_REAL_DATA")
    return Path(named, folder) if named is not None and Path(named, folder).is_dir() else None


def apart(work: Callable[..., Result], *arguments: object, **variables: str) -> Result:
    """Result of a function in a fresh process with these environment variables."""
    context = multiprocessing.get_context("spawn")
    with patch.dict(os.environ, variables), ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(work, *arguments).result()


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


def _or_none(value: object) -> object:
    return None if isinstance(value, float) and not isfinite(value) else value
