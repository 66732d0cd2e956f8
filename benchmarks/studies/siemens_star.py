"""Siemens stars in the frame against closed forms: found or not, MTF50 and MTF20, and nulls.

Sinusoidal and square stars of several periods at any place, behind round and elliptic Gaussians of
several widths, in noise; and pictures without a star.
"""

from importlib.resources import files
from math import cos, pi, sin

import numpy as np
from PIL import Image
from scipy.optimize import brentq

from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.siemens_stars import Star
from calibration.estimate import NORMAL_95
from calibration.lens import star_figures
from calibration.sharpness import find_star

SHAPE = (520, 640)
SNRS = (200.0, 50.0, 20.0)
"""Largest difference of the star over the noise."""
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


@benchmark("numpy", "scipy", note="stars of 36 to 144 cycles, sigma 0.5 to 1.2 px")
def main(record: Recorder) -> None:
    """Compare with closed forms."""
    rng = np.random.default_rng(12233)
    draws = record.pick(20, 2)
    for snr in SNRS:
        off: dict[str, list[float]] = {"mtf50": [], "mtf20": []}
        covered: list[bool] = []
        found = 0
        for _ in range(draws):
            star = Star(
                x_px=float(rng.uniform(250, 390)),
                y_px=float(rng.uniform(240, 280)),
                cycles=int(rng.choice([36, 48, 72, 144])),
                radius_px=float(rng.uniform(200, 235)),
                is_square=bool(rng.integers(2)),
            )
            sigma, stretch = float(rng.uniform(0.5, 1.2)), float(rng.choice([1.0, 1.2]))
            noise = 2 * star.mean_dn * star.modulation / snr
            image = star.photograph(SHAPE, sigma, stretch)
            figures = star_figures("star", image + rng.normal(0, noise, SHAPE), [])
            if figures is None or figures.cycles != star.cycles:
                continue
            found += 1
            for name, level in (("mtf50", 0.5), ("mtf20", 0.2)):
                known = getattr(figures.figures, f"{name}_cy_per_px")
                truth = true_frequency(level, sigma, stretch)
                if known is not None:
                    off[name].append(100 * (known.value / truth - 1))
                    covered.append(bool(abs(known.value - truth) <= NORMAL_95 * known.err))
        record.say(f"SNR {snr:g}: {found} of {draws} found")
        for name, values in off.items():
            record.say(
                f"  {name}: off by {np.median(np.abs(values)):.2f} % in the median, "
                f"{np.max(np.abs(values)):.2f} % at most, {len(values)} stars"
            )
            record.figure(
                f"{name} of stars, SNR {snr:g}, largest error", max(map(abs, values)), "%"
            )
        record.figure(f"stars found, SNR {snr:g}", 100 * found / draws, "%")
        record.figure(f"intervals that cover, SNR {snr:g}", 100 * float(np.mean(covered)), "%")
    wrong = 0
    for name in PICTURES:
        with (files("skimage") / "data" / name).open("rb") as stream, Image.open(stream) as opened:
            wrong += find_star(np.asarray(opened.convert("L"), dtype=np.float64)) is not None
    record.figure(f"stars in {len(PICTURES)} pictures without one", wrong, "")
