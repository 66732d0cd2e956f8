"""The measured two-dimensional transfer function: its error, its 95 % band, its time.

Truth: straight edges of 200 px through a lens known in closed form, behind square pixels, from a
sine series of their own (tests/calibration/lens_edges.py), noise added. The peer is what the edges
gave before: the Gaussian with its pixel, and the mean of the edges' own curves (e-SFR).
"""

import time
from functools import partial

import numpy as np

from benchmarks.harness import Recorder, benchmark, best_s
from calibration.edges import BinnedEdge, EdgeImage, EdgeMeasurement, edges_of_image
from calibration.psf import measure_transfer_2d, psf_of_images
from simulation.arrays import FloatArray
from tests.calibration.lens_edges import (
    HIGH_DN,
    LOW_DN,
    AstigmaticLens,
    Lens,
    edge_photograph,
    edge_photographs,
)

PX_PER_F_NUMBER = 0.55 / 8.3  # 550 nm on pixels of 8.3 um
EIGHT_DEG = tuple(5.0 + 22.5 * k for k in range(8))
TWELVE_DEG = tuple(4.0 + 15.0 * k for k in range(12))
ROUND_LENSES = {
    "f/1.4": (1.4, 0.0),
    "f/2.8": (2.8, 0.0),
    "f/5.6": (5.6, 0.0),
    "f/8": (8.0, 0.0),
    "f/11": (11.0, 0.0),
    "f/2.8 + 1 wave": (2.8, 1.0),
    "f/5.6 + 1/2 wave": (5.6, 0.5),
}
ASTIGMATIC = {
    "ellipse": Lens(0.55, 0.35, turn_deg=30.0),
    "ellipse + .3 wave + Gaussian": Lens(0.55, 0.3, turn_deg=30.0, waves=0.3, sigma_px=0.3),
}
CHARTS_DEG = {"at 5": (5.0, 95.0, 185.0, 275.0), "at 5 and -5": (5.0, 95.0, 175.0, 265.0)}
UPRIGHT = {
    "cut-off": Lens(0.8, 0.4),
    "defocus .8 and .4 waves": AstigmaticLens(0.27, 0.27, x_waves=0.8, y_waves=0.4),
    "defocus .8 and -.4 waves": AstigmaticLens(0.27, 0.27, x_waves=0.8, y_waves=-0.4),
    "round": Lens(0.37, 0.37),
}
BAND_FREQ = np.array([0.125, 0.25, 0.4])  # 0.25, 0.5 and 0.8 of Nyquist


def _round_lens(name: str) -> Lens:
    f_number, waves = ROUND_LENSES[name]
    period = f_number * PX_PER_F_NUMBER
    return Lens(period, period, waves=waves)


def _directions(freq: FloatArray, step_deg: float) -> tuple[FloatArray, FloatArray]:
    angle = np.deg2rad(np.arange(0.0, 180.0, step_deg))[:, None]
    return freq * np.cos(angle), freq * np.sin(angle)


def _measured(lens: Lens, normals_deg: tuple[float, ...], snr: float) -> list[EdgeMeasurement]:
    sources = edge_photographs(lens, normals_deg, snr, seed=3)
    return [edge for source in sources for edge in edges_of_image(source)]


def _bins_of(edges: list[EdgeMeasurement]) -> list[BinnedEdge]:
    return [edge.binned for edge in edges if edge.binned is not None]


def _gaussian_otf(edges: list[EdgeMeasurement], fx: FloatArray, fy: FloatArray) -> FloatArray:
    """A round Gaussian of the edges' mean optical width, with its pixel."""
    variance = np.mean([(edge.optical_sigma_px or 0.0) ** 2 for edge in edges])
    gauss = np.exp(-2 * np.pi**2 * variance * (fx**2 + fy**2))
    return np.asarray(gauss * np.sinc(fx) * np.sinc(fy))


def _errors(record: Recorder) -> None:
    fx, fy = _directions(np.linspace(0.0, 0.5, 26), 10.0)
    for snr in (500.0, 100.0, 30.0):
        record.say(f"\n8 edges of 200 px at SNR {snr:g}: largest error up to Nyquist")
        for name in ROUND_LENSES:
            lens = _round_lens(name)
            edges = _measured(lens, EIGHT_DEG, snr)
            found = measure_transfer_2d(_bins_of(edges))
            assert found is not None
            truth = lens.otf(fx, fy)
            error = float(np.abs(found.otf(fx, fy) - truth).max())
            peer = float(np.abs(_gaussian_otf(edges, fx, fy) - truth).max())
            record.say(f"  {name:18} {found.form:9} {error:.5f}   Gaussian and pixel {peer:.5f}")
            record.figure(f"error at SNR {snr:g}, {name}", error, "1", "Gaussian", peer)


def _bias(record: Recorder, draws: int) -> None:
    lens = _round_lens("f/5.6")
    at = np.array([0.7])
    record.say(f"\nmean error at 0.7 cy/px, f/5.6, 8 edges, {draws} draws")
    for snr in (100.0, 30.0):
        fitted, smoothed = [], []
        for seed in range(draws):
            sources = edge_photographs(lens, EIGHT_DEG, snr, seed)
            edges = [edge for source in sources for edge in edges_of_image(source)]
            found = measure_transfer_2d(_bins_of(edges))
            assert found is not None
            normal = np.array([edge.normal_rad for edge in edges])
            truth = lens.otf(at * np.cos(normal), at * np.sin(normal))
            fitted.append(np.mean(found.otf(at * np.cos(normal), at * np.sin(normal)) - truth))
            curves = [edge.esfr.transform(at).real[0] for edge in edges if edge.esfr is not None]
            smoothed.append(np.mean(curves) - np.mean(truth))
        ours, peer = abs(float(np.mean(fitted))), abs(float(np.mean(smoothed)))
        record.say(f"  SNR {snr:g}: {ours:.5f}, e-SFR {peer:.5f}")
        record.figure(f"bias at SNR {snr:g}", ours, "1", "e-SFR", peer)


def _coverage(record: Recorder, draws: int) -> None:
    fx, fy = _directions(BAND_FREQ, 15.0)
    contrast = HIGH_DN - LOW_DN
    for name, lens in ASTIGMATIC.items():
        truth = lens.otf(fx, fy)
        clean = [edge_photograph(lens, normal) for normal in TWELVE_DEG]
        inside, worst = [], 0.0
        for seed in range(draws):
            rng = np.random.default_rng(seed)
            edges = [
                edge
                for image in clean
                for edge in edges_of_image(
                    EdgeImage(
                        name="edge",
                        image_dn=image + rng.normal(size=image.shape) * contrast / 100,
                    )
                )
            ]
            found = measure_transfer_2d(_bins_of(edges))
            assert found is not None
            away = np.abs(found.otf(fx, fy) - truth)
            inside.append(away < 1.96 * found.otf_err(fx, fy))
            worst = max(worst, float(away.max()))
        share = np.mean(inside, axis=(0, 1))
        record.say(
            f"\n{name}, 12 edges of 200 px at SNR 100, {np.size(inside)} intervals: "
            f"{100 * np.mean(inside):.1f} % hold the truth "
            f"({', '.join(f'{100 * one:.1f}' for one in share)} at 0.25, 0.5, 0.8 Nyquist); "
            f"largest error {worst:.4f}"
        )
        record.figure(f"95 % band, {name}", float(100 * np.mean(inside)), "%")
        record.figure(f"largest error, {name}", worst, "1")


def _charts(record: Recorder, tilts: str, draws: int) -> None:
    """Edges near the vertical and the horizontal alone, as standard charts have them."""
    along, between = (_directions(BAND_FREQ, 90.0), _directions(BAND_FREQ, 15.0))
    record.say(f"\n4 edges of a chart {tilts} degrees, SNR 100, {draws} draws: largest error")
    shares = []
    for name, lens in UPRIGHT.items():
        inside, on_axes, anywhere, peers = [], 0.0, 0.0, 0.0
        for seed in range(draws):
            psf = psf_of_images(edge_photographs(lens, CHARTS_DEG[tilts], 100.0, seed))
            found, gaussian = psf.transfer_2d, psf.total_psf("psf.json")
            assert found is not None
            away = np.abs(found.otf(*along) - lens.otf(*along))
            inside.append(away < 1.96 * found.otf_err(*along))
            on_axes = max(on_axes, float(away.max()))
            every = np.abs(found.otf(*between) - lens.otf(*between))
            anywhere = max(anywhere, float(every.max()))
            peer = np.abs(gaussian.otf(*between) - lens.otf(*between))
            peers = max(peers, float(peer.max()))
        shares.append(np.mean(inside))
        record.say(
            f"  {name:26} {on_axes:.4f} along the axes, {anywhere:.4f} between them; Gaussian "
            f"{peers:.4f}; {100 * shares[-1]:.1f} % of {np.size(inside)} intervals hold the truth"
        )
        record.figure(f"error of a chart {tilts}, {name}", anywhere, "1", "Gaussian", peers)
    record.figure(f"95 % band of charts {tilts}", float(100 * np.mean(shares)), "%")


def _speed(record: Recorder) -> None:
    record.say("")
    for name, lens in (("f/5.6", _round_lens("f/5.6")), ("ellipse", ASTIGMATIC["ellipse"])):
        for count in (8, 50):
            normals = tuple(5.0 + 180.0 / count * k for k in range(count))
            started = time.perf_counter()
            edges = _bins_of(_measured(lens, normals, 300.0))
            whole = time.perf_counter() - started
            best = best_s(partial(measure_transfer_2d, edges))
            record.say(
                f"{name}, {len(edges)} edges: {1e3 * best:.0f} ms (rendered and measured one by "
                f"one in {1e3 * whole:.0f} ms)"
            )
            record.figure(f"fit of {len(edges)} edges, {name}", 1e3 * best, "ms")


@benchmark("numpy", "scipy")
def main(record: Recorder) -> None:
    _errors(record)
    _bias(record, record.pick(10, 3))
    _coverage(record, record.pick(60, 3))
    for tilts in CHARTS_DEG:
        _charts(record, tilts, record.pick(60, 3))
    _speed(record)
