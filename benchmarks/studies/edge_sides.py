"""Sides of squares that are not found or not used, and widths of noise-free ones.

Squares of 100 px behind a Gaussian lens, at angles of 0 to 45 degrees, at any place within a pixel
and 18 to 60 px from the frame, where the frame cuts what lies beside the edge. Truth is a closed
form: along the pixels products of error functions and their integrals (``square_along_pixels``),
else their quadrature over the pixels (``truth.edges``).

    python -m benchmarks.studies.edge_sides [--sides 4000] [--seed 500] [--quick]
"""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy.special import ndtr

from benchmarks.harness import Recorder, benchmark
from benchmarks.studies.edge_places import is_hit
from benchmarks.truth.edges import Rectangle, patches
from calibration.edges import EdgeImage, EdgeMeasurement, EdgeSelection
from simulation.arrays import FloatArray

SIDE_PX = 100.0
DARK_DN, BRIGHT_DN, WHITE_DN = 8_000.0, 52_000.0, 65_535.0
SIGMAS_PX = np.arange(0.4, 3.001, 0.05)
ANGLES_DEG = (0.0, 0.5, 1.0, 5.0, 15.0, 26.565, 45.0)
SNRS = (math.inf, 500.0, 100.0)
MARGINS_PX = (18.0, 60.0)  # between a square and the frame


@dataclass
class SidesTally:
    """Sides that were looked for, those that were lost, and the worst error of a width."""

    sides: int = 0
    lost: list[str] = field(default_factory=list)
    worst: float = 0.0
    worst_name: str = ""

    def add(self, square: "Square", edges: list[EdgeMeasurement]) -> None:
        """Count the four sides of a square."""
        for side in square.rectangle.sides():
            self.sides += 1
            used = [e for e in edges if e.is_used and is_hit(e, side)]
            if not used:
                self.lost.append(square.name)
                continue
            best = max(used, key=lambda edge: edge.length_px)
            optical = best.optical_sigma_px or 0.0
            error = abs(optical / square.sigma_px - 1)
            if math.isinf(square.snr) and error > self.worst:
                self.worst, self.worst_name = error, square.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Square:
    """A square in a frame of its own; ``sigma_px`` is the lens's."""

    rectangle: Rectangle
    shape: tuple[int, int]
    sigma_px: float
    snr: float
    is_dark: bool

    @classmethod
    def drawn(
        cls, rng: np.random.Generator, sigma_px: float, angle_deg: float, snr: float
    ) -> "Square":
        """Place a square at random: within its pixel, in its frame, darker or brighter."""
        turn = math.radians(angle_deg + 90 * int(rng.integers(4)))
        half_px = 0.5 * SIDE_PX * (abs(math.cos(turn)) + abs(math.sin(turn)))
        left, top, right, bottom = rng.uniform(*MARGINS_PX, 4)
        rectangle = Rectangle(
            x_px=half_px + left,
            y_px=half_px + top,
            half_px=(SIDE_PX / 2, SIDE_PX / 2),
            angle_rad=turn,
            level_dn=BRIGHT_DN - DARK_DN,
        )
        shape = math.ceil(2 * half_px + top + bottom), math.ceil(2 * half_px + left + right)
        is_dark = bool(rng.integers(2))
        return cls(rectangle=rectangle, shape=shape, sigma_px=sigma_px, snr=snr, is_dark=is_dark)

    @property
    def name(self) -> str:
        """What it is, to draw it again."""
        one = self.rectangle
        return (
            f"sigma {self.sigma_px:.4f} px, {math.degrees(one.angle_rad):.3f} deg, SNR {self.snr:g}"
            f", at ({one.x_px:.3f}, {one.y_px:.3f}) in {self.shape}"
        )

    def image_dn(self, rng: np.random.Generator) -> FloatArray:
        """Render the square, with its noise."""
        turns = self.rectangle.angle_rad / (math.pi / 2)
        if abs(turns - round(turns)) < 1e-9:
            light = square_along_pixels(self.rectangle, self.shape, self.sigma_px)
        else:
            light = patches(self.shape, [self.rectangle], 0.0, self.sigma_px)
        image = BRIGHT_DN - light if self.is_dark else DARK_DN + light
        if math.isfinite(self.snr):
            image += rng.normal(0, (BRIGHT_DN - DARK_DN) / self.snr, image.shape)
        return image


def square_along_pixels(one: Rectangle, shape: tuple[int, int], sigma_px: float) -> FloatArray:
    """Pixel means of a rectangle at an angle of 0, or of a square along the pixels."""
    down, across = (
        _bar(np.arange(size, dtype=np.float64) - middle, half, sigma_px)
        for size, middle, half in zip(shape, (one.y_px, one.x_px), one.half_px[::-1], strict=True)
    )
    return np.asarray(one.level_dn * np.outer(down, across))


def _bar(away_px: FloatArray, half_px: float, sigma_px: float) -> FloatArray:
    """Means over unit pixels of a bar about 0, by the integral of Phi."""
    rises, falls = (
        _risen(away_px + end + 0.5, sigma_px) - _risen(away_px + end - 0.5, sigma_px)
        for end in (half_px, -half_px)
    )
    return rises - falls


def _risen(x: FloatArray, sigma_px: float) -> FloatArray:
    """Integral of Phi(x / sigma) up to x."""
    u = x / sigma_px
    density = np.exp(-0.5 * u * u) / math.sqrt(2 * math.pi)
    return np.asarray(x * ndtr(u) + sigma_px * density)


def measured(image_dn: FloatArray) -> list[EdgeMeasurement]:
    """Edges of a picture as ``calibrate`` measures them."""
    source = EdgeImage(name="square", image_dn=image_dn, saturation_dn=WHITE_DN)
    return EdgeSelection().measured_in(source, "all-angles")


def _study(record: Recorder, sides: int, seed: int) -> SidesTally:
    """Go through sigmas, angles and noises, as often as the number of sides takes."""
    rng = np.random.default_rng(seed)
    tally = SidesTally()
    while tally.sides < sides:
        for sigma_px in record.pick(SIGMAS_PX, SIGMAS_PX[::10]).tolist():
            for angle_deg in ANGLES_DEG:
                for snr in SNRS:
                    square = Square.drawn(rng, sigma_px, angle_deg, snr)
                    tally.add(square, measured(square.image_dn(rng)))
    return tally


@benchmark("numpy", "scipy", "numba")
def main(
    record: Recorder,
    *,
    sides: Annotated[int | None, "least number of sides, 4000 by default"] = None,
    seed: Annotated[int, "of all that is drawn"] = 500,
) -> None:
    tally = _study(record, sides or record.pick(4000, 40), seed)
    for name in tally.lost:
        record.say(f"  lost: {name}")
    record.say(f"{len(tally.lost)} of {tally.sides} sides lost")
    record.say(f"without noise at worst {100 * tally.worst:.4f} % of sigma: {tally.worst_name}")
    record.figure("sides lost", len(tally.lost), f"of {tally.sides}")
    record.figure("worst error of sigma without noise", 100 * tally.worst, "%")
