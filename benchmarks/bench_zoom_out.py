"""Speed of the zoom-out models beside Pillow + scipy.ndimage.

Everything here runs on one thread by itself; float32, weights cached. ``peer`` is ``Image.resize``
with the same box, then ``gaussian_filter`` with the paper's width; ``memcpy`` copies the input.

    python -m benchmarks.bench_zoom_out [--plot docs/images/zoom-out-cost.png]

plots how the cost grows with image size and zoom as well.
"""

from collections.abc import Callable
from functools import partial
from math import sqrt
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from analysis.detectability import MODEL_COLOURS
from analysis.reports import in_report_style, new_figure, png_bytes
from benchmarks.harness import Recorder, bench_parser
from benchmarks.timing import best_s, shortest_s
from simulation import MODELS, GaussianPsf, SamplingGrid, zoom_out
from simulation.arrays import Float32Array

SIGMA_PX = 0.935
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
def plot_growth(path: Path) -> None:
    psf = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)
    rng = np.random.default_rng(0)
    figure = new_figure(8.0, 3.4)
    by_size, by_zoom = figure.subplots(1, 2)
    calls: dict[str, Callable[..., object]] = {
        model: partial(zoom_out, psf=psf, model=model) for model in MODELS
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


def compare(record: Recorder, shape: tuple[int, int]) -> None:
    """Print a table of all models and zooms for one size."""
    psf = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    copy = np.empty_like(image)
    memcpy_s = best_s(partial(np.copyto, copy, image), record.pick(1.0, 0.1))
    record.say(f"\n{shape[1]} x {shape[0]}, memcpy {memcpy_s * 1e3:.2f} ms")
    record.say("  zoom  model        ms   peer ms  times faster  memcpys")
    speedups: dict[str, list[float]] = {model: [] for model in MODELS}
    for zoom in ZOOMS:
        calls: list[Callable[[], object]] = [partial(pillow_and_scipy, image, zoom)]
        calls += [partial(zoom_out, image, zoom, psf, model) for model in MODELS]
        peer_s, *times_s = shortest_s(calls, record.pick(4.0, 0.3))
        for model, own_s in zip(MODELS, times_s, strict=True):
            speedups[model].append(peer_s / own_s)
            record.figure(
                f"{model}, {shape[1]} x {shape[0]}, zoom {zoom}",
                own_s * 1e3,
                "ms",
                peer="Pillow + scipy",
                peer_value=peer_s * 1e3,
            )
            record.say(
                f"  {zoom:4.1f}  {model:8s} {own_s * 1e3:7.2f} {peer_s * 1e3:8.2f}"
                f" {peer_s / own_s:12.1f} {own_s / memcpy_s:9.1f}"
            )
    means = ", ".join(f"{model} {np.mean(ratios):.1f}" for model, ratios in speedups.items())
    record.say(f"  mean times faster: {means}")


def main() -> None:
    parser = bench_parser("Speed of the zoom-out models.")
    parser.add_argument("--plot", type=Path, help="also plot the cost by size and zoom")
    given = parser.parse_args()
    with Recorder.of(
        given,
        "zoom_out",
        packages=("numpy", "numba", "scipy", "Pillow"),
        note=f"one thread, float32, sigma {SIGMA_PX} px",
    ) as record:
        for shape in SHAPES:
            compare(record, shape)
        if given.plot is not None:
            plot_growth(given.plot)
            record.say(f"\nwrote {given.plot}")


if __name__ == "__main__":
    main()
