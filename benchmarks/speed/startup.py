"""Processor time of a command line that computes nothing or little, beside ``import numpy``.

Run with ``python -m benchmarks.speed.startup``. Every figure is of whole processes, from start to
exit, the shortest of several; the peer is one that imports numpy and ends. The last command
measures the four edges of one square, which takes .1 s once everything is loaded.
"""

import resource
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from benchmarks.harness import Recorder, benchmark, shortest_s
from benchmarks.speed.edges import ONE_SQUARE, photograph

CHECKOUT = Path(__file__).parents[2]
LINES = (["--version"], ["--help"], ["verify", "--help"], ["simulate", "--help"])


def _children_s() -> float:
    """Processor time of all processes that ended, in seconds."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _started(words: list[str]) -> Callable[[], object]:
    """What runs a process of Python to its end."""
    return partial(
        subprocess.run,
        [sys.executable, *words],
        cwd=CHECKOUT,
        stdout=subprocess.DEVNULL,
        check=True,
    )


@benchmark("numpy", "typer")
def main(record: Recorder) -> None:
    with TemporaryDirectory() as folder:
        square, psf = Path(folder) / "square.tif", Path(folder) / "psf.json"
        cv2.imwrite(str(square), photograph(ONE_SQUARE))
        calibrate = ["calibrate", str(square), "--force", "--out", str(psf)]
        lines = {" ".join(words): words for words in LINES} | {"calibrate, one square": calibrate}
        works = [
            _started(["-c", "import numpy"]),
            *(_started(["-m", "standoff", *words]) for words in lines.values()),
        ]
        peer_s, *ours_s = shortest_s(works, record.pick(20.0, 1.0), clock=_children_s)
        for words, time_s in zip(lines, ours_s, strict=True):
            record.time(f"standoff {words}", time_s, "import numpy", peer_s)
