"""Scenes with depth: things with hard edges before a ground, or before a facade and its street.

Outlines and textures are in pixels of the reference, as it sees them: where the follow-up sees a
thing, and what it sees behind, follows from depths alone. The inverse depth of a plane is linear
over the reference's frame, and a ray meets a plane in closed form. Outlines are as soft as what
is painted: sampled like the rest, they hardly alias.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from math import asin, cos, degrees, hypot, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from hil_mocks.benchmark_set._photographs import Grid, Series, pixels, sampled
from hil_mocks.benchmark_set._scenes import SOFTNESS_CELLS, Pose, Positions, scene
from hil_mocks.benchmark_set._tasks import View
from hil_mocks.truth import SAMPLES_PER_PX, Outline, inside_outline

DEEP_KINDS = ("steps", "outdoors")

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

SOFTNESS_PX = SOFTNESS_CELLS / SAMPLES_PER_PX
"""Of an outline, standard deviation in px of the reference."""

_UNSEEN = 1e-12
"""Share of the light below which a thing is left out."""

_THINGS = 6
_LARGEST_PARALLAX = 0.125
"""Of a frame's width: 40 px of 320."""

_HIGHEST = 0.35
"""Of things on a ground, over the reference's distance from it."""

_NEAREST, _FARTHEST = 0.33, 0.8
"""Depths of things before a facade, over the facade's."""

_APART = (0.02, 0.065)
"""How far the follow-up stands aside of the reference, over the facade's depth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Thing:
    """A flat thing that faces the reference.

    ``x_px, y_px, half_x_px, half_y_px``: middle and half the size, in px of the reference, of which
    a coin has but the first. ``depth``: over that of the plane. ``texture_px``: where in its
    scene it was cut out. ``shade``: of its light.
    """

    outline: Outline
    x_px: float
    y_px: float
    half_x_px: float
    half_y_px: float
    turn_deg: float
    depth: float
    shade: float
    texture_px: tuple[float, float]

    def inside_px(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """How far positions of the reference are within the outline; negative outside."""
        c, s = cos(radians(self.turn_deg)), sin(radians(self.turn_deg))
        across, down = x_px - self.x_px, y_px - self.y_px
        about = c * across + s * down, c * down - s * across
        return inside_outline(self.outline, about, (self.half_x_px, self.half_y_px))


@dataclass(frozen=True, slots=True, kw_only=True)
class Depths:
    """What stands where.

    ``things``: the farthest first. ``rise_per_px``: below row ``fold_px`` the plane folds towards
    the cameras, as a street before a facade, and its inverse depth grows by so much a px of the
    reference; 0 where it does not.
    """

    things: tuple[Thing, ...]
    fold_px: float = 0.0
    rise_per_px: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sight:
    """Rays of a camera: from its pupil, (x, y, z), with these slopes over the reference's depth."""

    pose: Pose
    pupil: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray

    @classmethod
    def of(cls, pose: Pose, pupil: FloatArray, rays: FloatArray) -> "_Sight":
        """``rays``: directions before the reference, shape (3, ...), of positive depth."""
        return cls(pose=pose, pupil=pupil, slope_x=rays[0] / rays[2], slope_y=rays[1] / rays[2])

    def at_depth(self, depth: float | FloatArray) -> Positions:
        """Where the reference sees the rays' points of a depth."""
        x, y, z = self.pupil.tolist()
        beyond = depth - z
        return self.pose.seen_by_reference_at(
            x + beyond * self.slope_x, y + beyond * self.slope_y, depth
        )

    def on_backdrop(self, depths: Depths) -> Positions:
        """Where the reference sees the points of the plane, or of its fold, that rays meet."""
        if not depths.rise_per_px:
            return self.at_depth(1.0)
        # Of the fold's points (x, y, z), rise y + level z = 1.
        rise = depths.rise_per_px * self.pose.focal_length_px
        level = 1 - rise * float(self.pose.rays(np.zeros(1), np.array([depths.fold_px]))[1, 0])
        _, y, z = self.pupil.tolist()
        descent = rise * self.slope_y + level
        meets = descent > 0
        beyond = (1 - rise * y - level * z) / np.where(meets, descent, 1.0)
        return self.at_depth(np.where(meets, np.minimum(z + beyond, 1.0), 1.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Visibility:
    """What the follow-up's pixels show, shape ``(rows, cols)`` each.

    ``surface``: number of the thing, from 1, or 0. ``x_px, y_px``: where that is in the reference.
    ``is_unseen``: whether another thing stands before it there, or that is beyond the frame.
    """

    surface: IntArray = field(repr=False)
    x_px: FloatArray = field(repr=False)
    y_px: FloatArray = field(repr=False)
    is_unseen: BoolArray = field(repr=False)

    def shows(self, x_px: float, y_px: float, radius_px: float) -> bool:
        """Whether both photographs show all of a disc of the follow-up, on a single surface."""
        rows, cols = np.ogrid[: self.surface.shape[0], : self.surface.shape[1]]
        disc = (cols - x_px) ** 2 + (rows - y_px) ** 2 <= radius_px**2
        on = self.surface[disc]
        return bool((on == on[0]).all() and not self.is_unseen[disc].any())


@dataclass(frozen=True, slots=True, kw_only=True)
class DeepView(View):
    """A scene with depth, seen from both poses; ``things_scene`` is what things are cut out of."""

    depths: Depths
    things_scene: str

    def reference_light(self) -> FloatArray:
        """See `View.reference_light`."""
        grid = self._grid(self.pose.reference_shape, 1.0)
        return pixels(self._series_of(grid, self._from_reference), self.lens, grid)

    def followup_grid(self) -> Grid:
        """See `View.followup_grid`."""
        # Of what is nearest, distances differ most.
        nearest = min([1.0, *(thing.depth for thing in self.depths.things)])
        return self._grid(self.pose.followup_shape, (nearest - float(self.pose.pupil[2])) / nearest)

    def series_on(self, grid: Grid) -> Series:
        """See `View.series_on`."""
        return self._series_of(grid, self._from_followup)

    def visibility(self) -> Visibility:
        """What the follow-up's pixels show, by the middle of each."""
        rows, cols = self.pose.followup_shape
        sight = self._from_followup(*np.meshgrid(np.arange(float(cols)), np.arange(float(rows))))
        x, y = sight.on_backdrop(self.depths)
        surface = np.zeros((rows, cols), np.int64)
        for number, thing in enumerate(self.depths.things, 1):
            at_x, at_y = sight.at_depth(thing.depth)
            covers = thing.inside_px(at_x, at_y) > 0
            surface[covers] = number
            x, y = np.where(covers, at_x, x), np.where(covers, at_y, y)
        rows, cols = self.pose.reference_shape
        is_unseen = (x < 0) | (x > cols - 1) | (y < 0) | (y > rows - 1)
        for number, thing in enumerate(self.depths.things, 1):
            is_unseen |= (surface < number) & (thing.inside_px(x, y) > 0)
        return Visibility(surface=surface, x_px=x, y_px=y, is_unseen=is_unseen)

    def facts(self) -> dict[str, Any]:
        """Return what the truth says of the depths."""
        return {"things_scene": self.things_scene, **asdict(self.depths)}

    def _from_followup(self, x_px: FloatArray, y_px: FloatArray) -> _Sight:
        rays = np.tensordot(self.pose.rotation, self.pose.rays(x_px, y_px), axes=1)
        return _Sight.of(self.pose, self.pose.pupil, rays)

    def _from_reference(self, x_px: FloatArray, y_px: FloatArray) -> _Sight:
        return _Sight.of(self.pose, np.zeros(3), self.pose.rays(x_px, y_px))

    def _series_of(
        self, grid: Grid, sight_of: Callable[[FloatArray, FloatArray], _Sight]
    ) -> Series:
        plain, cut_out = (
            scene(name, self.pose.reference_shape, self.seed)
            for name in (self.scene, self.things_scene)
        )

        def light(x_px: FloatArray, y_px: FloatArray) -> FloatArray:
            sight = sight_of(x_px, y_px)
            seen = plain.at(*sight.on_backdrop(self.depths))
            for thing in self.depths.things:
                x, y = sight.at_depth(thing.depth)
                share = ndtr(thing.inside_px(x, y) / SOFTNESS_PX)
                on = share > _UNSEEN
                across, down = thing.texture_px
                own = thing.shade * cut_out.at(x[on] + across, y[on] + down)
                seen[on] += share[on] * (own - seen[on])
            return seen

        return sampled(light, grid)


def drawn_depths(rng: np.random.Generator, kind: str, pose: Pose) -> Depths:
    """Draw what stands where, before a pose of a kind."""
    return _street(rng, pose) if kind == "outdoors" else _table(rng, pose)


def depth_of_parallax(pose: Pose, parallax_px: float) -> float:
    """Depth at which a thing before the reference's middle has so much parallax on the plane.

    A ray from the follow-up's pupil c through a point of depth Z meets the plane displaced by
    c_xy (1 - Z) / (Z - c_z).
    """
    x, y, z = pose.pupil.tolist()
    share = parallax_px / (pose.focal_length_px * hypot(x, y))
    return float(1 - (1 - z) * share / (1 + share))


def _table(rng: np.random.Generator, pose: Pose) -> Depths:
    """Plates, coins and a leaf at several heights, the highest with the largest parallax."""
    rows, cols = pose.reference_shape
    largest_px = float(rng.uniform(0.4, 1.0)) * _LARGEST_PARALLAX * cols
    top = min(1 - depth_of_parallax(pose, largest_px), _HIGHEST)
    outlines: list[Outline] = ["plate", "coin", "leaf", "plate", "coin", "plate"]
    things = [
        replace(
            _thing(rng, outline, pose),
            x_px=float(rng.uniform(0.12, 0.88)) * cols,
            y_px=float(rng.uniform(0.12, 0.88)) * rows,
            depth=1 - top * (1.0 if number == 0 else float(rng.uniform(0.1, 1.0))),
        )
        for number, outline in enumerate(outlines[:_THINGS])
    ]
    return Depths(things=tuple(sorted(things, key=lambda one: -one.depth)))


def _street(rng: np.random.Generator, pose: Pose) -> Depths:
    """A facade, the street before it, and posts, signs and leaves from a third of its depth on."""
    rows, cols = pose.reference_shape
    fold = float(rng.uniform(0.5, 0.65)) * rows
    # At the lowest row the street is about as near as the nearest thing.
    rise = float(rng.uniform(0.7, 1.0)) * (1 / _NEAREST - 1) / (rows - fold)
    things = []
    for number in range(_THINGS):
        outline: Outline = ("plate", "coin", "leaf")[number % 3]
        depth = _NEAREST * (_FARTHEST / _NEAREST) ** (number / _THINGS + float(rng.uniform(0, 0.1)))
        made = replace(_thing(rng, outline, pose), depth=depth)
        foot = fold + (1 / depth - 1) / rise
        half = made.half_y_px
        if outline == "plate":  # a post, upright on the street
            half = float(rng.uniform(0.15, 0.3)) * rows
            made = replace(
                made, turn_deg=0.0, half_x_px=float(rng.uniform(0.015, 0.05)) * cols, half_y_px=half
            )
            y = foot - half
        else:
            y = min(float(rng.uniform(0.1, 0.6)) * rows, foot - max(half, made.half_x_px))
        things.append(replace(made, x_px=float(rng.uniform(0.08, 0.92)) * cols, y_px=y))
    ordered = tuple(sorted(things, key=lambda one: -one.depth))
    return Depths(things=ordered, fold_px=fold, rise_per_px=rise)


def _thing(rng: np.random.Generator, outline: Outline, pose: Pose) -> Thing:
    """Size, turn, texture and shade of a thing; it is put somewhere by others."""
    rows, cols = pose.reference_shape
    half_x, half_y = rng.uniform(0.05, 0.13, 2) * cols
    return Thing(
        outline=outline,
        x_px=0.0,
        y_px=0.0,
        half_x_px=float(half_x),
        half_y_px=float(half_y if outline != "leaf" else 0.45 * half_x),
        turn_deg=float(rng.uniform(0, 180)),
        depth=1.0,
        shade=float(rng.uniform(0.65, 1.15)),
        texture_px=(float(rng.uniform(-0.4, 0.4)) * cols, float(rng.uniform(-0.4, 0.4)) * rows),
    )


def drawn_pose(rng: np.random.Generator, kind: str, pose: Pose) -> Pose:
    """A pose of a kind, from one that is turned a little: it stands aside, and looks back."""
    bearing_deg = float(rng.uniform(0, 360))
    if kind == "steps":
        tilt_deg = float(rng.uniform(6, 14))
        zoom = float(rng.uniform(1.1, 1.6))
    else:
        zoom = float(rng.uniform(1.02, 1.2))
        tilt_deg = degrees(asin(float(rng.uniform(*_APART)) / zoom))
    return replace(pose, zoom=zoom, tilt_deg=tilt_deg, bearing_deg=bearing_deg, shift_px=(0.0, 0.0))
