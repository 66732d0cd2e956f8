"""Training pairs a second: files in folders and tar files, one process and two, and before.

Run with ``python -m benchmarks.speed.sr_pairs [--before CHECKOUT] [--workers N]``. The peer makes
the same pairs one by one, as earlier versions did: OpenCV's PNGs, each file and its folder made
durable. CHECKOUT is a working tree of a version without layouts, which is then run on the same
photographs; it knew linear levels and the model ``matched`` alone, and so do we in that comparison.
The rate with workers is that of the second half of a run, without the start.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Annotated
from unittest.mock import patch

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from acquisition.photographs import LINEAR, ReadOptions, marked_png, read_photograph
from acquisition.session import write_shared
from analysis.sweep import SweepOptions
from benchmarks.harness import Recorder, benchmark
from simulation import GaussianPsf
from simulation.zoom import sr_pairs
from standoff.library import PairFormat, training_pairs

CROP_PX, ZOOM = 192, 2.0
PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.8)
KINDS = {
    "grey, 780 x 580": ((580, 780), 24),
    "colour, 1600 x 1200": ((1200, 1600, 3), 8),
    "grey, 4000 x 3000": ((3000, 4000), 2),
}

BEFORE = """
import sys, time
from pathlib import Path
import cv2
from simulation import GaussianPsf
from standoff.sr_dataset import SrDatasetSettings, write_sr_dataset
cv2.setNumThreads(1)
settings = SrDatasetSettings(
    zoom=2.0, model="matched", psf=GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.8), crop_px=192,
    stride_px=192, test_fraction=0.1, seed=0, is_float=False,
)
images = sorted(Path(sys.argv[1]).iterdir())
write_sr_dataset(Path(sys.argv[2]) / "warm", images[:1], settings)
start = time.perf_counter()
made = write_sr_dataset(Path(sys.argv[2]) / "timed", images, settings)
print((made.train + made.test) / (time.perf_counter() - start))
"""


def _write_photographs(folder: Path, shape: tuple[int, ...], count: int) -> None:
    """Scenes with a spectrum of 1/f^1.1 and noise of 1 DN, blurred as the camera does."""
    rng = np.random.default_rng(1)
    rows, cols = shape[:2]
    freq = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols))
    folder.mkdir(parents=True)
    for number in range(count):
        spectrum = np.fft.rfft2(rng.standard_normal((rows, cols))) / (1e-3 + freq**1.1)
        scene = gaussian_filter(np.fft.irfft2(spectrum, s=(rows, cols)), 0.8)
        scene = 128 + 40 * scene / scene.std() + rng.standard_normal((rows, cols))
        levels = np.clip(np.rint(scene), 0, 255).astype(np.uint8)
        if len(shape) == 3:
            levels = np.dstack([levels, np.roll(levels, 3, 0), np.roll(levels, 5, 1)])
        cv2.imwrite(str(folder / f"{number:04d}.png"), levels)


@dataclass(frozen=True)
class _Making:
    """A way to make the pairs of a folder of photographs."""

    photographs: Path
    layout: PairFormat = "folder"
    workers: int = 1
    is_as_before: bool = False

    def __call__(self, out: Path) -> int:
        """Make the pairs; return their number."""
        made = training_pairs(
            sorted(self.photographs.iterdir()),
            out,
            psf=PSF,
            zoom=ZOOM,
            model="matched" if self.is_as_before else "lmmse",
            crop_px=CROP_PX,
            format=self.layout,
            sweep=SweepOptions(workers=self.workers),
            reading=ReadOptions(encoding=LINEAR if self.is_as_before else None),
        )
        return made.train + made.test


def _write_pairs_one_by_one(photographs: Path, out: Path) -> int:
    """Make the same pairs as earlier versions did."""
    out.mkdir()
    count = 0
    for path in sorted(photographs.iterdir()):
        photograph = read_photograph(path)
        pairs = sr_pairs(
            photograph.colour_planes, ZOOM, PSF, crop_px=CROP_PX, stride_px=CROP_PX, model="lmmse"
        )
        for pair in pairs:
            for side, image in (("high", pair.high), ("low", pair.low)):
                levels = photograph.encoding.encode(image, photograph.white_dn)
                levels = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
                if levels.ndim == 3:
                    levels = levels[:, :, ::-1]
                data = cv2.imencode(".png", levels)[1].tobytes()
                name = out / f"{path.stem}_{count:05d}_{side}.png"
                write_shared(name, marked_png(data, photograph.encoding))
            count += 1
    return count


def _rate(make: Callable[[Path], int], folder: Path) -> float:
    """Pairs a second, into a new folder that stays: ext4 is slow where files were just deleted."""
    out = Path(mkdtemp(dir=folder)) / "out"
    start_s = time.perf_counter()
    count = make(out)
    return count / (time.perf_counter() - start_s)


def _before_rate(checkout: Path, photographs: Path, folder: Path) -> float:
    """Rate of an earlier version, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", BEFORE, str(photographs), mkdtemp(dir=folder)],
        env=os.environ | {"PYTHONPATH": str(checkout)},
        cwd=checkout,
        capture_output=True,
        text=True,
        check=True,
    )
    return float(done.stdout)


def _compare_layouts(record: Recorder, folder: Path, checkout: Path | None) -> None:
    """Rates of one process, by kind of photograph and layout."""
    layouts: tuple[PairFormat, ...] = ("folder", "webdataset")
    for number, (kind, (shape, count)) in enumerate(KINDS.items()):
        count = record.pick(count, 1)
        photographs = folder / f"photographs-{number}"
        _write_photographs(photographs, shape, count)
        for layout in layouts:
            with patch("os.fsync", wraps=os.fsync) as synced:
                _rate(_Making(photographs, layout), folder)
            record.say(f"{kind}, {layout}: {synced.call_count} fsyncs for {count} shards")
        works: dict[str, Callable[[], float]] = {
            layout: partial(_rate, _Making(photographs, layout), folder) for layout in layouts
        }
        works["one by one"] = partial(_rate, partial(_write_pairs_one_by_one, photographs), folder)
        if checkout is not None:
            for layout in layouts:
                making = _Making(photographs, layout, is_as_before=True)
                works[f"{layout}, linear, matched"] = partial(_rate, making, folder)
            works["before"] = partial(_before_rate, checkout, photographs, folder)
        rates = dict.fromkeys(works, 0.0)
        for _ in range(record.pick(4, 1) + 1):
            for name, work in works.items():
                rates[name] = max(rates[name], work())
        record.say(
            f"{kind}: " + "; ".join(f"{name} {found:.0f} pairs/s" for name, found in rates.items())
        )
        for layout in layouts:
            name = f"a pair of {kind}, {layout}"
            record.time(name, 1 / rates[layout], "one by one", 1 / rates["one by one"])


def _compare_workers(record: Recorder, folder: Path, workers: int) -> None:
    """Rates of worker processes in the second half of a run.

    Workers take some seconds to start, not always the same: the half lasts far longer than that.
    """
    count = record.pick(2048, 16)
    one = folder / "photographs-one"
    _write_photographs(one, (580, 780), 16)
    half, whole = folder / "half", folder / "whole"
    for target, copies in ((half, count // 2), (whole, count)):
        target.mkdir()
        sources = sorted(one.iterdir())
        for number in range(copies):
            # A byte after the end of a PNG makes another file of it.
            data = sources[number % len(sources)].read_bytes() + str(number).encode()
            (target / f"{number:05d}.png").write_bytes(data)
    seconds: dict[int, list[float]] = {1: [], workers: []}
    pairs = 0
    for number in (1, workers):
        for photographs in (half, whole):
            start_s = time.perf_counter()
            making = _Making(photographs, "webdataset", number)
            pairs = making(Path(mkdtemp(dir=folder)) / "out")
            seconds[number].append(time.perf_counter() - start_s)
    rates = {n: pairs / 2 / (whole_s - half_s) for n, (half_s, whole_s) in seconds.items()}
    record.time(f"a pair with {workers} workers", 1 / rates[workers], "1 process", 1 / rates[1])


@benchmark("numpy", "opencv-contrib-python-headless", "imagecodecs", "distributed")
def main(
    record: Recorder,
    *,
    before: Annotated[Path | None, "an older version's tree"] = None,
    workers: Annotated[int, "worker processes, 2 by default"] = 2,
) -> None:
    cv2.setNumThreads(1)
    with TemporaryDirectory() as name:
        _compare_layouts(record, Path(name), before)
        _compare_workers(record, Path(name), workers)
