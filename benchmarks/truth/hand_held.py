"""A camera in a hand that sways, before a picture on a wall, and the hand that follows arrows.

The view is ray-cast here with scipy alone: nothing is shared with what follows the pose. Lengths
are in distances of the reference, angles in radians; the picture lies in the plane at 1 before the
origin, where the reference was taken with the axes of the world: x right, y down, z forward.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import acos, atan2, degrees, hypot, pi, radians

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

Image = NDArray[np.float64]
Vector = NDArray[np.float64]

WALL_DN = 150.0
EXPOSURE_S = 1 / 60
_SUBEXPOSURES = 4
_NOISE_DN = 2.0
_FINE_NOISE_DN = 1.0
_FINER = 4
_MARGIN = 1.1
"""Width of the picture over that of the field of view of the reference."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldPose:
    """Where a camera is: its centre, shape (3,), and its axes as columns, shape (3, 3)."""

    centre: Vector = field(default_factory=lambda: np.zeros(3))
    axes: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """Deviations from the reference's pose: of the distance and the aim in percent, and angles.

    ``aim_percent`` is of the longer side, from the middle of the frame to the reference's middle.
    """

    distance_percent: float
    aim_percent: float
    tilt_deg: float
    turn_deg: float

    def is_within(self, percent: float, aim_percent: float, deg: float) -> bool:
        """Whether all are within these limits."""
        return (
            self.distance_percent <= percent
            and self.aim_percent <= aim_percent
            and max(self.tilt_deg, self.turn_deg) <= deg
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Wall:
    """A picture on a wall, and a camera of ``(width, height)`` px and a focal length before it."""

    levels: Image = field(repr=False)
    size: tuple[int, int]
    focal_px: float

    @classmethod
    def of(cls, levels: Image, size: tuple[int, int], focal_per_side: float) -> "Wall":
        """Hang up grey levels of 0 to 255 so that they fill the reference's field of view."""
        return cls(levels=levels, size=size, focal_px=focal_per_side * max(size))

    def resized(self, size: tuple[int, int]) -> "Wall":
        """Return the wall before another sensor with the same field of view."""
        return replace(self, size=size, focal_px=self.focal_px * max(size) / max(self.size))

    def seen(self, poses: Sequence[HeldPose], rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return a frame, shape ``(rows, cols)``: the mean of what is seen from each pose."""
        mean = np.mean([self._view(pose) for pose in poses], axis=0)
        noisy = gaussian_filter(mean, 0.5) + _NOISE_DN * rng.standard_normal(mean.shape)
        return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)

    def through(
        self, pose: HeldPose, sigma_px: float, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        """Return a frame through a lens whose total PSF is a Gaussian of this width.

        It is blurred in light, on a grid four times as fine, and encoded as sRGB afterwards.
        """
        width, height = self.size
        fine = self.resized((_FINER * width, _FINER * height))
        seen = gaussian_filter(_light(fine._view(pose) / 255), _FINER * sigma_px)
        # A pixel's centre lies between the two middle samples along each axis.
        middle = slice(_FINER // 2 - 1, _FINER // 2 + 1)
        parts = seen.reshape(height, _FINER, width, _FINER)[:, middle, :, middle]
        encoded = 255 * _encoded(parts.mean(axis=(1, 3)))
        noisy = encoded + _FINE_NOISE_DN * rng.standard_normal(encoded.shape)
        return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)

    def errors(self, pose: HeldPose) -> PoseErrors:
        """Work out how far a pose is from the reference's."""
        axis = pose.axes[:, 2]
        across = pose.axes.T @ (np.array([0.0, 0.0, 1.0]) - pose.centre)
        aim = self.focal_px * hypot(across[0], across[1]) / across[2] / max(self.size)
        back = pose.axes.T
        return PoseErrors(
            distance_percent=100 * abs((1 - pose.centre[2]) / axis[2] - 1),
            aim_percent=100 * aim,
            tilt_deg=degrees(acos(min(axis[2], 1.0))),
            turn_deg=abs(degrees(atan2(back[1, 0], back[0, 0]))),
        )

    def _view(self, pose: HeldPose) -> Image:
        width, height = self.size
        x = (np.arange(width) - (width - 1) / 2) / self.focal_px
        y = (np.arange(height) - (height - 1) / 2) / self.focal_px
        rays = np.stack((*np.meshgrid(x, y), np.ones((height, width))))
        world = np.tensordot(pose.axes, rays, axes=1)
        reach = (1 - pose.centre[2]) / np.where(world[2] > 0.05, world[2], np.nan)
        at_x, at_y = pose.centre[0] + reach * world[0], pose.centre[1] + reach * world[1]
        rows, cols = self.levels.shape
        field_width = max(self.size) / self.focal_px
        scale = min(rows, cols * height / width) / (_MARGIN * field_width * height / max(self.size))
        places = [at_y * scale + (rows - 1) / 2, at_x * scale + (cols - 1) / 2]
        beyond = [np.nan_to_num(place, nan=-1e6) for place in places]
        return np.asarray(map_coordinates(self.levels, beyond, order=1, cval=WALL_DN))


def _light(encoded: Image) -> Image:
    """IEC 61966-2-1, from 0 to 1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _encoded(light: Image) -> Image:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@dataclass(frozen=True, slots=True, kw_only=True)
class HandHabits:
    """How a hand moves.

    ``reaction_s`` from what is shown to the movement, ``settle_s`` in which a shown amount would be
    undone, ``lag_s`` of the muscles; the largest speeds, in distances and in degrees a second; slow
    sway and tremor of 8 to 12 Hz (amplitudes, in distances and in degrees); and the relative error
    of what is done for an arrow, along it and across.
    """

    reaction_s: float = 0.25
    settle_s: float = 0.9
    lag_s: float = 0.12
    most_speed: float = 0.35
    most_deg_per_s: float = 25.0
    sway: float = 0.003
    sway_deg: float = 0.25
    tremor: float = 0.0006
    tremor_deg: float = 0.04
    clumsiness: float = 0.15


ARROWS = {
    "right": (0, 1), "left": (0, -1), "down": (1, 1), "up": (1, -1), "nearer": (2, 1),
    "further": (2, -1), "tilt down": (3, -1), "tilt up": (3, 1), "tilt right": (4, 1),
    "tilt left": (4, -1), "turn clockwise": (5, 1), "turn anticlockwise": (5, -1),
}  # fmt: skip
"""Of each arrow, the freedom of the hand (x, y, z, about x, y, z of the camera) and its sign."""


class Hand:
    """Moves a camera by arrows alone, which it sees late; it knows nothing of the scene.

    Parameters
    ----------
    start
        Where it begins.
    rng
        Draws its sway, its tremor and its clumsiness.
    field_width
        Width of the field of view at the reference's distance: what "a share of the picture" is.
    """

    def __init__(
        self,
        start: HeldPose,
        rng: np.random.Generator,
        field_width: float,
        habits: HandHabits | None = None,
    ) -> None:
        self._habits = habits or HandHabits()
        self._meant = start
        self._field = field_width
        self._time_s = 0.0
        self._speed = np.zeros(6)
        self._wanted = np.zeros(6)
        self._shown: deque[tuple[float, Vector]] = deque()
        self._does = np.eye(6) + self._habits.clumsiness * rng.uniform(-1, 1, (6, 6))
        self._hz = np.column_stack((rng.uniform(0.2, 0.9, (6, 3)), rng.uniform(8, 12, (6, 2))))
        self._phase = rng.uniform(0, 2 * pi, (6, 5))

    def show(self, arrows: Sequence[tuple[str, float]]) -> None:
        """Show the arrows, each with its amount, in percent or degrees as the page does."""
        wanted = np.zeros(6)
        for name, amount in arrows:
            freedom, sign = ARROWS[name]
            if freedom < 2:
                # It moves by that share of the width that it sees now.
                amount *= self._field * max(1 - self._meant.centre[2], 0.1) / 100
            elif freedom == 2:
                amount = amount / (100 + amount) if sign > 0 else amount / (100 - min(amount, 60))
                amount *= max(1 - self._meant.centre[2], 0.1)
            else:
                amount = radians(amount)
            wanted[freedom] = sign * amount / self._habits.settle_s
        self._shown.append((self._time_s + self._habits.reaction_s, wanted))

    def move(self, step_s: float) -> HeldPose:
        """Go on for a short time; return where the camera then is."""
        habits = self._habits
        self._time_s += step_s
        while self._shown and self._shown[0][0] <= self._time_s:
            self._wanted = self._shown.popleft()[1]
        most = np.repeat([habits.most_speed, radians(habits.most_deg_per_s)], 3)
        aimed = np.clip(self._does @ self._wanted, -most, most)
        self._speed += (aimed - self._speed) * min(step_s / habits.lag_s, 1.0)
        moved = step_s * self._speed
        axes = self._meant.axes
        self._meant = HeldPose(
            centre=self._meant.centre + axes @ moved[:3],
            axes=axes @ Rotation.from_rotvec(moved[3:]).as_matrix(),
        )
        shaken = self._shaken()
        return HeldPose(
            centre=self._meant.centre + self._meant.axes @ shaken[:3],
            axes=self._meant.axes @ Rotation.from_rotvec(shaken[3:]).as_matrix(),
        )

    def _shaken(self) -> Vector:
        habits = self._habits
        waves = np.sin(2 * pi * self._hz * self._time_s + self._phase)
        sway, tremor = waves[:, :3].sum(axis=1) / np.sqrt(3), waves[:, 3:].sum(axis=1) / np.sqrt(2)
        by_place = habits.sway * sway[:3] + habits.tremor * tremor[:3]
        by_angle = radians(habits.sway_deg) * sway[3:] + radians(habits.tremor_deg) * tremor[3:]
        return np.concatenate((by_place, by_angle))


def start_pose(rng: np.random.Generator) -> HeldPose:
    """Draw where an approach begins: too far or too near, aside, swung and turned."""
    distance = rng.uniform(1.2, 1.6) if rng.random() < 0.7 else rng.uniform(0.7, 0.85)
    swung = Rotation.from_euler("xyz", rng.uniform(-1, 1, 3) * [10, 10, 15], degrees=True)
    aside = rng.uniform(-0.12, 0.12, 2)
    # Aimed at the scene, and then swung off it by less than a quarter of the field.
    towards = Rotation.from_euler("xyz", rng.uniform(-8, 8, 3), degrees=True).as_matrix()
    axes = swung.as_matrix()
    centre = np.array([aside[0], aside[1], 1.0]) - distance * axes[:, 2]
    return HeldPose(centre=centre, axes=axes @ towards)


def exposure_poses(history: Sequence[HeldPose]) -> list[HeldPose]:
    """Choose the poses of one exposure from the newest steps of a movement."""
    places = np.linspace(0, len(history) - 1, _SUBEXPOSURES).round().astype(int)
    return [history[place] for place in places]
