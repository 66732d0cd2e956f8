"""Answer the tasks of the public benchmark by one program, or by all.

python -m benchmarks.peers NAME --data DIR --out RESULTS [--track psf ...]
python -m benchmarks.peers --all --data DIR --out FOLDER

``--all`` writes ``FOLDER/NAME`` for each program in turn; what is not installed is left out. A run
that was broken off goes on where it ended. These need packages that the project itself does not:

    pip install quickMTF
    pip install --no-deps pybsm
    pip install "setuptools<81" wheel sfft==1.7.3
"""

import argparse
import sys
from pathlib import Path

from benchmarks.peers import (
    alignments,
    blind,
    changes,
    depth_changes,
    edges,
    kernelgan,
    listers,
    mtf_mapper,
    ours,
    zoom_outs,
)
from benchmarks.peers.program import TRACKS, Program
from benchmarks.peers.run import Run


def programs(mtf_mapper_output: Path | None = None) -> dict[str, Program]:
    """All programs by name, ours first and the slow ones last."""
    found: list[Program] = [
        *ours.PROGRAMS,
        *edges.PROGRAMS,
        *blind.PROGRAMS,
        *zoom_outs.PROGRAMS,
        *alignments.PROGRAMS,
        *changes.PROGRAMS,
        *depth_changes.PROGRAMS,
        *listers.PROGRAMS,
        *kernelgan.PROGRAMS,
    ]
    if mtf_mapper_output is not None:
        found.insert(1, mtf_mapper.program(mtf_mapper_output))
    return {program.name: program for program in found}


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(
        prog="python -m benchmarks.peers",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("name", nargs="?", metavar="NAME", help="program that answers")
    made.add_argument("--all", action="store_true", help="all programs, a folder each")
    made.add_argument("--list", action="store_true", help="name all programs")
    made.add_argument("--data", type=Path, metavar="DIR", help="the benchmark's folder")
    made.add_argument("--out", type=Path, metavar="RESULTS", help="folder of the answers")
    made.add_argument("--track", nargs="+", choices=TRACKS, default=TRACKS, help="these alone")
    made.add_argument(
        "--limit", type=int, metavar="N", help="tasks of a track that are answered at most"
    )
    made.add_argument(
        "--mtf-mapper-output",
        type=Path,
        metavar="FOLDER",
        help="results of MTF Mapper, a folder CHART each, for the program mtf-mapper",
    )
    return made


def main() -> int:
    asked = parser()
    given = asked.parse_args()
    known = programs(given.mtf_mapper_output)
    if given.list:
        for program in known.values():
            print(f"{program.name}: {', '.join(program.answers)}; {program.given}")
        return 0
    if given.data is None or given.out is None:
        asked.error("--data and --out are needed")
    if given.all == (given.name is not None):
        asked.error("name one program, or ask for --all")
    if not given.all and given.name not in known:
        asked.error(f"unknown program {given.name}; known are {', '.join(known)}")
    run = Run(data=given.data, tracks=tuple(given.track), limit=given.limit)
    for program in known.values() if given.all else [known[given.name]]:
        if not set(program.answers) & set(given.track):
            continue
        if missing := program.missing():
            print(f"{program.name} is left out: {missing} is not installed", flush=True)
            if not given.all:
                return 1
            continue
        run.run(program, given.out / program.name if given.all else given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
