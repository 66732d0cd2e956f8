"""Photographs of which things were taken out, to which things were added, in which things moved.

Things are cut out of photographs along an outline (a superpixel, what Otsu's threshold leaves, an
ellipse with a rough rim) and pasted, blended in, or shifted over the ground; or they were there and
are painted over by OpenCV. Both photographs are colour JPEGs with noise of their own, from one pose
or from two; the second pose is OpenCV's warp of the light, sixteen samples a pixel. A pair follows
from its number and seed. Shares nothing with the product but the pose's formula of
``benchmarks/truth/pairs.py``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from math import hypot, nan
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt, gaussian_filter, label, uniform_filter
from skimage import filters, segmentation

from benchmarks.truth.pairs import PairPose
from benchmarks.truth.pictures import ByteImage, Genre, Picture, light_of, region_of, srgb_of
from simulation.arrays import BoolArray, FloatArray

Happening = Literal["removed", "added", "moved"]
Ground = Literal["plain", "textured", "repeating"]
HAPPENINGS: tuple[Happening, ...] = ("removed", "added", "moved")
GROUNDS: tuple[Ground, ...] = ("plain", "textured", "repeating")
GENRES: frozenset[Genre] = frozenset({"photograph", "texture", "skin", "microscopy"})
"""Pictures that things are put into and cut out of."""

LEAST_SIDE_PX = 280
MOST_PX = (430, 520)
THINGS = 3
SIZE_PX = (5.0, 60.0)
SHIFT_PX = (2.0, 20.0)
ZOOM = (0.7, 1.6)
TILT_DEG = 15.0
NOISE_DN = (1.0, 3.0)
QUALITY = (85, 98)
VISIBLE_DN = 10.0
REACH_PX, REACH = 4.0, 0.3
"""How far from its outline an entry still belongs to a thing, in px and in parts of its size."""

_BASE = 1.25
_SAMPLES = 4
_MARGIN_PX = 10
_APART_PX = 12
_FEATHER_PX = 0.6
_TRIES = 60
_CANDIDATES = 40
_PERIOD_PX = (28, 80)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thing:
    """What happened to a thing, of which size, and where, in reference px.

    ``size_px`` is the root of its area; ``contrast_dn`` the mean absolute difference to what
    replaces it, over its outline and channels, of what moved at the fainter place; ``shift_px`` is
    ``(x, y)`` from before to after, NaN where it did not move. ``outlines`` are pixels that it
    covers before or after, ``distance_px`` those from each pixel to the nearest outline.
    """

    happening: Happening
    ground: Ground
    way: str
    size_px: float
    contrast_dn: float
    shift_px: tuple[float, float]
    outlines: BoolArray = field(repr=False)
    distance_px: FloatArray = field(repr=False)

    def holds(self, x_px: float, y_px: float) -> bool:
        """Whether a reference position is that of the thing."""
        rows, cols = self.distance_px.shape
        row, col = round(y_px), round(x_px)
        if not (0 <= row < rows and 0 <= col < cols):
            return False
        return bool(self.distance_px[row, col] <= max(REACH_PX, REACH * self.size_px))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThingPair:
    """Two files, where they were taken from, and what happened between them."""

    before: Path
    after: Path
    picture: str
    pose: PairPose | None
    matrix: FloatArray = field(repr=False)
    things: tuple[Thing, ...]
    faint: int
    recipe: str

    def in_reference(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Reference position ``(x, y)`` of a follow-up position."""
        u, v, w = self.matrix @ np.array([x_px, y_px, 1.0])
        return float(u / w), float(v / w)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Cut:
    """Levels and outline in a window of their own."""

    levels: ByteImage
    mask: BoolArray
    way: str


def suitable(pictures: Sequence[Picture]) -> tuple[Picture, ...]:
    """Pictures that are large and lively enough."""
    kept = []
    for picture in pictures:
        if picture.genre not in GENRES:
            continue
        levels = picture.levels()
        if min(levels.shape[:2]) >= LEAST_SIDE_PX and levels.std() > 5:
            kept.append(picture)
    return tuple(kept)


def thing_pair(pictures: Sequence[Picture], number: int, seed: int, folder: Path) -> ThingPair:
    """Make a pair with up to ``THINGS`` things and write its files into a folder."""
    rng = np.random.default_rng((seed, number))
    ground: Ground = GROUNDS[number % len(GROUNDS)]
    grounds = [one for one in pictures if ground != "plain" or one.genre != "texture"]
    picture = grounds[rng.integers(len(grounds))]
    donors = [one for one in pictures if one is not picture]
    donor = donors[rng.integers(len(donors))]
    is_one_pose = number // len(GROUNDS) % 2 == 0
    part, (top, left) = region_of(_colour(picture.levels()), MOST_PX, rng)
    tile = np.ones(part.shape[:2], dtype=bool)
    if ground == "repeating":
        part, tile = _repeating(part, rng)
    view = _View.of(part, rng, is_one_pose=is_one_pose)
    editor = _Editor(
        before=part.copy(),
        after=part.copy(),
        ground=ground,
        free=tile & view.seen_by_both(),
        view=view,
        donor=_colour(donor.levels()),
    )
    things = list[Thing]()
    faint = 0
    for turn in range(THINGS):
        happening = HAPPENINGS[(number + turn) % len(HAPPENINGS)]
        thing = editor.add(happening, rng)
        faint += thing is None
        things += [thing] if thing is not None else []
    files, said = list[Path](), list[str]()
    for name, scene, matrix in (
        ("before", editor.before, view.reference),
        ("after", editor.after, view.followup),
    ):
        seen = view.photograph(scene, matrix)
        noise, quality = rng.uniform(*NOISE_DN), int(rng.integers(QUALITY[0], QUALITY[1] + 1))
        seen = seen + noise * rng.standard_normal(seen.shape)
        files.append(folder / f"{name}.jpg")
        files[-1].write_bytes(_jpeg(np.clip(np.rint(seen), 0, 255).astype(np.uint8), quality))
        said.append(f"JPEG {quality}, {noise:.1f} DN")
    pose = "one pose" if view.pose is None else f"zoom {view.pose.zoom:.2f}"
    if view.pose is not None:
        pose += f", tilt {view.pose.tilt_deg:.0f}"
    rows, cols = view.frame
    return ThingPair(
        before=files[0],
        after=files[1],
        picture=picture.name,
        pose=view.pose,
        matrix=view.pose_matrix,
        things=tuple(things),
        faint=faint,
        recipe=f"{picture.name} at ({left}, {top}), things of {donor.name}, {cols} x {rows} px, "
        f"{ground}, {pose}; {'; '.join(said)}",
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _View:
    """From where a scene is photographed; matrices are photograph to scene pixels."""

    shape: tuple[int, int]
    frame: tuple[int, int]
    base: float
    pose: PairPose | None

    @classmethod
    def of(cls, part: ByteImage, rng: np.random.Generator, *, is_one_pose: bool) -> "_View":
        rows, cols = part.shape[:2]
        if is_one_pose:
            return cls(shape=(rows, cols), frame=(rows, cols), base=1.0, pose=None)
        pose = PairPose(
            zoom=float(np.exp(rng.uniform(*np.log(ZOOM)))),
            tilt_deg=float(rng.uniform(0, TILT_DEG)),
            bearing_deg=float(rng.uniform(0, 360)),
            turn_deg=float(rng.normal(0, 4)),
            shift=(float(rng.uniform(-0.05, 0.05)), float(rng.uniform(-0.05, 0.05))),
        )
        frame = int(rows / _BASE), int(cols / _BASE)
        return cls(shape=(rows, cols), frame=frame, base=_BASE, pose=pose)

    @property
    def pose_matrix(self) -> FloatArray:
        """Follow-up to reference pixels."""
        return np.eye(3) if self.pose is None else self.pose.matrix(self.frame)

    @property
    def reference(self) -> FloatArray:
        edge = 0.5 * (self.base - 1)
        return np.array([[self.base, 0, edge], [0, self.base, edge], [0, 0, 1.0]])

    @property
    def followup(self) -> FloatArray:
        return np.asarray(self.reference @ self.pose_matrix)

    def photograph(self, scene: ByteImage, matrix: FloatArray) -> FloatArray:
        """Levels of a frame: the mean light of 16 samples a pixel, as sRGB from 0 to 255."""
        if self.pose is None:
            return scene.astype(np.float64)
        rows, cols = self.frame
        edge = 0.5 / _SAMPLES - 0.5
        fine = np.array([[1 / _SAMPLES, 0, edge], [0, 1 / _SAMPLES, edge], [0, 0, 1]])
        shown = cv2.warpPerspective(
            light_of(scene.astype(np.float32) / 255),
            matrix @ fine,
            (cols * _SAMPLES, rows * _SAMPLES),
            flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REFLECT_101,
        )
        mean = shown.reshape(rows, _SAMPLES, cols, _SAMPLES, 3).mean(axis=(1, 3), dtype=np.float64)
        return 255 * srgb_of(mean)

    def seen_by_both(self) -> BoolArray:
        """Scene pixels that both show, away from their borders."""
        rows, cols = self.shape
        y, x = np.mgrid[:rows, :cols].astype(np.float64)
        shown = np.ones(self.shape, dtype=bool)
        for matrix in (self.reference, self.followup):
            u, v, w = np.tensordot(np.linalg.inv(matrix), np.stack([x, y, np.ones_like(x)]), axes=1)
            high, wide = (n - 1 - _MARGIN_PX for n in self.frame)
            shown &= (u / w > _MARGIN_PX) & (u / w < wide) & (v / w > _MARGIN_PX) & (v / w < high)
        return shown

    def in_frame(self, mask: BoolArray) -> BoolArray:
        """Reference pixels of scene pixels."""
        if self.pose is None:
            return mask
        rows, cols = self.frame
        share = cv2.resize(
            mask[: round(rows * self.base), : round(cols * self.base)].astype(np.float32),
            (cols, rows),
            interpolation=cv2.INTER_AREA,
        )
        return np.asarray(share > 0.5)


@dataclass(slots=True, kw_only=True, eq=False)
class _Editor:
    """A scene before and after, and where nothing has happened yet."""

    before: ByteImage
    after: ByteImage
    ground: Ground
    free: BoolArray
    view: _View
    donor: ByteImage

    def add(self, happening: Happening, rng: np.random.Generator) -> Thing | None:
        """Let something happen to a thing; None where none of many tries was visible."""
        for _ in range(_TRIES):
            size = float(np.exp(rng.uniform(*np.log(SIZE_PX)))) * self.view.base
            is_own = rng.uniform() < 0.4 and self.ground != "repeating"
            place = self._place(size, rng)
            if place is None:
                continue
            thing = self._own(happening, place, size, rng) if is_own else None
            thing = thing or self._foreign(happening, place, size, rng)
            if thing is not None:
                return thing
        return None

    def _place(self, size: float, rng: np.random.Generator) -> tuple[int, int] | None:
        """A free place ``(row, col)``: on plain ground the plainest of many, otherwise a lively."""
        room = np.argwhere(distance_transform_edt(np.pad(self.free, 1))[1:-1, 1:-1] > 0.75 * size)
        if len(room) == 0:
            return None
        places = room[rng.integers(len(room), size=_CANDIDATES)]
        if self.ground == "repeating":
            row, col = places[0].tolist()
            return row, col
        grey = self.before.mean(axis=2)
        reach = max(int(1.5 * size), 9)
        spread = uniform_filter(grey**2, reach) - uniform_filter(grey, reach) ** 2
        liveliness = spread[tuple(places.T)]
        best = liveliness.argmin() if self.ground == "plain" else liveliness.argmax()
        row, col = places[best].tolist()
        return row, col

    def _own(
        self, happening: Happening, place: tuple[int, int], size: float, rng: np.random.Generator
    ) -> Thing | None:
        """A thing that the photograph shows; OpenCV paints over it where it is not."""
        cut = _cut(self.before, place, size, rng)
        if cut is None:
            return None
        way = f"{cut.way}, inpainted"
        mask = np.zeros(self.free.shape, dtype=bool)
        window = _window(place, cut.mask.shape, mask.shape)
        if window is None:
            return None
        mask[window] = cut.mask
        wide = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=2)
        method = cv2.INPAINT_TELEA if rng.uniform() < 0.5 else cv2.INPAINT_NS
        bare = np.asarray(cv2.inpaint(self.before, wide, 4, method), dtype=np.uint8)
        if happening == "moved":
            return self._shift(bare, _Cut(levels=cut.levels, mask=cut.mask, way=way), place, rng)
        with_it, without = self.before.copy(), bare
        images = (with_it, without) if happening == "removed" else (without, with_it)
        return self._settle(happening, images, (mask,), way, (nan, nan))

    def _foreign(
        self, happening: Happening, place: tuple[int, int], size: float, rng: np.random.Generator
    ) -> Thing | None:
        """A thing from another photograph."""
        rows, cols = self.donor.shape[:2]
        at = int(rng.integers(rows)), int(rng.integers(cols))
        cut = _cut(self.donor, at, size, rng)
        if cut is None:
            return None
        if happening == "moved":
            return self._shift(self.before, cut, place, rng)
        is_blended = rng.uniform() < 0.4
        with_it = _pasted(self.before, cut, place, is_blended=is_blended)
        mask = _placed(cut.mask, place, self.free.shape)
        if with_it is None or mask is None:
            return None
        way = f"{cut.way}, {'blended' if is_blended else 'pasted'}"
        images = (with_it, self.before) if happening == "removed" else (self.before, with_it)
        return self._settle(happening, images, (mask,), way, (nan, nan))

    def _shift(
        self, bare: ByteImage, cut: _Cut, place: tuple[int, int], rng: np.random.Generator
    ) -> Thing | None:
        """Paste a thing at a place before, and some pixels further after."""
        length, angle = rng.uniform(*SHIFT_PX) * self.view.base, rng.uniform(0, 2 * np.pi)
        down, right = round(length * np.sin(angle)), round(length * np.cos(angle))
        there = place[0] + down, place[1] + right
        images = tuple(_pasted(bare, cut, at, is_blended=False) for at in (place, there))
        masks = tuple(_placed(cut.mask, at, self.free.shape) for at in (place, there))
        before, after = images
        first, second = masks
        if before is None or after is None or first is None or second is None:
            return None
        base = self.view.base
        shift = right / base, down / base
        return self._settle("moved", (before, after), (first, second), cut.way, shift, bare)

    def _settle(
        self,
        happening: Happening,
        images: tuple[ByteImage, ByteImage],
        masks: tuple[BoolArray, ...],
        way: str,
        shift_px: tuple[float, float],
        bare: ByteImage | None = None,
    ) -> Thing | None:
        """Keep what happened if it is visible and on free ground."""
        covered = np.any(masks, axis=0)
        if not np.all(self.free[covered]):
            return None
        if bare is None:
            pairs = [(images[0], images[1], masks[0])]
        else:
            pairs = [(image, bare, mask) for image, mask in zip(images, masks, strict=True)]
        contrast = min(
            float(np.abs(one[mask].astype(float) - other[mask]).mean())
            for one, other, mask in pairs
        )
        if contrast < VISIBLE_DN:
            return None
        outlines = self.view.in_frame(covered)
        area = float(np.mean([mask.sum() for mask in masks])) / self.view.base**2
        if not outlines.any() or area < 0.5 * SIZE_PX[0] ** 2:
            return None
        reach = int(max(_APART_PX, area**0.5) * self.view.base)
        near = distance_transform_edt(~covered) <= reach
        # The window of what happened alone; other things stay as they are.
        changed = distance_transform_edt(~covered) <= 6 * self.view.base
        # One of the images may be the scene itself, so both are read before either is written.
        sources = [image[changed] for image in images]
        for target, source in zip((self.before, self.after), sources, strict=True):
            target[changed] = source
        self.free &= ~near
        return Thing(
            happening=happening,
            ground=self.ground,
            way=way,
            size_px=area**0.5,
            contrast_dn=contrast,
            shift_px=shift_px,
            outlines=outlines,
            distance_px=np.asarray(distance_transform_edt(~outlines)),
        )


def _cut(
    levels: ByteImage, place: tuple[int, int], size: float, rng: np.random.Generator
) -> _Cut | None:
    """A thing of about this size around a place ``(row, col)`` of a photograph."""
    half = int(1.5 * size) + 4
    window = _window(place, (2 * half + 1, 2 * half + 1), (levels.shape[0], levels.shape[1]))
    if window is None:
        return None
    part = np.ascontiguousarray(levels[window])
    ways = ("superpixel", "threshold", "ellipse")
    for way in rng.permutation(ways):
        mask = {"superpixel": _superpixel, "threshold": _blob, "ellipse": _rough_ellipse}[way](
            part, size, rng
        )
        if mask is None:
            continue
        if 0.6 * size < float(mask.sum()) ** 0.5 < 1.5 * size:
            return _centred(part, mask, str(way))
    return None


def _centred(part: ByteImage, mask: BoolArray, way: str) -> _Cut:
    """The thing with four pixels around it, odd sides, its box in the middle."""
    rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    sides = []
    for found, limit in ((rows, mask.shape[0]), (cols, mask.shape[1])):
        low, high = max(found[0] - 4, 0), min(found[-1] + 5, limit)
        sides.append(slice(low, high if (high - low) % 2 else high - 1))
    window = sides[0], sides[1]
    return _Cut(levels=np.ascontiguousarray(part[window]), mask=mask[window], way=way)


def _superpixel(part: ByteImage, size: float, rng: np.random.Generator) -> BoolArray | None:
    slic: Any = segmentation.slic
    count = max(int(part.shape[0] * part.shape[1] / size**2), 2)
    labels = slic(part, n_segments=count, compactness=float(rng.uniform(4, 20)), start_label=1)
    middle = labels[labels.shape[0] // 2, labels.shape[1] // 2]
    return _whole(labels == middle)


def _blob(part: ByteImage, size: float, rng: np.random.Generator) -> BoolArray | None:
    grey = cv2.GaussianBlur(part, (0, 0), 1.0).mean(axis=2)
    if grey.std() < 3:
        return None
    otsu: Any = filters.threshold_otsu
    above = grey > otsu(grey)
    labels, count = label(above if rng.uniform() < 0.5 else ~above)
    areas = np.bincount(labels.ravel(), minlength=count + 1)[1:].astype(float)
    rim = np.concatenate([labels[:2], labels[-2:]]), np.concatenate([labels[:, :2], labels[:, -2:]])
    for edge in rim:
        areas[np.unique(edge)[np.unique(edge) > 0] - 1] = np.inf
    if not np.isfinite(areas).any():
        return None
    return _whole(labels == 1 + int(np.argmin(np.abs(areas - size**2))))


def _rough_ellipse(part: ByteImage, size: float, rng: np.random.Generator) -> BoolArray | None:
    rows, cols = part.shape[:2]
    y, x = np.mgrid[:rows, :cols] - np.reshape([(rows - 1) / 2, (cols - 1) / 2], (2, 1, 1))
    turn, stretch = rng.uniform(0, np.pi), np.exp(rng.uniform(-0.4, 0.4))
    along = (x * np.cos(turn) + y * np.sin(turn)) * stretch
    across = (y * np.cos(turn) - x * np.sin(turn)) / stretch
    angle = np.arctan2(across, along)
    rim = np.ones_like(angle)
    for wave in range(2, 8):
        rim += rng.normal(0, 0.18 / wave) * np.cos(wave * angle + rng.uniform(0, 2 * np.pi))
    return _whole(np.hypot(along, across) < size / np.sqrt(np.pi) * rim)


def _whole(mask: BoolArray) -> BoolArray | None:
    """The outline's largest part without holes; None where it reaches the window's border."""
    labels, count = label(mask)
    if count == 0:
        return None
    largest = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    outside, _ = label(~np.pad(largest, 1))
    filled = np.asarray(outside != outside[0, 0])[1:-1, 1:-1]
    rim = np.concatenate([filled[:2].ravel(), filled[-2:].ravel(), filled[:, :2].ravel(),
                          filled[:, -2:].ravel()])  # fmt: skip
    return None if rim.any() else filled


def _window(
    place: tuple[int, int], shape: tuple[int, ...], limits: tuple[int, ...]
) -> tuple[slice, slice] | None:
    """Window of odd sides around a place, where it is inside."""
    sides = []
    for middle, size, limit in zip(place, shape, limits, strict=True):
        low = middle - size // 2
        if low < 0 or low + size > limit:
            return None
        sides.append(slice(low, low + size))
    return sides[0], sides[1]


def _placed(mask: BoolArray, place: tuple[int, int], limits: tuple[int, ...]) -> BoolArray | None:
    window = _window(place, mask.shape, limits)
    if window is None:
        return None
    whole = np.zeros(limits, dtype=bool)
    whole[window] = mask
    return whole


def _pasted(
    ground: ByteImage, cut: _Cut, place: tuple[int, int], *, is_blended: bool
) -> ByteImage | None:
    """The ground with a thing: its light mixed at a soft rim, or OpenCV's seamless clone."""
    window = _window(place, cut.mask.shape, ground.shape[:2])
    if window is None:
        return None
    made, below = ground.copy(), ground[window]
    if is_blended:
        mask = cut.mask.astype(np.uint8) * 255
        x, y, wide, high = cv2.boundingRect(mask)
        centre = x + wide // 2, y + high // 2
        made[window] = cv2.seamlessClone(
            cut.levels, np.ascontiguousarray(below), mask, centre, cv2.NORMAL_CLONE
        )
        return made
    share = gaussian_filter(cut.mask.astype(np.float64), _FEATHER_PX)[..., None]
    made[window] = np.rint(below * (1 - share) + cut.levels * share).astype(np.uint8)
    return made


def _repeating(part: ByteImage, rng: np.random.Generator) -> tuple[ByteImage, BoolArray]:
    """A field in the middle in which one patch of the photograph is repeated, and where it is."""
    rows, cols = part.shape[:2]
    high, wide = (int(rng.integers(*_PERIOD_PX)) for _ in range(2))
    patches = [
        part[top : top + high, left : left + wide]
        for top, left in zip(
            rng.integers(rows - high, size=6), rng.integers(cols - wide, size=6), strict=True
        )
    ]
    patch = max(patches, key=np.std)
    top, left, down, right = int(0.2 * rows), int(0.2 * cols), int(0.6 * rows), int(0.6 * cols)
    field_shape = (down // high + 1, right // wide + 1, 1)
    made, mask = part.copy(), np.zeros((rows, cols), dtype=bool)
    made[top : top + down, left : left + right] = np.tile(patch, field_shape)[:down, :right]
    mask[top : top + down, left : left + right] = True
    return made, mask


def shift_in_followup(pair: ThingPair, thing: Thing) -> tuple[float, float]:
    """A thing's shift ``(x, y)`` in follow-up px, at its middle."""
    rows, cols = np.nonzero(thing.outlines)
    middle = np.array([cols.mean(), rows.mean()])
    back = np.linalg.inv(pair.matrix)
    ends = []
    for sign in (-0.5, 0.5):
        u, v, w = back @ np.append(middle + sign * np.array(thing.shift_px), 1.0)
        ends.append((u / w, v / w))
    return float(ends[1][0] - ends[0][0]), float(ends[1][1] - ends[0][1])


def length_of(shift_px: tuple[float, float]) -> float:
    """Length of a shift."""
    return hypot(*shift_px)


def _colour(levels: ByteImage) -> ByteImage:
    return levels if levels.ndim == 3 else np.repeat(levels[..., None], 3, axis=2)


def _jpeg(levels: ByteImage, quality: int) -> bytes:
    buffer = BytesIO()
    Image.fromarray(levels).save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()
