"""What benchmarks share: options, an environment line, text for people, figures as JSON lines.

    parser = bench_parser(__doc__)
    with Recorder.of(parser.parse_args(), "edge_fit", packages=("numpy", "scipy")) as record:
        record.say("a table for people")
        record.figure("fit of one edge", 0.9, "ms", peer="scipy", peer_value=11.0)

``--quick`` asks for the least work that still gives every figure; ``--json FILE`` appends the
environment and each figure to a file, one document a line, as soon as it is known.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

from benchmarks.environment import environment, environment_line

T = TypeVar("T")


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


def bench_parser(description: str | None) -> argparse.ArgumentParser:
    """Parser with the options that all benchmarks have."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="do the least work that gives every figure"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="append figures as JSON lines")
    return parser


class Recorder:
    """Prints what a benchmark says and keeps its figures."""

    def __init__(self, benchmark: str, *, is_quick: bool, json_path: Path | None) -> None:
        self.benchmark = benchmark
        self.is_quick = is_quick
        self.figures: list[Figure] = []
        self._json_path = json_path

    @classmethod
    def of(
        cls,
        options: argparse.Namespace,
        benchmark: str,
        *,
        packages: Sequence[str] = (),
        note: str = "",
    ) -> Self:
        """Start a benchmark: say where it runs and how."""
        record = cls(benchmark, is_quick=options.quick, json_path=options.json)
        facts = environment(packages)
        record.say(environment_line(facts) + (f"; {note}" if note else ""))
        record._append({"benchmark": benchmark, "environment": facts, "note": note})
        return record

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self._append({"benchmark": self.benchmark, "figures": len(self.figures)})

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
        *,
        peer: str | None = None,
        peer_value: float | None = None,
    ) -> None:
        """Keep one number; with its peer's in the same unit, smaller being better."""
        figure = Figure(
            benchmark=self.benchmark,
            name=name,
            value=float(value),
            unit=unit,
            peer=peer,
            peer_value=None if peer_value is None else float(peer_value),
        )
        self.figures.append(figure)
        self._append(asdict(figure))

    def _append(self, document: dict[str, object]) -> None:
        if self._json_path is not None:
            with self._json_path.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps(document) + "\n")
