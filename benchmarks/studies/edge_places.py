"""Edges in awkward places: at the frame's border, crossed, faint, short, clipped.

For each place 1,000 edges behind a Gaussian lens and square pixels, at random angles: how many are
found and used, and how far sigma and the e-SFR's MTF50 are from the truth in units of the standard
errors that are stated. A right error gives an RMS of 1 and holds the truth in 95 % of the 95 %
intervals; of 1,000 edges the RMS scatters by 0.022 and the share by 0.7 %.

The truth is a closed form (``truth.edges``), the noise white and the levels rounded to 12 bits.

    python -m benchmarks.studies.edge_places [--edges 1000] [--only border] [--quick]
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np

from benchmarks.harness import Recorder, benchmark
from benchmarks.scoring import Errors
from benchmarks.truth.edges import (
    Crossing,
    Rectangle,
    Side,
    gaussian_mtf50,
    patches,
    pixel_means,
)
from calibration.edges import EdgeImage, EdgeMeasurement, EdgeSelection
from simulation.arrays import FloatArray

SIGMAS_PX = (0.7, 1.5)
WHITE_DN = 4095.0
DARK_DN, BRIGHT_DN, SNR = 800.0, 3200.0, 100.0
LINES_DN = (300.0, 2000.0, 3900.0)
CROSSED_PX = 150
CLIPPED_SHARES = (0.0, 0.01, 0.05, 0.1, 0.2, 0.3)  # of the rise
MOST_ACROSS_PX, MOST_TURNED_DEG = 1.0, 3.0  # of a side that is one and the same


def is_hit(edge: EdgeMeasurement, side: Side) -> bool:
    """Whether a measured edge is a part of a side."""
    turned = (edge.normal_rad - side.normal_rad + math.pi / 2) % math.pi - math.pi / 2
    dx, dy = edge.x_px - side.x_px, edge.y_px - side.y_px
    c, s = math.cos(side.normal_rad), math.sin(side.normal_rad)
    return (
        abs(math.degrees(turned)) <= MOST_TURNED_DEG
        and abs(c * dx + s * dy) <= MOST_ACROSS_PX
        and abs(c * dy - s * dx) <= 0.5 * side.length_px
    )


@dataclass
class _Tally:
    """What came of the edges of one place."""

    sides: int = 0
    found: int = 0
    used: int = 0
    sigma: Errors = field(default_factory=Errors)
    mtf50: Errors = field(default_factory=Errors)
    flags: dict[str, int] = field(default_factory=dict)
    whole: int = 0

    def add(
        self, image_dn: FloatArray, truth: Sequence[Sequence[Side]], sigma_px: float
    ) -> "_Tally":
        """Measure one picture as ``calibrate`` does; ``truth`` are its sides, patch by patch."""
        source = EdgeImage(
            name="edges", image_dn=np.clip(np.rint(image_dn), 0, WHITE_DN), saturation_dn=WHITE_DN
        )
        edges = EdgeSelection().measured_in(source, "all-angles")
        for sides in truth:
            used = [self._add_side(side, edges, sigma_px) for side in sides]
            self.whole += all(used)
        return self

    def _add_side(self, side: Side, edges: Sequence[EdgeMeasurement], sigma_px: float) -> bool:
        self.sides += 1
        hits = [edge for edge in edges if is_hit(edge, side)]
        best = max(hits, key=lambda e: (e.is_used, e.length_px), default=None)
        if best is None:
            return False
        self.found += 1
        for flag in best.flags:
            self.flags[flag] = self.flags.get(flag, 0) + 1
        optical, err = best.optical_sigma_px, best.optical_sigma_err_px
        if not best.is_used or optical is None or err is None:
            return False
        self.used += 1
        self.sigma.add(optical, err, sigma_px)
        truth = gaussian_mtf50(sigma_px, side.normal_rad)
        self.mtf50.add(best.esfr_mtf50_cy_per_px, best.esfr_mtf50_err_cy_per_px, truth)
        return True

    def write(self, record: Recorder, name: str, sigma_px: float) -> None:
        """A line of the table, and its figures."""
        used = 100 * self.used / self.sides
        record.figure(f"used, {name}, sigma {sigma_px}", used, "%")
        line = f"  {name:34}{sigma_px:4.1f}{self.sides:6d}{100 * self.found / self.sides:7.1f}"
        line += f"{used:7.1f}"
        for kind, errors in (("sigma", self.sigma), ("MTF50", self.mtf50)):
            where = f"{name}, sigma {sigma_px}"
            record.figure(f"RMS of {kind}, {where}", errors.rms, "stated errors")
            record.figure(f"{kind} in its interval, {where}", errors.coverage, "%")
            line += f"{errors.rms:8.3f}{errors.coverage:6.1f}{errors.most:6.1f}"
        relative = self.sigma.relative
        median = 100 * float(np.median(np.abs(relative))) if relative else math.nan
        line += f"{100 * len(self.mtf50.scaled) / max(self.used, 1):7.1f}{median:7.2f}  "
        line += ", ".join(f"{flag} {n}" for flag, n in sorted(self.flags.items()))
        record.say(line)


HEADER = (
    "  place                            sigma sides  found   used   sigma:rms  95 %  most"
    " MTF50:rms 95 % most  given median %"
)


def _beside_border(rng: np.random.Generator, sigma_px: float, edges: int) -> tuple[_Tally, _Tally]:
    """A row of patches 2 to 6 px from both long borders: sides along these, and that end there."""
    along, ending = _Tally(), _Tally()
    while along.sides < edges:
        rectangles = [_bordered(rng, 75 + 130 * k) for k in range(20)]
        image = patches((90, 130 * 20), rectangles, DARK_DN, sigma_px)
        image += rng.normal(0, (BRIGHT_DN - DARK_DN) / SNR, image.shape)
        sides = [one.sides() for one in rectangles]
        along.add(image, [four[2:] for four in sides], sigma_px)
        ending.add(image, [four[:2] for four in sides], sigma_px)
    return along, ending


def _bordered(rng: np.random.Generator, x_px: float) -> Rectangle:
    """A patch 90 px wide whose long sides lie 2 to 6 px from rows -0.5 and 89.5."""
    near, far = rng.uniform(2, 6, 2)
    room = min(near - 2, 6 - near, far - 2, 6 - far)
    turn = rng.uniform(-1, 1) * room / 45
    return Rectangle(
        x_px=x_px + rng.uniform(-3, 3),
        y_px=44.5 + 0.5 * (near - far),
        half_px=(45, 45 - 0.5 * (near + far)),
        angle_rad=turn,
        level_dn=BRIGHT_DN,
    )


def _into_border(rng: np.random.Generator, sigma_px: float, edges: int) -> _Tally:
    """Bars that run out of the picture at both ends, at angles of 60 to 120 degrees."""
    tally = _Tally()
    while tally.sides < edges:
        bars = [
            Rectangle(
                x_px=70 + 140 * k + rng.uniform(-3, 3),
                y_px=40.0,
                half_px=(25, 200),
                angle_rad=math.radians(rng.uniform(-30, 30)),
                level_dn=BRIGHT_DN,
            )
            for k in range(20)
        ]
        image = patches((80, 140 * 20), bars, DARK_DN, sigma_px)
        image += rng.normal(0, (BRIGHT_DN - DARK_DN) / SNR, image.shape)
        tally.add(image, [bar.sides()[:2] for bar in bars], sigma_px)
    return tally


def _crossed(rng: np.random.Generator, sigma_px: float, edges: int, *, has_line: bool) -> _Tally:
    """Edges that are crossed, one crossing a picture."""
    tally = _Tally()
    y, x = np.mgrid[:CROSSED_PX, :CROSSED_PX].astype(np.float64)
    while tally.sides < edges:
        x_px, y_px = CROSSED_PX / 2 + rng.uniform(-5, 5, 2)
        crossing = Crossing(
            x_px=x_px,
            y_px=y_px,
            normal_rad=rng.uniform(0, 2 * math.pi),
            between_rad=math.radians(rng.uniform(30, 90)),
            reach_px=CROSSED_PX / 2,
            levels_dn=(DARK_DN, BRIGHT_DN),
            half_line_px=rng.uniform(1, 2),
            line_dn=float(rng.choice(LINES_DN)) if has_line else None,
            sigma_px=sigma_px,
        )
        image = pixel_means(crossing.level, x, y)
        image += rng.normal(0, (BRIGHT_DN - DARK_DN) / SNR, image.shape)
        tally.add(image, [crossing.sides()], sigma_px)
    return tally


@dataclass(frozen=True, slots=True, kw_only=True)
class _Chart:
    """Squares on a ground, each of a level of its own."""

    side_px: float
    ground_dn: float
    levels_dn: tuple[float, float]
    noise_dn: float

    @classmethod
    def even(cls, side_px: float, dark_dn: float, bright_dn: float, snr: float) -> "_Chart":
        """All squares of one level."""
        noise_dn = (bright_dn - dark_dn) / snr
        levels = bright_dn, bright_dn
        return cls(side_px=side_px, ground_dn=dark_dn, levels_dn=levels, noise_dn=noise_dn)


def _squares(rng: np.random.Generator, sigma_px: float, chart: _Chart, count: int) -> _Tally:
    """Squares at random angles and places, a hundred a picture."""
    tally, pitch = _Tally(), 2 * chart.side_px + 10
    for left in range(count, 0, -100):
        rectangles = [
            Rectangle(
                x_px=pitch * (k % 10 + 0.5) + rng.uniform(-2, 2),
                y_px=pitch * (k // 10 + 0.5) + rng.uniform(-2, 2),
                half_px=(chart.side_px / 2, chart.side_px / 2),
                angle_rad=rng.uniform(0, math.pi / 2),
                level_dn=rng.uniform(*chart.levels_dn),
            )
            for k in range(min(left, 100))
        ]
        size = math.ceil(10 * pitch)
        image = patches((size, size), rectangles, chart.ground_dn, sigma_px)
        image += rng.normal(0, chart.noise_dn, image.shape)
        tally.add(image, [one.sides() for one in rectangles], sigma_px)
    return tally


def _border(record: Recorder, edges: int) -> None:
    for sigma_px in SIGMAS_PX:
        along, ending = _beside_border(np.random.default_rng(1), sigma_px, edges)
        along.write(record, "2 to 6 px beside the border", sigma_px)
        ending.write(record, "ending 2 to 6 px before the border", sigma_px)
        into = _into_border(np.random.default_rng(2), sigma_px, edges)
        into.write(record, "running into the border", sigma_px)


def _crossings(record: Recorder, edges: int) -> None:
    for sigma_px in SIGMAS_PX:
        for name, has_line in (("crossed by a line of 2 to 4 px", True), ("of a board", False)):
            tally = _crossed(np.random.default_rng(3), sigma_px, edges, has_line=has_line)
            tally.write(record, name, sigma_px)


def _faint(record: Recorder, edges: int) -> None:
    chart = _Chart.even(80.0, 1600.0, 2000.0, snr=30.0)
    for sigma_px in SIGMAS_PX:
        tally = _squares(np.random.default_rng(4), sigma_px, chart, edges // 4)
        tally.write(record, "contrast 5:4 at SNR 30, 80 px", sigma_px)


def _short(record: Recorder, edges: int) -> None:
    count = edges // 4
    for side_px in (22.0, 25.0, 30.0):
        chart = _Chart.even(side_px, DARK_DN, BRIGHT_DN, SNR)
        for sigma_px in SIGMAS_PX:
            name = f"squares of {side_px:g} px"
            tally = _squares(np.random.default_rng(5), sigma_px, chart, count)
            tally.write(record, name, sigma_px)
            whole = 100 * tally.whole / count
            record.say(f"    all four sides measured: {whole:.1f} % of {count} squares")
            record.figure(f"all four sides, {name}, sigma {sigma_px}", whole, "%")


def _clipped(record: Recorder, edges: int) -> None:
    ground_dn = 400.0
    rise_dn = WHITE_DN - ground_dn
    for least, most in pairwise(CLIPPED_SHARES):
        chart = _Chart(
            side_px=80.0,
            ground_dn=ground_dn,
            levels_dn=(ground_dn + rise_dn / (1 - least), ground_dn + rise_dn / (1 - most)),
            noise_dn=rise_dn / SNR,
        )
        for sigma_px in SIGMAS_PX:
            tally = _squares(np.random.default_rng(6), sigma_px, chart, edges // 4)
            name = f"{100 * least:g} to {100 * most:g} % of the rise clipped"
            tally.write(record, name, sigma_px)


Place = Literal["border", "crossing", "faint", "short", "clipped"]
PLACES: dict[Place, Callable[[Recorder, int], None]] = {
    "border": _border,
    "crossing": _crossings,
    "faint": _faint,
    "short": _short,
    "clipped": _clipped,
}


@benchmark("numpy", "scipy", "numba")
def main(
    record: Recorder,
    *,
    edges: Annotated[int | None, "edges of each place, 1000 by default"] = None,
    only: Annotated[Place | None, "one of the places"] = None,
) -> None:
    edges = edges or record.pick(1000, 40)
    record.say(HEADER)
    for name, measure in PLACES.items():
        if only in (None, name):
            measure(record, edges)
