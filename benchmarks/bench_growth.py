"""How cost grows with image size, zoom, number of edges, heights and images.

Every series is fitted by a power: an exponent of 1 doubles the time with
the size. The zoom-out by image size and zoom, the calibration by edges in its photographs, the
geometry by heights of its series, the curve of d' by images. ``--plot FILE`` draws all five.
"""

from collections.abc import Callable
from functools import partial
from math import sqrt
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from acquisition.bench import load_bench
from analysis.detectability import Scenario, SweepPlan, scene_sums
from benchmarks.bench_zoom_out import SIGMA_PX, pillow_and_scipy
from benchmarks.growth_plot import Growth, plot_growths
from benchmarks.harness import Recorder, bench_parser
from benchmarks.timing import best_s, shortest_s
from calibration.edges import EdgeImage
from calibration.geometry import GeometryCapture, GeometryOptions, calibrate_geometry
from calibration.psf import calibrate_psf
from hil_mocks.scene import BenchTruth, CameraPose
from simulation import GaussianPsf, zoom_out
from simulation.arrays import Float32Array
from tests.calibration.closed_form import edge_image

CONFIG = Path(__file__).parents[1] / "configs" / "simulated.toml"
SMALL_CAMERA = {"simulated.width_px": 390, "simulated.height_px": 290}
PSF = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)


def by_size(record: Recorder) -> Growth:
    rng = np.random.default_rng(0)
    megapixels = record.pick((0.1, 0.3, 1.0, 3.0, 12.0, 24.0), (0.1, 0.5, 3.0))
    ours, peer = [], []
    for size in megapixels:
        side = round(sqrt(size * 1e6))
        image = rng.uniform(0, 255, (side, side)).astype(np.float32)
        calls = [partial(zoom_out, image, 2.0, PSF), partial(pillow_and_scipy, image, 2.0)]
        own_s, peer_s = shortest_s(calls, record.pick(0.6, 0.2))
        ours.append(own_s)
        peer.append(peer_s)
    return Growth(
        what="zoom-out by 2",
        label="reference / megapixels",
        sizes=megapixels,
        times_s=tuple(ours),
        peer="Pillow + scipy",
        peer_s=tuple(peer),
    )


def by_zoom(record: Recorder) -> Growth:
    image = np.random.default_rng(0).uniform(0, 255, (1732, 1732)).astype(np.float32)
    zooms = record.pick((1.05, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0), (1.2, 2.0, 4.0))
    ours, peer = [], []
    for zoom in zooms:
        calls = [partial(zoom_out, image, zoom, PSF), partial(pillow_and_scipy, image, zoom)]
        own_s, peer_s = shortest_s(calls, record.pick(0.6, 0.2))
        ours.append(own_s)
        peer.append(peer_s)
    return Growth(
        what="zoom-out of 3 megapixels",
        label="zoom-out z",
        sizes=zooms,
        times_s=tuple(ours),
        peer="Pillow + scipy",
        peer_s=tuple(peer),
    )


def by_edges(record: Recorder) -> Growth:
    rng = np.random.default_rng(0)
    counts = record.pick((4, 16, 64, 256), (4, 16, 64))
    sources = [
        EdgeImage(
            name=f"edge {place}",
            image_dn=edge_image(0.8, float(angle), has_pixel=True) + rng.normal(0, 440, (90, 110)),
        )
        for place, angle in enumerate(rng.uniform(0, 180, counts[-1]))
    ]
    return timed(
        "calibration of the PSF",
        "edges, one a photograph",
        counts,
        lambda count: calibrate_psf(sources[:count]),
        record,
    )


def by_heights(record: Recorder) -> Growth:
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
            image=seen(truth, float(height)),
        )
        for height in heights
    ]
    nominal = GeometryOptions(nominal_focal_px=truth.camera.focal_length_px)

    def calibrate(count: int) -> object:
        places = np.linspace(0, counts[-1] - 1, count).round().astype(int)
        return calibrate_geometry([captures[place] for place in places], nominal)

    return timed("geometry of a height series", "heights of 390 x 290", counts, calibrate, record)


def seen(truth: BenchTruth, height_mm: float) -> Float32Array:
    """Capture without noise."""
    image = truth.expected_image_dn(
        "brick", 0.0, CameraPose(height_mm=height_mm), exposure_us=9000.0
    )
    return np.asarray(image, dtype=np.float32)


def by_images(record: Recorder) -> Growth:
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
        return timed(
            "artefacts of a curve of d', 3 zooms",
            "images of 600 x 450",
            counts,
            lambda count: [scene_sums(np.load(path), plan) for path in paths[:count]],
            record,
        )


def timed(
    what: str,
    label: str,
    counts: tuple[int, ...],
    work: Callable[[int], object],
    record: Recorder,
) -> Growth:
    """Time work of several sizes that has no peer."""
    times_s = [best_s(partial(work, count), record.pick(1.0, 0.1)) for count in counts]
    return Growth(
        what=what,
        label=label,
        sizes=tuple(float(count) for count in counts),
        times_s=tuple(times_s),
    )


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw them into a PNG file")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    with Recorder.of(
        given,
        "growth",
        packages=("numpy", "numba", "scipy", "opencv-contrib-python-headless"),
        note="OpenCV with one thread",
    ) as record:
        growths = []
        for measure in (by_size, by_zoom, by_edges, by_heights, by_images):
            growth = measure(record)
            growths.append(growth)
            record.say(f"\n{growth.what}: exponent {growth.exponent:.2f}")
            for size, time_s in zip(growth.sizes, growth.times_s, strict=True):
                record.say(f"  {size:8g} {growth.label:24s} {1e3 * time_s:10.2f} ms")
            record.figure(
                f"{growth.what}, at {growth.sizes[-1]:g} {growth.label}",
                1e3 * growth.times_s[-1],
                "ms",
                peer=growth.peer,
                peer_value=1e3 * growth.peer_s[-1] if growth.peer_s else None,
            )
            record.figure(f"{growth.what}: exponent of {growth.label}", growth.exponent, "")
        if given.plot is not None:
            given.plot.write_bytes(plot_growths(growths))
            record.say(f"\nwrote {given.plot}")


if __name__ == "__main__":
    main()
