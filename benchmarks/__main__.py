"""Run all benchmarks, or some: text, JSON lines, a page and a plot.

python -m benchmarks [NAME...] [--quick] [--jobs N] [--out DIR] [--page docs/benchmarks.md]

Each benchmark is a process of its own, so that none meets the caches and threads of another. What
it prints goes to ``DIR/NAME.txt`` and then to the terminal, its figures to ``DIR/NAME.jsonl``,
those of all to ``DIR/benchmarks.jsonl``. With ``--resume``, a run that was interrupted goes on
where it ended. Where only some are run, a page keeps its sections of the others; each says of which
commit it is.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from benchmarks.harness import Figure, environment_line, number_text

FOLDER = Path(__file__).parent
ROOMS = ("speed", "studies", "robustness")
PLOT_NAME = "cost-growth.png"


def modules() -> dict[str, str]:
    """Module of each benchmark, by name in alphabetical order."""
    files = [path for room in ROOMS for path in (FOLDER / room).glob("*.py")]
    return {
        path.stem: f"benchmarks.{path.parent.name}.{path.stem}"
        for path in sorted(files, key=lambda path: path.stem)
        if "\n@benchmark(" in path.read_text("utf-8")
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """Where a run of benchmarks leaves what it finds, and how much it does."""

    out: Path
    plot: Path
    is_quick: bool
    resumes: bool

    def figures_of(self, name: str) -> Path:
        """File of a benchmark's figures."""
        return self.out / f"{name}.jsonl"

    def run(self, name: str) -> bool:
        """Run one benchmark, unless an earlier run has finished it; return whether it succeeded."""
        lines = self.figures_of(name)
        if self.resumes and is_finished(lines):
            return True
        lines.unlink(missing_ok=True)
        command = [sys.executable, "-m", modules()[name], "--json", str(lines)]
        command += ["--quick"] if self.is_quick else []
        command += ["--plot", str(self.plot)] if name == "growth" else []
        one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        text = self.out / f"{name}.txt"
        began_s = time.monotonic()
        with text.open("w", encoding="utf-8") as file:
            done = subprocess.run(command, stdout=file, env=os.environ | one_thread, check=False)
        minutes = (time.monotonic() - began_s) / 60
        print(f"\n== {name}, {minutes:.1f} min\n{text.read_text('utf-8')}", flush=True)
        return done.returncode == 0

    def joined(self, chosen: Sequence[str]) -> Path:
        """Join the figures of benchmarks into one file, in their order."""
        lines = self.out / "benchmarks.jsonl"
        found = [path for name in chosen if (path := self.figures_of(name)).is_file()]
        lines.write_text("".join(path.read_text("utf-8") for path in found), "utf-8")
        return lines


def is_finished(lines: Path) -> bool:
    """Whether a benchmark has written all its figures to a file."""
    if not lines.is_file():
        return False
    *_, last = lines.read_text("utf-8").splitlines() or [""]
    return bool(last) and "figures" in json.loads(last)


HEADING = """# Benchmarks

Made by `python -m benchmarks --page docs/benchmarks.md`; do not edit.{mode}

Every row was measured in one run with its peer; **times** is the peer's figure over ours: how many
times faster or more exact we are. Rows without a peer stand for themselves. What a benchmark does
and leaves out is said at the top of its module, `benchmarks/ROOM/NAME.py`; `python -m
benchmarks.ROOM.NAME` prints all of it.

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


def benchmark_page(path: Path, *, plot: str, mode: str, kept: dict[str, str] | None = None) -> str:
    """Write the page in Markdown, with sections of an earlier one for what was not run."""
    heads, figures = read_runs(path)
    facts: dict[str, str] = {}
    sections = dict(kept or {})
    for head in heads:
        name, found = str(head["benchmark"]), head["environment"]
        if isinstance(found, dict):
            facts |= found
        sections[name] = _section(head, [one for one in figures if one.benchmark == name])
    names = sorted(sections)
    heading = HEADING.format(
        mode=mode,
        environment=environment_line(facts) + ".",
        contents=", ".join(f"[{name}](#{name})" for name in names),
        plot=plot,
    )
    return "\n".join([heading, *(sections[name] for name in names)]).rstrip() + "\n"


def _section(head: dict[str, object], figures: Iterable[Figure]) -> str:
    """A benchmark's part of the page: what was run, of which commit, and its figures."""
    remarks = [f"{head['note']}."] if head["note"] else []
    if head.get("commit"):
        remarks.append(f"Commit {head['commit']}.")
    lines = [f"## {head['benchmark']}\n"]
    if remarks:
        lines.append(" ".join(remarks) + "\n")
    lines.append("| figure | ours | peer | peer's | times |")
    lines.append("| --- | ---: | --- | ---: | ---: |")
    return "\n".join([*lines, *map(_row, figures), ""])


def sections_of(page: str) -> dict[str, str]:
    """The sections of a page that has been written before, by the name of their benchmark."""
    parts = re.split(r"^## ", page, flags=re.MULTILINE)[1:]
    named = ((part.partition("\n")[0], f"## {part.rstrip()}\n") for part in parts)
    return {name: section for name, section in named if name in modules()}


def _row(figure: Figure) -> str:
    theirs = "" if figure.peer_value is None else number_text(figure.peer_value)
    times = "" if figure.ratio is None else f"**{number_text(figure.ratio)}**"
    ours = f"{number_text(figure.value)} {figure.unit}".rstrip()
    return f"| {figure.name} | {ours} | {figure.peer or ''} | {theirs} | {times} |"


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="benchmarks to run, all by default"
    )
    parser.add_argument("--quick", action="store_true", help="a few minutes in all")
    parser.add_argument(
        "--jobs", type=int, default=1, metavar="N", help="N at a time; 1 by default"
    )
    parser.add_argument("--resume", action="store_true", help="leave out what DIR holds finished")
    parser.add_argument("--out", type=Path, default=Path("bench-output"), metavar="DIR")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write a Markdown page as well")
    parser.add_argument("--note", default="", help="a remark about the run, for the page")
    given = parser.parse_args()
    if unknown := set(given.names) - set(modules()):
        parser.error(
            f"no such benchmark: {', '.join(sorted(unknown))}; {', '.join(list(modules()))}"
        )
    given.out.mkdir(parents=True, exist_ok=True)
    pictures = given.page.parent / "images" if given.page else given.out
    pictures.mkdir(parents=True, exist_ok=True)
    plot = pictures / PLOT_NAME
    chosen = given.names or list(modules())
    run = Run(out=given.out, plot=plot, is_quick=given.quick, resumes=given.resume)
    with ThreadPoolExecutor(given.jobs) as pool:
        failed = [
            name for name, ok in zip(chosen, pool.map(run.run, chosen), strict=True) if not ok
        ]
    if len(failed) == len(chosen):
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
        return 1
    lines = run.joined(chosen)
    page = given.page or given.out / "benchmarks.md"
    remarks = (
        f"{given.jobs} ran at a time, one a core." if given.jobs > 1 else "",
        "This run was `--quick`: each thing was timed briefly, and other programs ran beside it."
        if given.quick
        else "",
        f"Could not run here: {', '.join(failed)}." if failed else "",
        given.note,
    )
    written = page.read_text("utf-8") if page.is_file() else ""
    page.write_text(
        benchmark_page(
            lines,
            plot=os.path.relpath(plot, page.parent),
            mode="".join(f" {remark}" for remark in remarks if remark),
            kept=sections_of(written) if given.names else None,
        ),
        encoding="utf-8",
    )
    print(f"\nwrote {lines}, {page} and {plot}")
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
