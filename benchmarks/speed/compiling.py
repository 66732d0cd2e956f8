"""Processor time of the first calibration after an installation: what numba compiles.

Run with ``python -m benchmarks.speed.compiling [--beside DIR]``. A script calls
``standoff.calibrate_psf`` on a photograph of one square, with an empty cache and then again. The
peer is another checkout of this project.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from benchmarks.harness import Recorder, benchmark
from benchmarks.speed.edges import (
    CHECKOUT,
    ONE_SQUARE,
    Beside,
    peer_of,
    photograph,
    run_to_end,
)

_SCRIPT = "import standoff, sys; standoff.calibrate_psf(sys.argv[1])"


@benchmark("numpy", "numba", "llvmlite")
def main(record: Recorder, *, beside: Beside = None) -> None:
    checkouts = [CHECKOUT] if beside is None else [CHECKOUT, beside.resolve()]
    with TemporaryDirectory(prefix="standoff-") as folder:
        image = Path(folder) / "one.png"
        cv2.imwrite(str(image), photograph(ONE_SQUARE))
        for name in ("first", "second"):
            times_s = [
                run_to_end(["-c", _SCRIPT, str(image)], one, NUMBA_CACHE_DIR=f"{folder}/{number}")[
                    0
                ]
                for number, one in enumerate(checkouts)
            ]
            record.figure(
                f"{name} calibration after an installation", times_s[0], "s", **peer_of(times_s)
            )
