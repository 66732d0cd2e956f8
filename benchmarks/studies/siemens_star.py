"""Siemens stars in the frame against closed forms: found or not, MTF50 and MTF20, and nulls.

Sinusoidal and square stars of several periods at any place, behind round and elliptic Gaussians of
several widths, in noise, alone or beside edges that say what contrast 1 is; and pictures without a
star. The seed is one that nothing was tuned on. ``bound`` is that of Cramer and Rao for the smooth
curve through all rings, whose covariance the stated error is: no estimate that knows no more of the
lens than that its curve is smooth has a smaller error.
"""

from importlib.resources import files
from math import cos, pi, sin

import numpy as np
from PIL import Image
from scipy.optimize import brentq

from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.focus_scenes import FocusedLens, chart
from benchmarks.truth.siemens_stars import Star
from calibration.edges import EdgeImage, EdgeSelection
from calibration.estimate import NORMAL_95
from calibration.lens import StarFigures, star_figures
from calibration.sharpness import find_star
from simulation.arrays import FloatArray

SHAPE = (520, 640)
SNRS = (200.0, 50.0, 20.0)
"""Largest difference of the star over the noise."""
LEVELS = (("mtf50", 0.5), ("mtf20", 0.2), ("mtf10", 0.1))
COLUMN_PX, SQUARES, HALF_PX, TURN_DEG = 130, 4, 32.0, 6.0
PICTURES = (
    "cell.png", "chelsea.png", "coins.png", "grass.png", "gravel.png", "hubble_deep_field.jpg",
    "ihc.png", "moon.png", "retina.jpg", "camera.png", "brick.png", "text.png", "page.png",
    "astronaut.png", "rocket.jpg", "motorcycle_left.png",
)  # fmt: skip


def true_frequency(level: float, sigma_px: float, stretch: float) -> float:
    """Where the mean over all directions falls to a level."""
    turns = np.linspace(0, pi, 180, endpoint=False)

    def above(freq: float) -> float:
        waves = [
            np.exp(-2 * (pi * sigma_px * freq) ** 2 * ((stretch * sin(t)) ** 2 + cos(t) ** 2))
            * np.sinc(freq * sin(t)) * np.sinc(freq * cos(t))
            for t in turns.tolist()
        ]  # fmt: skip
        return float(np.mean(waves)) - level

    return float(brentq(above, 0.01, 0.95))


def edges_beside(image: FloatArray, sigma_px: float) -> FloatArray:
    """The star's photograph with a column of squares to its right, behind the same lens."""
    rows, cols = image.shape
    lens = FocusedLens(
        width_px=cols + COLUMN_PX, height_px=rows, best_mm=0.0, sigma_px=sigma_px,
        blur_px_per_mm=0.0, tangential_mm=0.0, sagittal_mm=0.0, tilt_x_mm=0.0, tilt_y_mm=0.0,
    )  # fmt: skip
    middles = [(cols + 0.5 * COLUMN_PX, (n + 0.5) * rows / SQUARES) for n in range(SQUARES)]
    both = chart(lens, middles, HALF_PX, TURN_DEG, 0.0)
    both[:, :cols] = image
    return both


def measured(image: FloatArray) -> StarFigures | None:
    """Measure a star and the edges beside it, if there are any."""
    edges = EdgeSelection().measured_in(EdgeImage(name="star", image_dn=image), "all-angles")
    return star_figures("star", image, [edge for edge in edges if edge.is_used])


def _of_stars(record: Recorder, snr: float, rng: np.random.Generator, draws: int) -> list[bool]:
    """Whether each interval holds the truth."""
    off: dict[str, list[float]] = {}
    covered: dict[str, list[bool]] = {}
    alone: dict[str, list[tuple[float, float]]] = {}
    found = 0
    for number in range(draws):
        star = Star(
            x_px=float(rng.uniform(250, 390)),
            y_px=float(rng.uniform(240, 280)),
            cycles=int(rng.choice([36, 48, 72, 144])),
            radius_px=float(rng.uniform(200, 235)),
            is_square=bool(rng.integers(2)),
        )
        sigma, stretch = float(rng.uniform(0.5, 1.2)), float(rng.choice([1.0, 1.2]))
        image, how = star.photograph(SHAPE, sigma, stretch), "alone"
        if number % 2 and stretch == 1.0:
            image, how = edges_beside(image, sigma), "beside edges"
        noise = 2 * star.mean_dn * star.modulation / snr
        noisy = image + rng.normal(0, noise, image.shape)
        figures = star_figures("star", noisy, []) if how == "alone" else measured(noisy)
        if figures is None or figures.cycles != star.cycles:
            continue
        found += 1
        for name, level in LEVELS:
            known = getattr(figures.figures, f"{name}_cy_per_px")
            truth = true_frequency(level, sigma, stretch)
            if known is not None:
                off.setdefault(f"{name}, {how}", []).append(100 * (known.value / truth - 1))
                inside = bool(abs(known.value - truth) <= NORMAL_95 * known.err)
                covered.setdefault(how, []).append(inside)
                if how == "alone" and name == "mtf50":
                    part = "144 cycles" if star.cycles == 144 else "36 to 72 cycles"
                    off_and_bound = 100 * (known.value / truth - 1), 100 * known.err / truth
                    alone.setdefault(part, []).append(off_and_bound)
    record.say(f"SNR {snr:g}: {found} of {draws} found")
    for name, values in off.items():
        record.say(
            f"  {name}: off by {np.median(np.abs(values)):.2f} % in the median, "
            f"{np.max(np.abs(values)):.2f} % at most, {len(values)} stars"
        )
        record.figure(f"{name}, SNR {snr:g}, largest error", max(map(abs, values)), "%")
    for part, pairs in sorted(alone.items()):
        away, bound = np.abs(np.array(pairs)).T
        record.say(
            f"  mtf50, alone, {part}, {len(pairs)} stars: off by {away.max():.2f} % at most, bound "
            f"(one sigma) {np.median(bound):.2f} % in the median, {bound.max():.2f} % at most"
        )
    for how, held in covered.items():
        record.say(f"  {how}: {sum(held)} of {len(held)} intervals cover")
    record.figure(f"stars found, SNR {snr:g}", 100 * found / draws, "%")
    return [one for inside in covered.values() for one in inside]


@benchmark("numpy", "scipy", note="stars of 36 to 144 cycles, sigma 0.5 to 1.2 px")
def main(record: Recorder) -> None:
    """Compare with closed forms."""
    rng = np.random.default_rng(50193)
    draws = record.pick(20, 2)
    covered = [one for snr in SNRS for one in _of_stars(record, snr, rng, draws)]
    record.figure("intervals that cover, all", 100 * float(np.mean(covered)), "%")
    wrong = 0
    for name in PICTURES:
        with (files("skimage") / "data" / name).open("rb") as stream, Image.open(stream) as opened:
            wrong += find_star(np.asarray(opened.convert("L"), dtype=np.float64)) is not None
    record.figure(f"stars in {len(PICTURES)} pictures without one", wrong, "")
