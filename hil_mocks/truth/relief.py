"""Things that stand on a plane: what a camera sees of them, and what they hide.

A thing is its outline, of one height, with walls. From a pupil at the distance D above the plane, a
point at the height z is seen where the plane's point ``p + (q - p) D / (D - z)`` would be, with q
the point and p the pupil, both projected onto the plane: a section at that height is the outline
drawn larger about the pupil. A wall is drawn as sections from the plane to the top, the lowest
first, and whatever is drawn later stands before what was drawn earlier.

Outlines are blurred by their signed distance, which is exact for straight borders; where an outline
is narrower than the sampling blur, and where it covers fine texture, what is seen errs by a part of
that blur.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, cos, hypot, radians, sin
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hil_mocks.truth.scenes import STEP_REACH, Coordinates, Reflectance, Scene, gaussian_step

Outline = Literal["plate", "coin", "leaf"]
"""A leaf is what two circles through both of its tips have in common."""

WALL_STEP_MM = 4.0
"""Height from one section of a wall to the next; sections are full, and overlap."""

WALL = 0.2
"""Reflectance of walls."""


def inside_outline(
    outline: Outline, about: tuple[Coordinates, Coordinates], half: tuple[float, float]
) -> NDArray[np.float64]:
    """How far places are within an outline; negative outside.

    ``about``: places from its middle, along its own axes. ``half``: its size, of which a coin has
    but the first.
    """
    u, v = np.abs(about[0]), np.abs(about[1])
    if outline == "plate":
        return np.asarray(np.minimum(half[0] - u, half[1] - v))
    if outline == "coin":
        return np.asarray(half[0] - np.sqrt(u * u + v * v))
    radius = (half[0] ** 2 + half[1] ** 2) / (2 * half[1])
    v = v + (radius - half[1])
    return np.asarray(radius - np.sqrt(u * u + v * v))


@dataclass(frozen=True, slots=True, kw_only=True)
class Thing:
    """A thing with a flat top.

    ``x_mm, y_mm``: its middle. ``half_x_mm, half_y_mm``: half the size, of which a coin has but the
    first. ``height_mm``: of the top. ``top``: what the top shows, about the thing's middle.
    """

    outline: Outline
    x_mm: float
    y_mm: float
    half_x_mm: float
    half_y_mm: float
    height_mm: float
    top: Scene
    angle_deg: float = 0.0

    def inside_mm(self, x_mm: Coordinates, y_mm: Coordinates) -> NDArray[np.float64]:
        """How far places are within the outline; negative outside."""
        about = self.about_middle(x_mm, y_mm)
        return inside_outline(self.outline, about, (self.half_x_mm, self.half_y_mm))

    def about_middle(
        self, x_mm: Coordinates, y_mm: Coordinates
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places from the thing's middle, along its own axes."""
        c, s = cos(radians(self.angle_deg)), sin(radians(self.angle_deg))
        x, y = x_mm - self.x_mm, y_mm - self.y_mm
        return np.asarray(c * x + s * y), np.asarray(c * y - s * x)

    @property
    def radius_mm(self) -> float:
        """Of a circle about its middle that holds it."""
        return self.half_x_mm if self.outline == "coin" else hypot(self.half_x_mm, self.half_y_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Relief:
    """Things on a flat ground; those that overlap from any pupil are drawn in their order."""

    ground: Scene
    things: tuple[Thing, ...]

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """See `Scene.reflectance`: from very far above."""
        return self.seen_from(0.0, 0.0, 1e9).reflectance(x_mm, y_mm, sigma_mm)

    def seen_from(self, x_mm: float, y_mm: float, distance_mm: float) -> "SeenRelief":
        """See `SceneWithRelief`; ValueError if the pupil is not above all things."""
        if not distance_mm > max((thing.height_mm for thing in self.things), default=0.0):
            raise ValueError(f"a pupil {distance_mm:g} mm above the plane is not above all things")
        return SeenRelief(relief=self, x_mm=x_mm, y_mm=y_mm, distance_mm=distance_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenRelief:
    """A relief from one pupil."""

    relief: Relief
    x_mm: float
    y_mm: float
    distance_mm: float

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """See `Scene.reflectance`."""
        total = np.array(self.relief.ground.reflectance(x_mm, y_mm, sigma_mm), dtype=np.float64)
        for thing, height_mm in self._sections():
            x, y, share = self._at_height(x_mm, y_mm, height_mm)
            reach_mm = thing.radius_mm + STEP_REACH * sigma_mm
            near = (np.abs(x - thing.x_mm) < reach_mm) & (np.abs(y - thing.y_mm) < reach_mm)
            if not near.any():
                continue
            covered = gaussian_step(thing.inside_mm(x[near], y[near]), sigma_mm * share)
            shown: Reflectance | float = WALL
            if height_mm == thing.height_mm:
                own = thing.about_middle(x[near], y[near])
                shown = thing.top.reflectance(*own, sigma_mm * share)
            total[near] = (1 - covered) * total[near] + covered * shown
        return total

    def height_mm(self, x_mm: Coordinates, y_mm: Coordinates) -> NDArray[np.float64]:
        """Height of what is seen where the plane's points are: 0 of the ground, NaN of a wall."""
        found = np.zeros(np.broadcast_shapes(x_mm.shape, y_mm.shape))
        for thing, height_mm in self._sections():
            x, y, _ = self._at_height(x_mm, y_mm, height_mm)
            found[thing.inside_mm(x, y) > 0] = height_mm if height_mm == thing.height_mm else np.nan
        return found

    def _sections(self) -> Iterator[tuple[Thing, float]]:
        """Each thing's sections by their heights, the lowest first; its last one is its top."""
        for thing in self.relief.things:
            count = ceil(thing.height_mm / WALL_STEP_MM)
            for number in range(count):
                yield thing, thing.height_mm * number / count
            yield thing, thing.height_mm

    def _at_height(
        self, x_mm: Coordinates, y_mm: Coordinates, height_mm: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Points at a height that are seen where the plane's are, and their scale over its."""
        share = 1 - height_mm / self.distance_mm
        x, y = np.broadcast_arrays(x_mm, y_mm)
        return self.x_mm + (x - self.x_mm) * share, self.y_mm + (y - self.y_mm) * share, share
