"""Dead leaves in the frame against closed forms: texture's MTF, intervals, texture loss, nulls.

Targets of discs, printed as squares of their pixels and photographed in several sizes, places and
turns behind round and elliptic Gaussians, in noise, beside squares whose edges are measured.
Texture is said to be lost in photographs from which a bilateral filter takes the noise, and in no
other. Pictures without dead leaves, and dead leaves of another target, are not measured. The seed
is one that nothing was tuned on.
"""

from dataclasses import dataclass
from importlib.resources import files

import cv2
import numpy as np
from PIL import Image
from scipy.optimize import brentq

from benchmarks.harness import Recorder, benchmark
from benchmarks.studies.siemens_star import PICTURES, edges_beside
from benchmarks.truth.dead_leaves import Print, dead_leaves, photograph
from calibration.edges import EdgeImage, EdgeSelection
from calibration.estimate import NORMAL_95
from calibration.lens import TextureFigures, texture_figures
from calibration.sharpness import MeasuredValue, find_dead_leaves
from simulation.arrays import FloatArray

SEED = 19567
TARGET_PX, SHAPE = 900, (520, 540)
LEVEL_DN, RANGE = 3000.0, 0.6
SNRS = (200.0, 50.0, 20.0)
"""Largest difference of the leaves over the noise."""
LEVELS = (("mtf50", 0.5), ("mtf20", 0.2), ("mtf10", 0.1))
_TURNS = np.linspace(0, np.pi, 90, endpoint=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """A photograph of leaves beside edges, and the blur behind which it was taken."""

    image_dn: FloatArray
    target: FloatArray
    sigma_px: tuple[float, float]

    def transfer(self, freq: FloatArray) -> FloatArray:
        """Mean contrast over all directions, in closed form."""
        fx, fy = np.outer(freq, np.cos(_TURNS)), np.outer(freq, np.sin(_TURNS))
        wide, high = self.sigma_px
        lens = np.exp(-2 * np.pi**2 * ((wide * fx) ** 2 + (high * fy) ** 2))
        return np.asarray((lens * np.sinc(fx) * np.sinc(fy)).mean(axis=1))

    def frequency(self, level: float) -> float:
        """Where that contrast falls to a level."""
        found = brentq(lambda f: float(self.transfer(np.array([f]))[0]) - level, 0.01, 0.95)
        return float(found)

    def figures(self) -> TextureFigures | None:
        """Measure the leaves, and the edges if the lens is round."""
        used = []
        source = EdgeImage(name="leaves", image_dn=self.image_dn)
        if self.sigma_px[0] == self.sigma_px[1]:
            edges = EdgeSelection().measured_in(source, "all-angles")
            used = [edge for edge in edges if edge.is_used]
        return texture_figures(source, self.target, used)


def frame(rng: np.random.Generator, number: int, snr: float) -> Frame:
    """A photograph of another target in another pose behind another lens; every sixth is turned."""
    target = dead_leaves(rng, TARGET_PX, (3.0, 120.0))
    wide = float(rng.uniform(0.5, 1.1))
    sigma = (wide * float(rng.choice([0.85, 1.2])), wide) if number % 4 == 3 else (wide, wide)
    scale = float(rng.uniform(0.35, 0.5))
    start = rng.uniform(20, 510 - scale * TARGET_PX, 2)
    turn = float(rng.uniform(2, 20)) if number % 6 == 5 else 0.0
    if turn:
        scale, start = 0.36, np.array([150.0, 20.0])
    printed = Print(x_px=float(start[0]), y_px=float(start[1]), scale=scale, turn_deg=turn)
    image = LEVEL_DN * photograph(target, printed, SHAPE, sigma)
    if sigma[0] == sigma[1]:
        image = edges_beside(image, wide)
    image += rng.normal(0, LEVEL_DN * RANGE / snr, image.shape)
    return Frame(image_dn=image, target=target, sigma_px=sigma)


def _of_frames(record: Recorder, snr: float, draws: int) -> None:
    rng = np.random.default_rng([SEED, int(snr)])
    off: dict[str, list[float]] = {}
    curves: list[float] = []
    covered: list[bool] = []
    on_curve: list[bool] = []
    ratios: list[float] = []
    found = lost = 0
    for number in range(draws):
        seen = frame(rng, number, snr)
        figures = seen.figures()
        if figures is None:
            continue
        found += 1
        freq, mtf = np.array(figures.freq_cy_per_px), np.array(figures.intrinsic)
        away = mtf - seen.transfer(freq)
        curves.append(float(np.sqrt(np.mean(away**2))))
        err = np.hypot(figures.intrinsic_err, 2e-3)  # as for the figures
        on_curve += (np.abs(away) <= NORMAL_95 * err).tolist()
        for name, level in LEVELS:
            truth = seen.frequency(level)
            methods = (("", figures.figures), (", direct", figures.direct_figures))
            for method, of_method in methods:
                known: MeasuredValue | None = getattr(of_method, f"{name}_cy_per_px", None)
                if known is not None:
                    off.setdefault(name + method, []).append(100 * (known.value / truth - 1))
                    if not method:
                        inside = abs(known.value - truth) <= NORMAL_95 * known.err
                        covered.append(bool(inside))
        if figures.over_edges is not None:
            ratios.append(figures.over_edges.value)
            lost += figures.is_lost
    record.say(f"SNR {snr:g}: {found} of {draws} found")
    for name, values in off.items():
        record.say(
            f"  {name}: off by {np.median(np.abs(values)):.2f} % in the median, "
            f"{np.max(np.abs(values)):.2f} % at most, {len(values)} frames"
        )
        record.figure(f"{name}, SNR {snr:g}, largest error", max(map(abs, values)), "%")
    record.figure(f"curve, SNR {snr:g}, rms in the median", float(np.median(curves)), "")
    record.figure(f"curve, SNR {snr:g}, rms at most", max(curves), "")
    record.figure(
        f"intervals of figures that cover, SNR {snr:g}", 100 * float(np.mean(covered)), "%"
    )
    record.figure(
        f"intervals of the curve that cover, SNR {snr:g}", 100 * float(np.mean(on_curve)), "%"
    )
    record.say(f"  {len(covered)} intervals of figures, {len(on_curve)} of the curve")
    record.say(f"  texture over edges {min(ratios):.3f} to {max(ratios):.3f}; said to be lost in "
               f"{lost} of {len(ratios)}")  # fmt: skip
    record.figure(f"honest frames said to lose texture, SNR {snr:g}", lost, "")


def _of_filtered(record: Recorder, draws: int) -> None:
    """Frames from which a bilateral filter takes the noise."""
    rng = np.random.default_rng([SEED, 1])
    named, ratios, intrinsic_over_direct = 0, [], []
    for number in range(draws):
        snr = float(rng.choice([20.0, 30.0, 50.0]))
        seen = frame(rng, 4 * number, snr)
        strength = float(rng.uniform(3, 6)) * LEVEL_DN * RANGE / snr
        smooth = cv2.bilateralFilter(seen.image_dn.astype(np.float32), 7, strength, 2.0)
        filtered = Frame(
            image_dn=smooth.astype(np.float64), target=seen.target, sigma_px=seen.sigma_px
        )
        figures = filtered.figures()
        if figures is None or figures.over_edges is None:
            continue
        ratios.append(figures.over_edges.value)
        named += figures.is_lost
        both = (figures.figures, figures.direct_figures)
        half = [one and one.mtf50_cy_per_px for one in both]
        if half[0] and half[1]:
            intrinsic_over_direct.append(half[0].value / half[1].value)
    record.say(
        f"denoised: {named} of {len(ratios)} named, texture over edges {min(ratios):.3f} to "
        f"{max(ratios):.3f}; MTF50 intrinsic over direct {np.median(intrinsic_over_direct):.3f}"
    )
    record.figure("denoised frames named", 100 * named / len(ratios), "%")


def _of_others(record: Recorder, pictures: int, targets: int) -> None:
    """Pictures without dead leaves, and dead leaves of another target."""
    rng = np.random.default_rng([SEED, 2])
    target = dead_leaves(rng, TARGET_PX, (3.0, 120.0))
    wrong = 0
    for name in PICTURES[:pictures]:
        with (files("skimage") / "data" / name).open("rb") as stream, Image.open(stream) as opened:
            wrong += (
                find_dead_leaves(np.asarray(opened.convert("L"), np.float64), target) is not None
            )
    record.figure(f"found in {pictures} pictures without dead leaves", wrong, "")
    other = 0
    for number in range(targets):
        seen = frame(rng, 4 * number, 50.0)
        other += find_dead_leaves(seen.image_dn, target) is not None
    record.figure(f"found in {targets} photographs of another target", other, "")


@benchmark("numpy", "scipy", note="targets of 900 px, sigma 0.5 to 1.1 px")
def main(record: Recorder) -> None:
    """Compare with closed forms."""
    for snr in SNRS:
        _of_frames(record, snr, record.pick(48, 2))
    _of_filtered(record, record.pick(20, 2))
    _of_others(record, record.pick(len(PICTURES), 1), record.pick(8, 1))
