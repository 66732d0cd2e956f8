"""Track ``things``: two photographs as people bring them, and what was done to the things on them.

The photographs are in colour, as a phone stores them, or in two levels, as a scanner does. Things
are flat, lie on the scene and cast a soft shadow; outlines, textures and colours are in pixels of
the reference. Light of a channel is the scene's, times a slow wave of its own: the three waves of a
place add to nothing, so that the scene keeps its brightness.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from math import hypot
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.special import ndtr

from hil_mocks.benchmark_set._depth import SOFTNESS_PX, Thing
from hil_mocks.benchmark_set._lenses import LENSES
from hil_mocks.benchmark_set._pair_tracks import CONDITIONS, pose_facts
from hil_mocks.benchmark_set._photographs import (
    Condition,
    labels_tiff,
    pixels,
    sampled,
    srgb_levels,
)
from hil_mocks.benchmark_set._scenes import Pose, Positions, scene, stream
from hil_mocks.benchmark_set._tasks import (
    PairTask,
    RenderedTask,
    SetSize,
    Task,
    View,
    gradient,
    numbered,
    spread,
    twins,
)
from hil_mocks.truth import Outline

TWIN_KINDS = ("tripod", "hand", "light", "two-level")
"""Of a pair with changes, and its twin without."""

LONE_KINDS = ("same", "mirrored")
"""One file twice, and a follow-up that shows the scene as in a mirror: nothing changed."""

Happened = Literal["gone", "new", "moved", "colour"]
WORDS: tuple[Happened, ...] = ("gone", "new", "moved", "colour")
THINGS, MOST_CHANGED = 6, 3
NEAREST_MOVE_PX, FARTHEST_MOVE_PX = 4.0, 60.0

_CHANNELS = 3
_OUTLINES: tuple[Outline, ...] = ("plate", "coin", "leaf")
_HALF_SIZES = (0.02, 0.06)
"""Over the frame's width."""

_SCENE_SATURATION, _THING_SATURATION = 0.2, 0.4
_EXPOSURE = 0.6
"""Leaves room for the brightest channel."""

_SHADOW, _SHADOW_PX, _SHADOW_SOFTNESS_PX = 0.3, 2.0, 1.5
_SHADOW_REACH_PX = 2**0.5 * _SHADOW_PX + 7 * _SHADOW_SOFTNESS_PX
"""Beyond, nothing of it is left: 1e-12 of the light."""

_INK = 0.04
_APART_PX, _FROM_BORDER_PX = 10.0, 8.0
_TRIES = 400

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class ColouredThing(Thing):
    """A thing with a colour: ``hue_deg`` on the circle of the channels."""

    hue_deg: float

    @property
    def reach_px(self) -> float:
        """Farthest that its outline is from its middle."""
        return hypot(self.half_x_px, self.half_y_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fate:
    """A thing before and after, None where it is not there; nothing happened if both are one."""

    before: ColouredThing | None
    after: ColouredThing | None
    what: Happened | None = None

    def undone(self) -> "Fate":
        """The same thing, to which nothing happened."""
        one = self.before or self.after
        return Fate(before=one, after=one)

    @property
    def shown(self) -> tuple[ColouredThing, ...]:
        """The thing wherever it is seen, as it lies afterwards first."""
        return tuple(one for one in (self.after, self.before) if one is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class StagedView(View):
    """A scene on which things lie; ``is_ink``: they are printed in black, and have no shadow."""

    things_scene: str
    is_ink: bool
    wave_px: tuple[float, float]
    phase_deg: float

    def photographed(self, things: Sequence[ColouredThing], *, is_followup: bool) -> FloatArray:
        """Light on a photograph's pixels, shape (rows, cols, channels)."""
        pose = self.pose
        grid = self.followup_grid() if is_followup else self._grid(pose.reference_shape, 1.0)
        seen = pose.seen_by_followup if is_followup else pose.seen_by_reference
        count = 1 if self.is_ink else _CHANNELS
        series = sampled(self._light(things, seen, count), grid, (count,))
        return np.stack([pixels(one, self.lens, grid) for one in series], axis=-1)

    def _light(
        self,
        things: Sequence[ColouredThing],
        seen: Callable[[FloatArray, FloatArray], Positions],
        channels: int,
    ) -> Callable[[FloatArray, FloatArray], FloatArray]:
        plain, cut_out = (
            scene(name, self.pose.reference_shape, self.seed)
            for name in (self.scene, self.things_scene)
        )

        def light(x_px: FloatArray, y_px: FloatArray) -> FloatArray:
            x, y = seen(x_px, y_px)
            levels = np.asarray(plain.at(x, y)) * self._scene_tints(x, y)[:channels]
            for thing in things:
                inside_px = thing.inside_px(x, y)
                rows, cols = np.nonzero(inside_px > -_SHADOW_REACH_PX)
                at_x, at_y, inside_px = x[rows, cols], y[rows, cols], inside_px[rows, cols]
                own = np.full((channels, rows.size), _INK)
                shade = np.ones(rows.size)
                if not self.is_ink:
                    across, down = thing.texture_px
                    texture = thing.shade * cut_out.at(at_x + across, at_y + down)
                    own = texture * _tints(np.array([thing.hue_deg]), _THING_SATURATION)
                    beside_px = thing.inside_px(at_x - _SHADOW_PX, at_y - _SHADOW_PX)
                    shade = 1 - _SHADOW * ndtr(beside_px / _SHADOW_SOFTNESS_PX)
                below = levels[:, rows, cols] * shade
                share = ndtr(inside_px / SOFTNESS_PX)
                levels[:, rows, cols] = below + share * (own - below)
            return levels

        return light

    def _scene_tints(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        if self.is_ink:
            return np.ones((1, *x_px.shape))
        turn_deg = self.phase_deg + 360 * (x_px / self.wave_px[0] + y_px / self.wave_px[1])
        return _tints(turn_deg, _SCENE_SATURATION)


def _tints(turn_deg: FloatArray, saturation: float) -> FloatArray:
    """Light of each channel over that of grey, which is their mean; shape (channels, ...)."""
    turn = np.radians(turn_deg)
    thirds = 2 * np.pi / _CHANNELS * np.arange(_CHANNELS)
    return np.stack([1 + saturation * np.cos(turn + third) for third in thirds])


@dataclass(frozen=True, slots=True, kw_only=True)
class ThingsPair(PairTask):
    """Two photographs, between which something happened to things if ``is_changed``."""

    track = "things"
    pair: str
    is_changed: bool
    things_scene: str

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        shared, rng = stream(self.seed, self.track, self.pair), self.draws()
        pose = _pose_of(shared, self.kind, self.shape)
        condition = self.drawn_condition(shared)
        light = self._light(shared)
        view = self._view(shared, pose)
        fates = drawn_fates(shared, pose, is_ink=view.is_ink)
        if not self.is_changed:
            fates = tuple(fate.undone() for fate in fates)
        before = view.photographed([f.before for f in fates if f.before], is_followup=False)
        reference = _levels(before, condition, rng)
        if self.kind == "same":
            followup = reference
        else:
            after = view.photographed([f.after for f in fates if f.after], is_followup=True)
            followup = _levels(after * light[..., None], condition, rng)
        if self.kind == "mirrored":
            followup = followup[:, ::-1]
        if view.is_ink:
            reference, followup = _in_two_levels(reference, followup)
        suffix = ".png" if view.is_ink else ".jpg"
        paths = {of: f"things/{self.name}/{of}{suffix}" for of in ("reference", "followup")}
        files = {
            paths["reference"]: _stored(reference, condition),
            paths["followup"]: _stored(followup, condition),
        }
        happened = [fate for fate in fates if fate.what is not None]
        truth: dict[str, Any] = {"things": [_facts(fate, pose) for fate in happened]}
        if happened:
            truth["labels"] = f"truth/things/{self.name}.tif"
            files[truth["labels"]] = labels_tiff(labels_of(happened, pose))
        return RenderedTask(
            files=files,
            task={"task": self.name, **paths, "encoding": "srgb", "max_level": 255},
            truth={
                "changed": self.is_changed,
                "mirrored": self.kind == "mirrored",
                "kind": self.kind,
                "pair": self.pair,
                "scene": self.scene_name,
                "things_scene": self.things_scene,
                "lens": self.lens.facts(),
                "condition": condition.name,
                **pose_facts(pose),
                **truth,
            },
        )

    def drawn_condition(self, rng: np.random.Generator) -> Condition:
        """See `PairTask.drawn_condition`."""
        if self.kind == "two-level":
            return replace(self.condition, exposure=_EXPOSURE)
        quality = int(rng.choice([85, 92, 97]))
        name = f"{self.condition.name}, jpeg{quality}"
        return replace(self.condition, name=name, exposure=_EXPOSURE, jpeg_quality=quality)

    def _view(self, rng: np.random.Generator, pose: Pose) -> StagedView:
        rows, cols = self.shape
        return StagedView(
            scene=self.scene_name,
            seed=self.seed,
            lens=self.lens,
            pose=pose,
            things_scene=self.things_scene,
            is_ink=self.kind == "two-level",
            wave_px=(float(rng.uniform(0.8, 1.6)) * cols, float(rng.uniform(0.8, 1.6)) * rows),
            phase_deg=float(rng.uniform(0, 360)),
        )

    def _light(self, rng: np.random.Generator) -> FloatArray:
        if self.kind != "light":
            return np.ones(self.shape)
        slope, bearing_deg = float(rng.uniform(0.1, 0.3)), float(rng.uniform(0, 360))
        return float(rng.uniform(0.7, 1.25)) * gradient(self.shape, slope, bearing_deg)


def _levels(light: FloatArray, condition: Condition, rng: np.random.Generator) -> NDArray[np.uint8]:
    """8-bit levels with noise, shape (rows, cols, channels)."""
    channels = [condition.levels(light[..., at], rng) for at in range(light.shape[-1])]
    return srgb_levels(np.stack(channels, axis=-1))


def _in_two_levels(*photographs: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Scans in black and white, all by one threshold: the middle of the first one's levels."""
    black, white = np.percentile(photographs[0], (1, 99))
    return [np.where(one > (black + white) / 2, 255, 0).astype(np.uint8) for one in photographs]


def _stored(levels: NDArray[np.uint8], condition: Condition) -> bytes:
    """Photograph as a file: a JPEG, or a PNG that is not compressed, the same by any zlib."""
    file = BytesIO()
    if condition.jpeg_quality is None:
        Image.fromarray(levels[..., 0]).save(file, "PNG", compress_level=0)
    else:
        Image.fromarray(levels).save(file, "JPEG", quality=condition.jpeg_quality)
    return file.getvalue()


def _pose_of(rng: np.random.Generator, kind: str, shape: tuple[int, int]) -> Pose:
    """Draw a pose of a kind: that of the reference, of a sheet on a scanner, or a free hand's."""
    rows, cols = shape
    pose = Pose(reference_shape=shape, followup_shape=shape)
    if kind in ("tripod", "same"):
        return pose
    if kind == "two-level":
        shift = (float(rng.uniform(-6, 6)), float(rng.uniform(-6, 6)))
        return replace(pose, roll_deg=float(rng.uniform(-1, 1)), shift_px=shift)
    return replace(
        pose,
        zoom=float(rng.uniform(1.0, 1.15)),
        roll_deg=float(rng.uniform(-4, 4)),
        tilt_deg=float(rng.uniform(0, 6)),
        bearing_deg=float(rng.uniform(0, 360)),
        shift_px=(float(rng.uniform(-0.04, 0.04) * cols), float(rng.uniform(-0.04, 0.04) * rows)),
    )


def drawn_fates(rng: np.random.Generator, pose: Pose, *, is_ink: bool) -> tuple[Fate, ...]:
    """Things apart from one another, within both frames; to the first of them something happens."""
    changed, words = int(rng.integers(1, MOST_CHANGED + 1)), WORDS[: 3 if is_ink else 4]
    fates: list[Fate] = []
    for _ in range(_TRIES):
        what = words[int(rng.integers(len(words)))] if len(fates) < changed else None
        fate = _fate(what, _thing(rng, pose), rng)
        placed = [one for each in fates for one in each.shown]
        if all(_is_within(one, pose) for one in fate.shown) and all(
            hypot(one.x_px - other.x_px, one.y_px - other.y_px)
            > one.reach_px + other.reach_px + _APART_PX
            for one in fate.shown
            for other in placed
        ):
            fates.append(fate)
            if len(fates) == THINGS:
                break
    return tuple(fates)


def _fate(what: Happened | None, thing: ColouredThing, rng: np.random.Generator) -> Fate:
    if what == "gone":
        return Fate(before=thing, after=None, what=what)
    if what == "new":
        return Fate(before=None, after=thing, what=what)
    after = thing
    if what == "colour":
        turn_deg = float(rng.uniform(90, 270))
        after = replace(thing, hue_deg=(thing.hue_deg + turn_deg) % 360)
    elif what == "moved":
        length = NEAREST_MOVE_PX * (FARTHEST_MOVE_PX / NEAREST_MOVE_PX) ** float(rng.uniform())
        angle = float(rng.uniform(0, 2 * np.pi))
        after = replace(
            thing,
            x_px=thing.x_px + length * float(np.cos(angle)),
            y_px=thing.y_px + length * float(np.sin(angle)),
            # The texture goes with it.
            texture_px=(
                thing.texture_px[0] - length * float(np.cos(angle)),
                thing.texture_px[1] - length * float(np.sin(angle)),
            ),
        )
    return Fate(before=thing, after=after, what=what)


def _thing(rng: np.random.Generator, pose: Pose) -> ColouredThing:
    rows, cols = pose.reference_shape
    outline = _OUTLINES[int(rng.integers(len(_OUTLINES)))]
    half_x, half_y = (rng.uniform(*_HALF_SIZES, 2) * cols).tolist()
    return ColouredThing(
        outline=outline,
        x_px=float(rng.uniform(0, cols)),
        y_px=float(rng.uniform(0, rows)),
        half_x_px=half_x,
        half_y_px=half_y if outline != "leaf" else 0.45 * half_x,
        turn_deg=float(rng.uniform(0, 180)),
        depth=1.0,
        shade=float(rng.uniform(0.5, 1.3)),
        texture_px=(float(rng.uniform(-0.4, 0.4)) * cols, float(rng.uniform(-0.4, 0.4)) * rows),
        hue_deg=float(rng.uniform(0, 360)),
    )


def _is_within(thing: ColouredThing, pose: Pose) -> bool:
    """Whether both frames hold a thing, with some px around it."""
    margin = thing.reach_px + _FROM_BORDER_PX
    at = np.array([thing.x_px, thing.y_px, 1.0])
    places = (at, np.linalg.solve(pose.matrix, at))
    return all(
        margin < x / w < cols - 1 - margin and margin < y / w < rows - 1 - margin
        for (x, y, w), (rows, cols) in zip(
            places, (pose.reference_shape, pose.followup_shape), strict=True
        )
    )


def labels_of(fates: Sequence[Fate], pose: Pose) -> NDArray[np.uint8]:
    """Number of the thing, from 1, at the middles of the follow-up's pixels; 0 of none.

    A thing is where it was and where it is.
    """
    rows, cols = pose.followup_shape
    x, y = pose.seen_by_followup(*np.meshgrid(np.arange(float(cols)), np.arange(float(rows))))
    labels = np.zeros((rows, cols), np.uint8)
    for number, fate in enumerate(fates, 1):
        for thing in fate.shown:
            labels[thing.inside_px(x, y) > 0] = number
    return labels


def _facts(fate: Fate, pose: Pose) -> dict[str, Any]:
    """What the truth says of a thing: what happened, and where its middle is in the follow-up."""
    thing = fate.shown[0]
    x, y, w = np.linalg.solve(pose.matrix, np.array([thing.x_px, thing.y_px, 1.0]))
    return {
        "what": fate.what,
        "x_px": float(x / w),
        "y_px": float(y / w),
        "outline": thing.outline,
        "half_px": [thing.half_x_px, thing.half_y_px],
        "moved_px": hypot(
            fate.shown[0].x_px - fate.shown[-1].x_px, fate.shown[0].y_px - fate.shown[-1].y_px
        ),
    }


def things_tasks(size: SetSize, seed: int) -> list[Task]:
    """Tasks of the track: twins, then those that have none."""
    rng, pairs = stream(seed, "things", size.name), size.things // 2
    names = iter(numbered("things", size.things + size.lone_things))
    of_pairs = iter(numbered("pair", pairs + size.lone_things))
    lone = spread(rng, LONE_KINDS, size.lone_things)
    kinds = [*spread(rng, TWIN_KINDS, pairs), *lone]
    tasks: list[Task] = []
    for seen, kind, lens, condition in zip(
        spread(rng, size.scenes, len(kinds)),
        kinds,
        spread(rng, LENSES, len(kinds)),
        spread(rng, CONDITIONS, len(kinds)),
        strict=True,
    ):
        pair = next(of_pairs)
        others = [other for other in size.scenes if other != seen]
        things_scene = others[int(rng.integers(len(others)))]
        drawings = [one for one in size.scenes if one.startswith(("print", "rectangles"))]
        if kind == "two-level":
            seen = drawings[int(rng.integers(len(drawings)))]
        tasks += [
            ThingsPair(
                name=next(names),
                pair=pair,
                is_changed=is_changed,
                seed=seed,
                shape=size.frame,
                scene_name=seen,
                things_scene=things_scene,
                kind=kind,
                lens=lens,
                condition=condition,
            )
            for is_changed in (twins(rng) if kind in TWIN_KINDS else (False,))
        ]
    return tasks
