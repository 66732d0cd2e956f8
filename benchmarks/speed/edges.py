"""``standoff calibrate`` on photographs with 1000 edges: processor time and memory.

Run with ``python -m benchmarks.speed.edges [--beside DIR]``. Scenes of 1, 12 and 46 megapixels hold
250 dark squares of 38, 130 and 250 px, rendered with eight times the pixels, in 16-bit levels with
noise of 4 of 2,200 levels. Every figure is of the whole command, less what the same command needs
for a picture with one square: what starts up and is imported. The peer is another checkout of this
project, run on the same files in turn; without one the figures stand alone.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Recorder, benchmark
from simulation.arrays import FloatArray

CHECKOUT = Path(__file__).parents[2]
Beside = Annotated[Path | None, "checkout of this project that is the peer"]
_FINER = 8
_DARK, _BRIGHT, _NOISE = 800.0, 3000.0, 4.0
_SIGMA_PX = 0.8
_LEVELS = 16  # stored levels per DN: 12 bits in 16


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scene:
    """A photograph of tilted squares: its size, and the number and the sides of the squares."""

    name: str
    rows: int
    cols: int
    squares: int
    side_px: int

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.rows * self.cols


SCENES = (
    _Scene(name="1 MP", rows=1000, cols=1000, squares=250, side_px=38),
    _Scene(name="12 MP", rows=3000, cols=4000, squares=250, side_px=130),
    _Scene(name="46 MP", rows=5520, cols=8288, squares=250, side_px=250),
)
QUICK = (_Scene(name="0.2 MP", rows=480, cols=480, squares=49, side_px=38),)
ONE_SQUARE = _Scene(name="one square", rows=80, cols=80, squares=1, side_px=38)


def _square(side_px: float, middle: FloatArray, turn_rad: float, half: int) -> FloatArray:
    """Cover of pixels up to ``half`` from the middle by a blurred square, from 0 to 1."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    corners = 0.5 * side_px * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    outline = corners @ np.array([[c, s], [-s, c]]) + middle + half + 0.5
    size = 2 * half + 1
    fine = np.zeros((size * _FINER, size * _FINER), np.float32)
    points = np.rint((outline * _FINER - 0.5) * 256).astype(np.int32)
    cv2.fillPoly(fine, [points], (1.0,), shift=8)
    blurred = np.asarray(cv2.GaussianBlur(fine, (0, 0), _SIGMA_PX * _FINER), dtype=np.float64)
    return np.asarray(blurred.reshape(size, _FINER, size, _FINER).mean(axis=(1, 3)))


def photograph(scene: _Scene, seed: int = 0) -> NDArray[np.uint16]:
    """Render a scene."""
    rng = np.random.default_rng(seed)
    down = round(scene.rows / np.sqrt(scene.pixels / scene.squares))
    across = -(-scene.squares // down)
    image = np.full((scene.rows, scene.cols), _BRIGHT)
    half = round(0.75 * scene.side_px) + 6
    for k in range(scene.squares):
        row, col = divmod(k, across)
        place = np.array([(col + 0.5) * scene.cols / across, (row + 0.5) * scene.rows / down])
        place += rng.uniform(-0.5, 0.5, 2)
        x, y = np.floor(place).astype(int).tolist()
        turn = np.deg2rad(rng.uniform(5.0, 11.0))
        cover = _square(scene.side_px, place - [x, y], turn, half)
        top, left = max(y - half, 0), max(x - half, 0)
        part = image[top : y + half + 1, left : x + half + 1]
        inside = cover[top - y + half :, left - x + half :][: part.shape[0], : part.shape[1]]
        part -= (_BRIGHT - _DARK) * inside
    image += rng.normal(0.0, _NOISE, image.shape)
    return np.asarray(np.clip(np.rint(image * _LEVELS), 0, 65535), dtype=np.uint16)


def run_to_end(words: list[str], checkout: Path, **variables: str) -> tuple[float, float]:
    """Processor time in s and largest resident memory in bytes of Python with a checkout's code."""
    with subprocess.Popen(
        [sys.executable, *words],
        cwd=checkout,
        env=os.environ | {"PYTHONPATH": str(checkout)} | variables,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(words)} failed with the code of {checkout}")
    return used.ru_utime + used.ru_stime, 1024.0 * used.ru_maxrss


def _costs(checkouts: list[Path], image: Path, rounds: int) -> FloatArray:
    """Least time and memory of the command in as many rounds, by checkout, which take turns."""
    words = ["-m", "standoff", "calibrate", str(image), "--out", str(image.with_suffix(".json"))]
    runs = [[run_to_end([*words, "--force"], one) for one in checkouts] for _ in range(rounds)]
    return np.asarray(np.min(runs, axis=0))


def peer_of(values: Sequence[float]) -> dict[str, Any]:
    """What a figure says of the second checkout, where there is one."""
    return {"peer": "the checkout beside it", "peer_value": values[1]} if values[1:] else {}


@benchmark("numpy", "numba", "scipy")
def main(record: Recorder, *, beside: Beside = None) -> None:
    checkouts = [CHECKOUT]
    if beside is None:
        record.say("skipped: the comparison with another checkout, as --beside names none")
    else:
        checkouts.append(beside.resolve())
    rounds = record.pick(3, 1)
    with TemporaryDirectory(prefix="standoff-") as folder:
        start = Path(folder) / "one.png"
        cv2.imwrite(str(start), photograph(ONE_SQUARE))
        _costs(checkouts, start, 1)  # compiles what is not
        bare = _costs(checkouts, start, rounds)
        record.say("start-up: " + ", ".join(f"{seconds:.2f} s" for seconds, _ in bare))
        for scene in record.pick(SCENES, QUICK):
            path = Path(folder) / "scene.png"
            cv2.imwrite(str(path), photograph(scene))
            times_s, memories_bytes = (_costs(checkouts, path, rounds) - bare).T.tolist()
            for name, unit, values in (
                (f"calibrate, {scene.name}", "s", times_s),
                (
                    f"memory of calibrate, {scene.name}",
                    "bytes/px",
                    [memory / scene.pixels for memory in memories_bytes],
                ),
            ):
                record.figure(name, values[0], unit, **peer_of(values))
