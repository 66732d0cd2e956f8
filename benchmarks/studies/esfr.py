"""Accuracy and speed of the model-free e-SFR, beside ISO 12233 by bins and PyPI's quickMTF.

Accuracy: the relative error of MTF50 on closed-form edges of 110 x 90 px: Gaussians sampled at
points, Gaussians behind square pixels, diffraction-limited lenses behind square pixels; without
noise and at a signal-to-noise ratio of 100. Peers: the standard's way written out here (bins of
1/4 px, central difference with its correction, Hann window, FFT), and quickMTF where it can be
imported. Speed: one edge, samples at hand, single-threaded.
"""

import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from itertools import product

import numpy as np

from benchmarks.harness import Recorder, benchmark, best_s
from benchmarks.peers.edges import curve_by_bins, quick_mtf, samples_of
from benchmarks.peers.program import PeerError
from calibration.edges import (
    EdgeImage,
    edges_of_image,
    gaussian_mtf50,
    measure_esfr,
    pixel_mtf50,
)
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image
from tests.calibration.diffraction import diffracted_edge, system_mtf50
from tests.calibration.squares import square_cover

NORMALS_DEG = (4.0, 12.0, 95.0)
SIGMAS_PX = (0.4, 0.6, 0.9, 1.4)
CUTOFFS = (0.4, 0.7, 1.2, 2.5)
NOISE_DN = 440.0  # of a contrast of 44000
DRAWS = 4
EVERY_DEG = (0, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 2, 5, 10, 18.435, 26.565, 35, 45, 63.435, 80, 89.5, 90)
HELD = 1.959964


def _cases() -> dict[str, list[tuple[FloatArray, float]]]:
    """Images and their true MTF50, by kind."""
    turns = [(n, float(np.deg2rad(n))) for n in NORMALS_DEG]
    return {
        "Gaussian, points": [
            (edge_image(s, n), gaussian_mtf50(s)) for s in SIGMAS_PX for n, _ in turns
        ],
        "Gaussian, square pixels": [
            (edge_image(s, n, has_pixel=True), pixel_mtf50(s, t))
            for s in SIGMAS_PX
            for n, t in turns
        ],
        "diffraction, square pixels": [
            (diffracted_edge(c, n), system_mtf50(c, t)) for c in CUTOFFS for n, t in turns
        ],
    }


def _by_spline(image: FloatArray) -> float:
    esfr = measure_esfr(samples_of(image)[1])
    return (esfr.mtf50_cy_per_px if esfr else None) or np.nan


def _by_bins(image: FloatArray) -> float:
    """ISO 12233:2017, annex D, on the pixels that the spline sees."""
    return curve_by_bins(samples_of(image)[0]).mtf50 or np.nan


def _by_quick_mtf(image: FloatArray) -> float:
    try:
        return quick_mtf(image).mtf50 or np.nan
    except PeerError:
        return np.nan


def _every_angle(record: Recorder) -> None:
    """Largest error of MTF50 without noise at any angle, and how many edges have none."""
    worst, missing, count = 0.0, 0, 0
    for sigma in (0.4, 0.5, 0.6, 0.8, 1.5):
        for normal_deg in EVERY_DEG:
            image = edge_image(sigma, normal_deg, has_pixel=True, shape=(100, 100))
            [edge] = edges_of_image(EdgeImage(name="", image_dn=image))
            count += 1
            if edge.esfr_mtf50_cy_per_px is None:
                missing += 1
                continue
            truth = pixel_mtf50(sigma, float(np.deg2rad(normal_deg)))
            worst = max(worst, abs(edge.esfr_mtf50_cy_per_px / truth - 1))
    record.say(f"\nevery angle, no noise: worst {100 * worst:.4f} %, none for {missing} of {count}")
    record.figure("MTF50 at every angle, no noise, worst", 100 * worst, "%")
    record.figure("MTF50 at every angle, missing", 100 * missing / count, "%")


def _shading(record: Recorder) -> None:
    """Print what light that falls off costs sigma and MTF50, by its kind and the image's width."""
    record.say(
        "\nlight that falls off, no noise: largest error of the lens's sigma and of MTF50 / %"
    )
    kinds = {
        f"gradient of {100 * slope:g} %": partial(_gradient, slope) for slope in (0.15, 0.35)
    } | {"vignetting of 30 %": _vignetting}
    for kind, lit in kinds.items():
        for width_px in (100, 200, 400):
            shape = (width_px, width_px)
            sigma_error, mtf50_error = 0.0, 0.0
            for sigma, normal_deg in product((0.5, 0.8, 1.5), (5.0, 35.0, 95.0)):
                image = edge_image(sigma, normal_deg, has_pixel=True, shape=shape) * lit(shape)
                edges = edges_of_image(EdgeImage(name="", image_dn=image))
                edge = max(edges, key=lambda e: e.length_px)
                assert edge.optical_sigma_px is not None
                assert edge.esfr_mtf50_cy_per_px is not None
                sigma_error = max(sigma_error, abs(edge.optical_sigma_px / sigma - 1))
                truth = pixel_mtf50(sigma, float(np.deg2rad(normal_deg)))
                mtf50_error = max(mtf50_error, abs(edge.esfr_mtf50_cy_per_px / truth - 1))
            name = f"{kind}, image of {width_px} px"
            record.say(f"  {name:36s} {100 * sigma_error:8.4f} {100 * mtf50_error:8.4f}")
            record.figure(f"sigma, {name}, worst", 100 * sigma_error, "%")
            record.figure(f"MTF50, {name}, worst", 100 * mtf50_error, "%")


def _squares_by_the_frame(record: Recorder) -> None:
    """Print what uneven light costs MTF50 where the frame cuts what lies beside an edge."""
    record.say(
        "\nsquares of 60 px near the frame, uneven light, no noise: largest error of MTF50 / %"
    )
    kinds: list[Callable[[tuple[int, int]], FloatArray]]
    kinds = [partial(_gradient, 0.15), partial(_gradient, 0.35), _vignetting]
    for sigma, margin_px in product((0.6, 1.5, 2.2), (16, 20, 26, 36)):
        side = 60 + 2 * margin_px
        cover = square_cover((side / 2 - 0.2, side / 2 - 0.7), 60.0, 7.0, sigma, (side, side))
        error = 0.0
        for lit, (ground, square) in product(kinds, ((40e3, 2e3), (2e3, 40e3))):
            image = (ground + (square - ground) * cover) * lit((side, side))
            for edge in edges_of_image(EdgeImage(name="", image_dn=image)):
                assert edge.esfr_mtf50_cy_per_px is not None
                truth = pixel_mtf50(sigma, edge.normal_rad)
                error = max(error, abs(edge.esfr_mtf50_cy_per_px / truth - 1))
        name = f"MTF50, uneven light, sigma {sigma:g}, {margin_px} px from the frame, worst"
        record.say(f"  {name:64s} {100 * error:8.4f}")
        record.figure(name, 100 * error, "%")


def _intervals_in_uneven_light(record: Recorder) -> None:
    """How often intervals hold where light falls off by a third over 512 px, in any direction."""
    rng = np.random.default_rng(2)
    record.say("\nlight that falls off, noise: 95 % intervals of MTF50 and of sigma that hold / %")
    for shape in ((60, 80), (70, 90), (110, 130)):
        y, x = np.mgrid[: shape[0], : shape[1]] - 0.5 * np.array(shape)[:, None, None]
        held = []
        for _ in range(record.pick(1000, 100)):
            normal_deg, bearing = float(rng.uniform(3, 40)), rng.uniform(0, 2 * np.pi)
            image = edge_image(
                0.95, normal_deg, has_pixel=True, shape=shape, low_dn=150.0, high_dn=2300.0
            )
            image *= 1 + 0.35 * (np.cos(bearing) * x + np.sin(bearing) * y) / 512
            image += np.sqrt(9 + image / 4) * rng.standard_normal(shape)
            edge = max(
                edges_of_image(EdgeImage(name="", image_dn=image)), key=lambda e: e.length_px
            )
            if edge.esfr_mtf50_err_cy_per_px is None or edge.optical_sigma_err_px is None:
                continue
            assert edge.esfr_mtf50_cy_per_px is not None
            assert edge.optical_sigma_px is not None
            truth = pixel_mtf50(0.95, float(np.deg2rad(normal_deg)))
            error = edge.esfr_mtf50_cy_per_px - truth
            held.append(
                (
                    abs(error) <= HELD * edge.esfr_mtf50_err_cy_per_px,
                    abs(edge.optical_sigma_px - 0.95) <= HELD * edge.optical_sigma_err_px,
                )
            )
        of_mtf50, of_sigma = 100 * np.mean(held, axis=0)
        name = f"image of {shape[0]} px"
        record.say(f"  {name:24s} {of_mtf50:7.1f} {of_sigma:7.1f}   {len(held)} edges")
        record.figure(f"95 % intervals of MTF50 that hold, uneven light, {name}", of_mtf50, "%")
        record.figure(f"95 % intervals of sigma that hold, uneven light, {name}", of_sigma, "%")


def _gradient(slope: float, shape: tuple[int, int]) -> FloatArray:
    return np.broadcast_to(1 + slope * np.linspace(-0.5, 0.5, shape[1]), shape)


def _vignetting(shape: tuple[int, int]) -> FloatArray:
    y, x = (np.linspace(-1, 1, count) for count in shape)
    return np.asarray(1 - 0.3 * (x[None, :] ** 2 + y[:, None] ** 2) / 2)


def _intervals(record: Recorder) -> None:
    """Scatter of MTF50 over random edges, and how often its 95 % interval holds the truth."""
    rng = np.random.default_rng(0)
    draws = record.pick(1000, 100)
    record.say(
        "\nMTF50 of edges of 100 px at random angles: RMS error / %, in the 95 % interval / %"
    )
    for sigma, snr in ((0.5, 30.0), (0.5, 12.0), (0.8, 100.0)):
        errors, held = [], 0
        for _ in range(draws):
            normal_deg, offset = float(rng.uniform(1, 44)), float(rng.uniform(-0.5, 0.5))
            image = edge_image(
                sigma, normal_deg, has_pixel=True, shape=(100, 100), offset_px=offset
            )
            image += rng.normal(size=image.shape) * 44_000 / snr
            edge = max(
                edges_of_image(EdgeImage(name="", image_dn=image)), key=lambda e: e.length_px
            )
            if edge.esfr_mtf50_cy_per_px is None or edge.esfr_mtf50_err_cy_per_px is None:
                continue
            error = edge.esfr_mtf50_cy_per_px - pixel_mtf50(sigma, float(np.deg2rad(normal_deg)))
            errors.append(error / pixel_mtf50(sigma, float(np.deg2rad(normal_deg))))
            held += abs(error) <= HELD * edge.esfr_mtf50_err_cy_per_px
        rms, coverage = 100 * float(np.sqrt(np.mean(np.square(errors)))), 100 * held / len(errors)
        case = f"sigma {sigma:g} px, SNR {snr:g}"
        record.say(f"  {case:24s} {rms:6.2f} {coverage:7.1f}   {len(errors)} of {draws}")
        record.figure(f"RMS error of MTF50, {case}", rms, "%")
        record.figure(f"95 % intervals of MTF50 that hold, {case}", coverage, "%")


def _compare_errors(
    record: Recorder, peers: dict[str, Callable[[FloatArray], float]], rng: np.random.Generator
) -> None:
    """Print the errors of MTF50 by kind of edge."""
    heading = f"{'|error of MTF50| / %: median (largest)':40s}"
    record.say("\n" + heading + "".join(f"{name:>22s}" for name in peers))
    for kind, edges in _cases().items():
        for noise_dn in (0.0, NOISE_DN):
            errors: dict[str, list[float]] = {name: [] for name in peers}
            for clean, truth in edges:
                for _ in range(record.pick(DRAWS, 1) if noise_dn else 1):
                    image = clean + rng.normal(size=clean.shape) * noise_dn
                    for name, measure in peers.items():
                        errors[name].append(100 * abs(measure(image) / truth - 1))
            label = f"{kind}, {'SNR 100' if noise_dn else 'no noise'}"
            cells = (f"{np.nanmedian(e):10.4f} ({np.nanmax(e):8.4f})" for e in errors.values())
            record.say(f"{label:40s}" + "".join(f"{cell:>22s}" for cell in cells))
            record.figure(
                f"median error of MTF50: {label}",
                float(np.nanmedian(errors["spline"])),
                "%",
                "ISO 12233 by bins",
                float(np.nanmedian(errors["bins"])),
            )


@benchmark("numpy", "scipy", "numba")
def main(record: Recorder) -> None:
    peers: dict[str, Callable[[FloatArray], float]] = {"spline": _by_spline, "bins": _by_bins}
    has_quick_mtf = find_spec("quickMTF") is not None
    if has_quick_mtf:
        peers["quickMTF"] = _by_quick_mtf
    else:
        record.say("quickMTF is not installed: pip install quickMTF to compare with it")
    rng = np.random.default_rng(1)
    _compare_errors(record, peers, rng)
    _every_angle(record)
    _shading(record)
    _squares_by_the_frame(record)
    _intervals_in_uneven_light(record)
    _intervals(record)
    clean = edge_image(0.8, 5.0, has_pixel=True)
    image = clean + rng.normal(size=clean.shape) * NOISE_DN
    samples, binned = samples_of(image)
    seconds = record.pick(1.0, 0.2)
    own_s = best_s(lambda: measure_esfr(binned), seconds, time.thread_time)
    record.say(f"\none edge, {samples.levels_dn.size} pixels / ms")
    record.say(f"  spline, samples at hand  {1e3 * own_s:8.2f}")
    peer_ms = None
    if has_quick_mtf:
        peer_ms = 1e3 * best_s(lambda: _by_quick_mtf(image), seconds, time.thread_time)
        record.say(f"  quickMTF, whole image    {peer_ms:8.2f}")
    record.figure(
        "e-SFR of one edge", 1e3 * own_s, "ms", None if peer_ms is None else "quickMTF", peer_ms
    )
