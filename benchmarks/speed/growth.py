"""How cost grows with image size, zoom, number of edges, heights and images.

Every series is fitted by a power: an exponent of 1 doubles the time with
the size. The zoom-out by image size and zoom, the calibration by edges in its photographs, the
geometry by heights of its series, the curve of d' by images. ``--plot FILE`` draws all five.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import sqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import cv2
import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from acquisition.bench import load_bench
from analysis.detectability import Scenario, SweepPlan, scene_sums
from analysis.reports import in_report_style, new_figure, png_bytes
from benchmarks.harness import Recorder, benchmark, best_s, shortest_s
from benchmarks.speed.zoom_out import SIGMA_PX, pillow_and_scipy
from calibration.edges import EdgeImage
from calibration.geometry import GeometryCapture, GeometryOptions, geometry_of_captures
from calibration.psf import psf_of_images
from hil_mocks.truth import BenchTruth, CameraPose
from simulation import GaussianPsf, zoom_out_image
from simulation.arrays import Float32Array, FloatArray
from tests.calibration.closed_form import edge_image

CONFIG = Path(__file__).parents[2] / "configs" / "simulated.toml"
SMALL_CAMERA = {"simulated.width_px": 390, "simulated.height_px": 290}
PSF = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Growth:
    """Times of one piece of work for several sizes, ascending, and its peer's where it has one."""

    what: str
    label: str
    sizes: tuple[float, ...]
    times_s: tuple[float, ...]
    peer: str | None = None
    peer_s: tuple[float, ...] = ()

    @property
    def exponent(self) -> float:
        """Slope of the logarithm of the time over that of the size, by least squares."""
        return float(np.polyfit(np.log(self.sizes), np.log(self.times_s), 1)[0])


def _by_size(record: Recorder) -> _Growth:
    rng = np.random.default_rng(0)
    sizes = record.pick((0.1, 0.3, 1.0, 3.0, 12.0, 24.0), (0.1, 0.5, 3.0))
    sides = [round(sqrt(size * 1e6)) for size in sizes]
    images = [rng.uniform(0, 255, (side, side)).astype(np.float32) for side in sides]
    cases = [(image, 2.0) for image in images]
    return _zoomed_out(record, "zoom-out by 2", "reference / megapixels", sizes, cases)


def _by_zoom(record: Recorder) -> _Growth:
    image = np.random.default_rng(0).uniform(0, 255, (1732, 1732)).astype(np.float32)
    zooms = record.pick((1.05, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0), (1.2, 2.0, 4.0))
    cases = [(image, zoom) for zoom in zooms]
    return _zoomed_out(record, "zoom-out of 3 megapixels", "zoom-out z", zooms, cases)


def _zoomed_out(
    record: Recorder,
    what: str,
    label: str,
    sizes: tuple[float, ...],
    cases: Sequence[tuple[Float32Array, float]],
) -> _Growth:
    """Time zoom-outs of images beside Pillow's and scipy's."""
    times_s = [
        shortest_s(
            [partial(zoom_out_image, image, zoom, PSF), partial(pillow_and_scipy, image, zoom)],
            record.pick(0.6, 0.2),
        )
        for image, zoom in cases
    ]
    ours, peer = zip(*times_s, strict=True)
    return _Growth(
        what=what, label=label, sizes=sizes, times_s=ours, peer="Pillow + scipy", peer_s=peer
    )


def _by_edges(record: Recorder) -> _Growth:
    rng = np.random.default_rng(0)
    counts = record.pick((4, 16, 64, 256), (4, 16, 64))
    sources = [
        EdgeImage(
            name=f"edge {place}",
            image_dn=edge_image(0.8, float(angle), has_pixel=True) + rng.normal(0, 440, (90, 110)),
        )
        for place, angle in enumerate(rng.uniform(0, 180, counts[-1]))
    ]
    return _timed(
        "calibration of the PSF",
        "edges, one a photograph",
        counts,
        lambda count: psf_of_images(sources[:count]),
        record,
    )


def _by_heights(record: Recorder) -> _Growth:
    counts = record.pick((3, 5, 8, 12), (3, 5))
    truth = BenchTruth(load_bench(CONFIG, SMALL_CAMERA))
    heights = np.round(np.geomspace(180.0, 420.0, counts[-1]), 2)
    captures = [
        GeometryCapture(
            name=f"{height:g} mm",
            kind="texture",
            target="brick",
            orientation_deg=0.0,
            height_mm=float(height),
            image=_seen(truth, float(height)),
        )
        for height in heights
    ]
    nominal = GeometryOptions(nominal_focal_px=truth.camera.focal_length_px)

    def calibrate(count: int) -> object:
        places = np.linspace(0, counts[-1] - 1, count).round().astype(int)
        return geometry_of_captures([captures[place] for place in places], nominal)

    return _timed("geometry of a height series", "heights of 390 x 290", counts, calibrate, record)


def _seen(truth: BenchTruth, height_mm: float) -> Float32Array:
    """Capture without noise."""
    image = truth.expected_image_dn(
        "brick", 0.0, CameraPose(height_mm=height_mm), exposure_us=9000.0
    )
    return np.asarray(image, dtype=np.float32)


def _by_images(record: Recorder) -> _Growth:
    counts = record.pick((1, 4, 16, 64), (1, 4, 16))
    plan = SweepPlan(
        scenario=Scenario(psf=PSF), models=("matched",), zooms=(1.0, 1.5, 2.0), tiles_per_side=1
    )
    rng = np.random.default_rng(0)
    with TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{place}.npy" for place in range(counts[-1])]
        for path in paths:
            rough = cv2.GaussianBlur(rng.standard_normal((450, 600)), (0, 0), 1.2)
            np.save(path, 120 + 150 * rough)
        return _timed(
            "artefacts of a curve of d', 3 zooms",
            "images of 600 x 450",
            counts,
            lambda count: [scene_sums(np.load(path), plan) for path in paths[:count]],
            record,
        )


def _timed(
    what: str,
    label: str,
    counts: tuple[int, ...],
    work: Callable[[int], object],
    record: Recorder,
) -> _Growth:
    """Time work of several sizes that has no peer."""
    times_s = [best_s(partial(work, count), record.pick(1.0, 0.1)) for count in counts]
    return _Growth(
        what=what,
        label=label,
        sizes=tuple(float(count) for count in counts),
        times_s=tuple(times_s),
    )


@in_report_style
def _plot_growths(growths: Sequence[_Growth]) -> bytes:
    """Draw one panel for each; a dotted line through the last point has exponent 1."""
    columns = 3
    rows = -(-len(growths) // columns)
    figure = new_figure(9.0, 2.9 * rows)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, growth in zip(panels, growths, strict=False):
        sizes = np.array(growth.sizes)
        times_ms = 1e3 * np.array(growth.times_s)
        axes.plot(sizes, times_ms, "-o", color="#0072B2", markersize=3, label="standoff")
        if growth.exponent > 0:
            axes.plot(sizes, times_ms[-1] * sizes / sizes[-1], ":", color="#8a8f98")
        if growth.peer_s:
            peer_ms = 1e3 * np.array(growth.peer_s)
            axes.plot(sizes, peer_ms, "--s", color="#1b1f24", markersize=3, label=growth.peer)
            axes.legend(fontsize=7.5)
        axes.set(xscale="log", yscale="log", xlabel=growth.label, ylabel="time / ms")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(sizes, _readable(sizes))
        # Less than two decades hold too few powers of ten to read a time off.
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.set_title(f"{growth.what}\nexponent {growth.exponent:.2f}")
    for axes in panels[len(growths) :]:
        axes.set_axis_off()
    return png_bytes(figure)


def _readable(sizes: FloatArray) -> list[str]:
    """Names of the sizes, without those that would run into the one before."""
    apart = 0.11 * np.log(sizes[-1] / sizes[0])
    names, last = [], -np.inf
    for size in sizes:
        is_shown = np.log(size) - last > apart
        last = np.log(size) if is_shown else last
        names.append(f"{size:g}" if is_shown else "")
    return names


@benchmark(
    "numpy", "numba", "scipy", "opencv-contrib-python-headless", note="OpenCV with one thread"
)
def main(
    record: Recorder, *, plot: Annotated[Path | None, "draw them into a PNG file"] = None
) -> None:
    cv2.setNumThreads(1)
    growths = []
    for measure in (_by_size, _by_zoom, _by_edges, _by_heights, _by_images):
        growth = measure(record)
        growths.append(growth)
        for size, time_s in zip(growth.sizes, growth.times_s, strict=True):
            record.say(f"  {size:8g} {growth.label:24s} {1e3 * time_s:10.2f} ms")
        record.figure(
            f"{growth.what}, at {growth.sizes[-1]:g} {growth.label}",
            1e3 * growth.times_s[-1],
            "ms",
            growth.peer,
            1e3 * growth.peer_s[-1] if growth.peer_s else None,
        )
        record.figure(f"{growth.what}: exponent of {growth.label}", growth.exponent, "")
    if plot is not None:
        plot.write_bytes(_plot_growths(growths))
        record.say(f"\nwrote {plot}")
