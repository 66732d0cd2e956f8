"""Processor time of the first calibration after an installation: what numba compiles.

Run with ``python -m benchmarks.bench_compiling [--beside DIR]``. A script calls
``standoff.calibrate_psf`` on a photograph of one square, with an empty cache and then again. The
peer is another checkout of this project.
"""

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from benchmarks.bench_edges import CHECKOUT, ONE_SQUARE, parser, photograph
from benchmarks.harness import Recorder

_SCRIPT = "import standoff, sys; standoff.calibrate_psf(sys.argv[1])"


def calibrated_cpu_s(checkout: Path, image: Path, cache: Path) -> float:
    """Processor time of a process that calibrates, in s."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "NUMBA_CACHE_DIR": str(cache)}
    with subprocess.Popen(
        [sys.executable, "-c", _SCRIPT, str(image)],
        cwd=checkout,
        env=environment,
        stderr=subprocess.DEVNULL,
    ) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise RuntimeError(f"calibrate_psf of {checkout} failed")
    return used.ru_utime + used.ru_stime


def main() -> None:
    options = parser(__doc__).parse_args()
    checkouts = [CHECKOUT] if options.beside is None else [CHECKOUT, options.beside.resolve()]
    with (
        Recorder.of(options, "compiling", packages=("numpy", "numba", "llvmlite")) as record,
        TemporaryDirectory(prefix="standoff-") as folder,
    ):
        image = Path(folder) / "one.png"
        cv2.imwrite(str(image), photograph(ONE_SQUARE))
        for name in ("first", "second"):
            own, *peers = (
                calibrated_cpu_s(checkout, image, Path(folder) / str(number))
                for number, checkout in enumerate(checkouts)
            )
            peer = peers[0] if peers else None
            record.say(
                f"{name} calibration: {own:.1f} s of processor time"
                + ("" if peer is None else f"; beside it {peer:.1f} s")
            )
            record.figure(
                f"{name} calibration after an installation",
                own,
                "s",
                peer=None if peer is None else "the checkout beside it",
                peer_value=peer,
            )


if __name__ == "__main__":
    main()
