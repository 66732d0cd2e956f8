"""Speed of the zoom-out models beside OpenCV, and beside Pillow + scipy.ndimage.

On one thread, float32, the finite check included, kernels built before. OpenCV's
peer is ``GaussianBlur`` by sigma ``sqrt(z^2 - 1)``, then ``resize`` by ``INTER_CUBIC``; Pillow's is
``Image.resize`` with the same box, then ``gaussian_filter`` with the paper's width; ``memcpy``
copies the input. The kernels' build is timed apart, first for any size and then for another one.

    python -m benchmarks.speed.zoom_out [--plot docs/images/zoom-out-cost.png]

plots how the cost grows with image size and zoom as well.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import sqrt
from pathlib import Path
from time import perf_counter
from typing import Annotated

import cv2
import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from analysis.detectability import MODEL_COLOURS
from analysis.reports import in_report_style, new_figure, png_bytes
from benchmarks.harness import Recorder, benchmark, best_s, shortest_s
from simulation import (
    MODELS,
    GaussianPsf,
    LensOtf,
    MeasuredPsf,
    Model,
    Psf,
    SamplingGrid,
    zoom_operator,
    zoom_out_image,
)
from simulation.arrays import AnyArray, Float32Array

SIGMA_PX = 0.935
GREEN_PER_PITCH = 0.55 / 8.3
NEAREST = GaussianPsf(sigma_x_px=0.5, sigma_y_px=0.5)
PSFS: dict[str, Psf] = {
    "Gaussian": GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX),
    "round": MeasuredPsf(
        lens=LensOtf(cut_off_period_px=(5.6 * GREEN_PER_PITCH, 0.0, 5.6 * GREEN_PER_PITCH)),
        gaussian=NEAREST,
    ),
    # f/4 and f/9 along axes turned by 30 degrees.
    "astigmatic": MeasuredPsf(
        lens=LensOtf(cut_off_period_px=(0.3479, -0.1435, 0.5136)), gaussian=NEAREST
    ),
}
SHAPES = ((580, 780), (3000, 4000))
ZOOMS = (1.3, 2.0, 3.0)
GROWTH_MEGAPIXELS = (0.1, 0.3, 1.0, 3.0, 12.0, 24.0)
GROWTH_ZOOMS = (1.05, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0)


def pillow_and_scipy(image: Float32Array, zoom: float) -> Float32Array:
    grid = SamplingGrid.centred((image.shape[0], image.shape[1]), zoom)
    margin_x, margin_y = (
        max((size - count * zoom) / 2, 0.0)
        for size, count in ((image.shape[1], grid.cols), (image.shape[0], grid.rows))
    )
    box = (margin_x, margin_y, image.shape[1] - margin_x, image.shape[0] - margin_y)
    resized = Image.fromarray(image).resize(
        (grid.cols, grid.rows), Image.Resampling.BICUBIC, box=box
    )
    return np.asarray(gaussian_filter(np.asarray(resized), SIGMA_PX * sqrt(1 - zoom**-2)))


@in_report_style
def _plot_growth(path: Path) -> None:
    psf = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)
    rng = np.random.default_rng(0)
    figure = new_figure(8.0, 3.4)
    by_size, by_zoom = figure.subplots(1, 2)
    calls: dict[str, Callable[..., object]] = {
        model: partial(zoom_out_image, psf=psf, model=model) for model in MODELS
    }
    calls["Pillow + scipy"] = pillow_and_scipy
    for name, call in calls.items():
        colour = MODEL_COLOURS.get(name, "#1b1f24")
        style = "-o" if name in MODEL_COLOURS else "--s"
        costs = []
        for megapixels in GROWTH_MEGAPIXELS:
            side = round(sqrt(megapixels * 1e6))
            image = rng.uniform(0, 255, (side, side)).astype(np.float32)
            costs.append(best_s(partial(call, image, 2.0), 0.3) * 1e3)
        by_size.plot(GROWTH_MEGAPIXELS, costs, style, color=colour, markersize=3, label=name)
        image = rng.uniform(0, 255, (1732, 1732)).astype(np.float32)
        costs = [best_s(partial(call, image, zoom), 0.3) * 1e3 for zoom in GROWTH_ZOOMS]
        by_zoom.plot(GROWTH_ZOOMS, costs, style, color=colour, markersize=3)
    by_size.set(xscale="log", yscale="log", xlabel="reference / megapixels", ylabel="time / ms")
    by_size.set_title("by size, zoom 2")
    by_zoom.set(yscale="log", xlabel="zoom-out z", ylabel="time / ms")
    by_zoom.set_title("by zoom, 3 megapixels")
    figure.legend(loc="outside lower center", ncols=5, fontsize=8)
    path.write_bytes(png_bytes(figure))


def _opencv(image: Float32Array, zoom: float) -> AnyArray:
    grid = SamplingGrid.centred((image.shape[0], image.shape[1]), zoom)
    blurred = cv2.GaussianBlur(image, (0, 0), sqrt(zoom**2 - 1))
    return cv2.resize(blurred, (grid.cols, grid.rows), interpolation=cv2.INTER_CUBIC)


def _compare(record: Recorder, shape: tuple[int, int]) -> None:
    """Time all models, PSFs and zooms for one size."""
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    copy = np.empty_like(image)
    memcpy_s = best_s(partial(np.copyto, copy, image), record.pick(1.0, 0.1))
    size = f"{shape[1]} x {shape[0]}"
    record.say(f"\n{size}, memcpy {memcpy_s * 1e3:.2f} ms")
    rows: list[tuple[Model, str]] = [("bicubic", "Gaussian"), ("paper", "Gaussian")]
    rows += [(model, name) for model in ("matched", "lmmse") for name in PSFS]
    for zoom in ZOOMS:
        calls: list[Callable[[], object]] = [
            partial(_opencv, image, zoom),
            partial(pillow_and_scipy, image, zoom),
        ]
        calls += [partial(zoom_out_image, image, zoom, PSFS[name], model) for model, name in rows]
        opencv_s, pillow_s, *times_s = shortest_s(calls, record.pick(6.0, 0.5))
        for (model, name), own_s in zip(rows, times_s, strict=True):
            record.time(f"{model}, {name} PSF, {size}, zoom {zoom}", own_s, "OpenCV", opencv_s)
        record.say(f"Pillow + scipy {1e3 * pillow_s:.2f} ms")


def _build(record: Recorder) -> None:
    """Time the kernels of a PSF that was not seen before, then those of another image size."""
    for zoom in ZOOMS:
        for model in ("matched", "lmmse"):
            for name, psf in PSFS.items():
                times_ms = []
                # A seed in the width makes it another PSF to the caches.
                fresh = _slightly_wider(psf)
                for shape in ((580, 780), (600, 811)):
                    start_s = perf_counter()
                    zoom_operator(shape, SamplingGrid.centred(shape, zoom), fresh, model)
                    times_ms.append((perf_counter() - start_s) * 1e3)
                record.figure(f"build {model}, {name} PSF, zoom {zoom}", times_ms[0], "ms")
                record.say(f"for another size {times_ms[1]:.0f} ms")


def _slightly_wider(psf: Psf) -> Psf:
    if isinstance(psf, GaussianPsf):
        return replace(psf, sigma_x_px=psf.sigma_x_px + 1e-9)
    assert isinstance(psf, MeasuredPsf)
    return replace(psf, lens=replace(psf.lens, gaussian_px2=(1e-9, 0.0, 1e-9)))


@benchmark(
    "numpy",
    "numba",
    "opencv-contrib-python-headless",
    "scipy",
    "Pillow",
    note=f"one thread, float32; PSFs: Gaussian of {SIGMA_PX} px, f/5.6, f/4 and f/9",
)
def main(
    record: Recorder, *, plot: Annotated[Path | None, "also plot the cost by size and zoom"] = None
) -> None:
    cv2.setNumThreads(1)
    for shape in record.pick(SHAPES, SHAPES[:1]):
        _compare(record, shape)
    _build(record)
    if plot is not None:
        _plot_growth(plot)
        record.say(f"\nwrote {plot}")
