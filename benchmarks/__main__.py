"""Run all benchmarks, or some: text, JSON lines, a page and a plot.

python -m benchmarks [NAME...] [--quick] [--jobs N] [--out DIR] [--page docs/benchmarks.md]

Each benchmark is a process of its own, so that none meets the caches and threads of another. What
it prints goes to ``DIR/NAME.txt`` and then to the terminal, its figures to ``DIR/NAME.jsonl``,
those of all to ``DIR/benchmarks.jsonl``. With ``--resume``, a run that was interrupted goes on
where it ended.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from benchmarks.page import benchmark_page

FOLDER = Path(__file__).parent
PLOT_NAME = "cost-growth.png"


def names() -> list[str]:
    """All benchmarks in alphabetical order."""
    return sorted(path.stem.removeprefix("bench_") for path in FOLDER.glob("bench_*.py"))


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
        command = [sys.executable, "-m", f"benchmarks.bench_{name}", "--json", str(lines)]
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
    if unknown := set(given.names) - set(names()):
        parser.error(f"no such benchmark: {', '.join(sorted(unknown))}; {', '.join(names())}")
    given.out.mkdir(parents=True, exist_ok=True)
    pictures = given.page.parent / "images" if given.page else given.out
    pictures.mkdir(parents=True, exist_ok=True)
    plot = pictures / PLOT_NAME
    chosen = given.names or names()
    run = Run(out=given.out, plot=plot, is_quick=given.quick, resumes=given.resume)
    with ThreadPoolExecutor(given.jobs) as pool:
        failed = [
            name for name, ok in zip(chosen, pool.map(run.run, chosen), strict=True) if not ok
        ]
    lines = run.joined(chosen)
    page = given.page or given.out / "benchmarks.md"
    at_once = f"{given.jobs} ran at a time, one a core." if given.jobs > 1 else ""
    page.write_text(
        benchmark_page(
            lines,
            plot=os.path.relpath(plot, page.parent),
            is_quick=given.quick,
            failed=failed,
            note=" ".join(one for one in (at_once, given.note) if one),
        ),
        encoding="utf-8",
    )
    print(f"\nwrote {lines}, {page} and {plot}")
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
