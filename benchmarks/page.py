"""The page of all figures, made from the JSON lines of a run."""

import json
from collections.abc import Iterable
from pathlib import Path

from benchmarks.environment import environment_line
from benchmarks.harness import Figure

HEADING = """# Benchmarks

Made by `python -m benchmarks --page docs/benchmarks.md`; do not edit.{mode}

Every row was measured in one run with its peer; **times** is the peer's figure over ours: how many
times faster or more exact we are. Rows without a peer stand for themselves. What a benchmark does
and leaves out is said at the top of `benchmarks/bench_NAME.py`; `python -m benchmarks.bench_NAME`
prints all of it.

{environment}

{contents}

## How cost grows

![Time over image size, zoom, edges, heights and images]({plot})

Both axes are logarithmic; the dotted line through the last point doubles with the size.
"""


def read_runs(path: Path) -> tuple[list[dict[str, object]], list[Figure]]:
    """Read the heads of all benchmarks and their figures from a file of JSON lines."""
    heads, figures = [], []
    for line in path.read_text(encoding="utf-8").splitlines():
        document = json.loads(line)
        if "environment" in document:
            heads.append(document)
        elif "value" in document:
            figures.append(Figure(**document))
    return heads, figures


def benchmark_page(
    path: Path, *, plot: str, is_quick: bool, failed: Iterable[str] = (), note: str = ""
) -> str:
    """Write the page in Markdown."""
    heads, figures = read_runs(path)
    facts: dict[str, str] = {}
    for head in heads:
        found = head["environment"]
        if isinstance(found, dict):
            facts |= found
    mode = (
        " This run was `--quick`: each thing was timed briefly, and other programs ran beside it."
        if is_quick
        else ""
    )
    mode += f" {note}" if note else ""
    links = ", ".join(f"[{head['benchmark']}](#{head['benchmark']})" for head in heads)
    parts = [
        HEADING.format(
            mode=mode, environment=environment_line(facts) + ".", contents=links, plot=plot
        )
    ]
    parts += [f"`{name}` could not run here.\n" for name in failed]
    for head in heads:
        name = head["benchmark"]
        rows = [figure for figure in figures if figure.benchmark == name]
        parts.append(f"## {name}\n")
        if head["note"]:
            parts.append(f"{head['note']}.\n")
        parts.append("| figure | ours | peer | peer's | times |")
        parts.append("| --- | ---: | --- | ---: | ---: |")
        parts += [_row(figure) for figure in rows]
        parts.append("")
    return "\n".join(parts).rstrip() + "\n"


def _row(figure: Figure) -> str:
    theirs = "" if figure.peer_value is None else _number(figure.peer_value)
    times = "" if figure.ratio is None else f"**{_number(figure.ratio)}**"
    ours = f"{_number(figure.value)} {figure.unit}".rstrip()
    return f"| {figure.name} | {ours} | {figure.peer or ''} | {theirs} | {times} |"


def _number(value: float) -> str:
    """Write three digits, without an exponent where a person would not write one."""
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        digits = f"{value:.3g}"
        return f"{float(digits):.0f}" if "e" in digits else digits
    return f"{value:.1e}"
