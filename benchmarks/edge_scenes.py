"""Scenes of straight edges in closed form, behind a Gaussian lens and square pixels.

A rectangle behind a Gaussian is a product of error functions along its sides, a wedge between two
lines a bivariate normal probability; pixels average them by Gauss-Legendre quadrature.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from simulation.arrays import FloatArray

NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)  # a pixel's mean to 1e-6 at sigma 0.5
ANGLE_NODES, ANGLE_WEIGHTS = np.polynomial.legendre.leggauss(16)
TAIL_SIGMAS = 7.0

Scene = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """A straight edge that is there: its middle, the angle of its normal and its length."""

    x_px: float
    y_px: float
    normal_rad: float
    length_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Rectangle:
    """A patch of one level: its middle, half its sides and the angle of the first."""

    x_px: float
    y_px: float
    half_px: tuple[float, float]
    angle_rad: float
    level_dn: float

    def share(self, sigma_px: float, x: FloatArray, y: FloatArray) -> FloatArray:
        """Light of a patch of level 1, behind the Gaussian."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        dx, dy = x - self.x_px, y - self.y_px
        light = np.ones_like(x)
        for away, half in ((c * dx + s * dy, self.half_px[0]), (c * dy - s * dx, self.half_px[1])):
            light *= ndtr((away + half) / sigma_px) - ndtr((away - half) / sigma_px)
        return light

    def sides(self) -> list[Side]:
        """Right and left, below and above where the angle is 0."""
        found = []
        for first, turn in ((0, 0.0), (0, math.pi), (1, math.pi / 2), (1, -math.pi / 2)):
            normal = self.angle_rad + turn
            found.append(
                Side(
                    x_px=self.x_px + self.half_px[first] * math.cos(normal),
                    y_px=self.y_px + self.half_px[first] * math.sin(normal),
                    normal_rad=normal,
                    length_px=2 * self.half_px[1 - first],
                )
            )
        return found


def pixel_means(scene: Scene, x: FloatArray, y: FloatArray) -> FloatArray:
    """Means of a scene over the unit squares about points."""
    total = np.zeros_like(x)
    for dx, wx in zip(NODES / 2, WEIGHTS / 2, strict=True):
        for dy, wy in zip(NODES / 2, WEIGHTS / 2, strict=True):
            total += wx * wy * scene(x + dx, y + dy)
    return total


def both(first: FloatArray, second: FloatArray, between_rad: float) -> FloatArray:
    """Light of a wedge: probability that two normals with a correlation are below two bounds.

    Drezner and Wesolowsky, On the computation of the bivariate normal integral, 1990, eq. 3.
    """
    light = ndtr(first) * ndtr(second)
    near = (np.abs(first) < TAIL_SIGMAS) & (np.abs(second) < TAIL_SIGMAS)
    h, k = first[near], second[near]
    reach = 0.5 * (math.pi / 2 - between_rad)  # half the arc sine of the correlation
    for node, weight in zip(ANGLE_NODES, ANGLE_WEIGHTS, strict=True):
        sine = math.sin(reach * (1 + node))
        exponent = (h * h + k * k - 2 * h * k * sine) / (2 * (1 - sine * sine))
        light[near] += reach * weight * np.exp(-exponent) / (2 * math.pi)
    return light


def patches(
    shape: tuple[int, int], rectangles: Sequence[Rectangle], ground_dn: float, sigma_px: float
) -> FloatArray:
    """Patches that do not meet, on a ground."""
    image = np.full(shape, ground_dn)
    for one in rectangles:
        c, s = abs(math.cos(one.angle_rad)), abs(math.sin(one.angle_rad))
        width, height = one.half_px
        reach_x = c * width + s * height + TAIL_SIGMAS * sigma_px + 1
        reach_y = s * width + c * height + TAIL_SIGMAS * sigma_px + 1
        left, right = max(int(one.x_px - reach_x), 0), min(int(one.x_px + reach_x) + 2, shape[1])
        top, bottom = max(int(one.y_px - reach_y), 0), min(int(one.y_px + reach_y) + 2, shape[0])
        y, x = np.mgrid[top:bottom, left:right].astype(np.float64)
        light = pixel_means(partial(one.share, sigma_px), x, y)
        image[top:bottom, left:right] += (one.level_dn - ground_dn) * light
    return image


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """An edge that a line crosses, or as on a chessboard another edge where there is no line.

    Either half is ``reach_px`` long, from the crossing on.
    """

    x_px: float
    y_px: float
    normal_rad: float
    between_rad: float
    reach_px: float
    levels_dn: tuple[float, float]
    half_line_px: float
    line_dn: float | None
    sigma_px: float

    def level(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Light at points, behind the Gaussian, in DN."""
        between, dark_dn = self.between_rad, self.levels_dn[0]
        contrast = self.levels_dn[1] - dark_dn
        first = self._across(x, y, self.normal_rad)
        second = self._across(x, y, self.normal_rad + between)
        if self.line_dn is None:
            light = ndtr(first) + ndtr(second) - 2 * both(first, second, between)
            return np.asarray(dark_dn + contrast * light)
        above, below = (second + sign * self.half_line_px / self.sigma_px for sign in (1, -1))
        line = ndtr(above) - ndtr(below)
        light = ndtr(first) - both(first, above, between) + both(first, below, between)
        return np.asarray(dark_dn * (1 - line) + contrast * light + self.line_dn * line)

    def sides(self) -> list[Side]:
        """Either half of the edge, and of the other one."""
        sides = self._halves(self.normal_rad)
        if self.line_dn is None:
            sides += self._halves(self.normal_rad + self.between_rad)
        return sides

    def _across(self, x: FloatArray, y: FloatArray, normal_rad: float) -> FloatArray:
        away = math.cos(normal_rad) * (x - self.x_px) + math.sin(normal_rad) * (y - self.y_px)
        return away / self.sigma_px

    def _halves(self, normal_rad: float) -> list[Side]:
        return [
            Side(
                x_px=self.x_px - along * math.sin(normal_rad),
                y_px=self.y_px + along * math.cos(normal_rad),
                normal_rad=normal_rad,
                length_px=self.reach_px,
            )
            for along in (-0.5 * self.reach_px, 0.5 * self.reach_px)
        ]


def gaussian_mtf50(sigma_px: float, normal_rad: float) -> float:
    """Frequency across an edge at which the Gaussian and the pixel leave half the contrast."""
    c, s = math.cos(normal_rad), math.sin(normal_rad)

    def above_half(freq: float) -> float:
        lens = math.exp(-2 * (math.pi * sigma_px * freq) ** 2)
        return float(lens * np.sinc(freq * c) * np.sinc(freq * s) - 0.5)

    return float(brentq(above_half, 1e-6, 1.0))
