"""Run all benchmarks, or some: text, JSON lines, a page and a plot.

python -m benchmarks [NAME...] [--quick] [--out DIR] [--page docs/benchmarks.md]

Each benchmark is a process of its own, so that none meets the caches and threads of another. What
it prints goes to the terminal and to ``DIR/NAME.txt``, its figures to ``DIR/benchmarks.jsonl``.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from benchmarks.page import benchmark_page

FOLDER = Path(__file__).parent
PLOT_NAME = "cost-growth.png"


def names() -> list[str]:
    """All benchmarks in alphabetical order."""
    return sorted(path.stem.removeprefix("bench_") for path in FOLDER.glob("bench_*.py"))


def run_one(name: str, out: Path, lines: Path, *, is_quick: bool, plot: Path) -> bool:
    """Run one benchmark; return whether it succeeded."""
    command = [sys.executable, "-m", f"benchmarks.bench_{name}", "--json", str(lines)]
    command += ["--quick"] if is_quick else []
    command += ["--plot", str(plot)] if name == "growth" else []
    print(f"\n== {name}", flush=True)
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with (
        subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, env=os.environ | one_thread
        ) as process,
        (out / f"{name}.txt").open("w", encoding="utf-8") as text,
    ):
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="", flush=True)
            text.write(line)
    return process.returncode == 0


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
    parser.add_argument("--out", type=Path, default=Path("bench-output"))
    parser.add_argument("--page", type=Path, metavar="FILE", help="write a Markdown page as well")
    parser.add_argument("--note", default="", help="a remark about the run, for the page")
    given = parser.parse_args()
    if unknown := set(given.names) - set(names()):
        parser.error(f"no such benchmark: {', '.join(sorted(unknown))}; {', '.join(names())}")
    given.out.mkdir(parents=True, exist_ok=True)
    lines = given.out / "benchmarks.jsonl"
    lines.unlink(missing_ok=True)
    pictures = given.page.parent / "images" if given.page else given.out
    pictures.mkdir(parents=True, exist_ok=True)
    plot = pictures / PLOT_NAME
    failed = [
        name
        for name in given.names or names()
        if not run_one(name, given.out, lines, is_quick=given.quick, plot=plot)
    ]
    page = given.page or given.out / "benchmarks.md"
    shown = os.path.relpath(plot, page.parent)
    page.write_text(
        benchmark_page(lines, plot=shown, is_quick=given.quick, failed=failed, note=given.note),
        encoding="utf-8",
    )
    print(f"\nwrote {lines}, {page} and {plot}")
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
