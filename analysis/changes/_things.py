"""One entry for one thing: changes that touch or lie in one outline, and movements apart.

A thing that is gone leaves changes of both signs, wherever it was brighter and darker than what is
behind it; a person lists the thing. Each says what happened to it, and the first is the one that
catches the eye: by its contrast in lightness and the root of its area, as the threshold of the eye
falls with the area of what is seen.

References
----------
H. Piper, "Über die Abhängigkeit des Reizwertes leuchtender Objekte von ihrer Flächen- bezw.
Winkelgröße", Z. Psychol. Physiol. Sinnesorg. 32 (1903), 98-112.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import dist, inf
from typing import Final

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from analysis.changes._colour import ColourPlanes, PairColours, SeenDifference, to_channels, to_rgb
from analysis.changes._comparison import Comparison
from analysis.changes._document import Change, Happened
from analysis.changes._movements import ChangedRegion, Movement, Surroundings, find_movements
from analysis.changes._regions import LinkedRegion
from analysis.changes._trial import Images
from calibration.registration import DistortedPose
from simulation.arrays import AnyArray, BoolArray, FloatArray, FloatImage, IntArray

_MOST_TRIED = 300
"""Changes of which it is asked; a frame with more is another scene."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Entry:
    """One entry of the list, with the regions that it stands for.

    ``visibility`` is what the list is ordered by, once it is one of things.
    """

    change: Change
    regions: tuple[LinkedRegion, ...]
    visibility: float = 0.0

    @property
    def pixels(self) -> tuple[IntArray, IntArray]:
        """Rows and columns on the comparison's grid, of the strongest region first."""
        return (
            np.concatenate([region.rows for region in self.regions]),
            np.concatenate([region.cols for region in self.regions]),
        )

    @property
    def area_px(self) -> int:
        """Pixels of the grid."""
        return sum(len(region.rows) for region in self.regions)


@dataclass(frozen=True, slots=True, kw_only=True)
class ToldApart:
    """Changes and movements, the most significant first each until they are ordered as things."""

    found: tuple[Entry, ...]
    shifted: tuple[Entry, ...]

    @property
    def changes(self) -> tuple[Change, ...]:
        """What changed."""
        return tuple(entry.change for entry in self.found)

    @property
    def moved(self) -> tuple[Change, ...]:
        """What moved."""
        return tuple(entry.change for entry in self.shifted)

    @property
    def changed_regions(self) -> tuple[LinkedRegion, ...]:
        """Of what changed."""
        return tuple(region for entry in self.found for region in entry.regions)

    @property
    def moved_regions(self) -> tuple[LinkedRegion, ...]:
        """Of what moved."""
        return tuple(region for entry in self.shifted for region in entry.regions)

    def together(self) -> "ToldApart":
        """Count movements among the changes."""
        both = sorted((*self.found, *self.shifted), key=lambda one: -one.visibility)
        return ToldApart(found=tuple(both), shifted=())


def moved_apart(
    compared: Comparison,
    pose: DistortedPose,
    regions: Sequence[LinkedRegion],
    changes: Sequence[Change],
) -> ToldApart:
    """Tell the movements among the listed changes; what one shift explains is one of them.

    ``regions, changes``: all, the most significant first.
    """
    tried = [
        ChangedRegion(
            row=region.row,
            col=region.col,
            sign=1 if region.significance > 0 else -1,
            rows=region.rows,
            cols=region.cols,
        )
        for region in regions[:_MOST_TRIED]
    ]
    movements = find_movements(_images_of(compared), tried) if tried else ()
    explained = {index for movement in movements for index in movement.regions}
    moved = [
        Entry(
            change=_as_change(movement, changes, tried, compared, pose),
            regions=tuple(regions[index] for index in movement.regions),
        )
        for movement in movements
    ]
    return ToldApart(
        found=tuple(
            Entry(change=change, regions=(region,))
            for index, (change, region) in enumerate(zip(changes, regions, strict=True))
            if index not in explained
        ),
        shifted=tuple(sorted(moved, key=lambda one: -one.change.significance)),
    )


def _images_of(compared: Comparison) -> Images:
    """Both photographs in the levels that were matched."""
    scale = compared.matched_scale
    difference, sd = (
        np.divide(image, scale, out=np.zeros_like(image), where=compared.valid)
        for image in (compared.difference_dn, compared.sd_dn)
    )
    target, brought = compared.target_dn, compared.target_dn - difference
    is_on_followup = compared.is_on_followup
    return Images(
        before_dn=brought if is_on_followup else target,
        after_dn=target if is_on_followup else brought,
        sd_dn=np.abs(sd, out=sd),
        valid=compared.valid,
        smoothing_px=compared.smoothing_px,
    )


def _as_change(
    movement: Movement,
    changes: Sequence[Change],
    regions: Sequence[ChangedRegion],
    compared: Comparison,
    pose: DistortedPose,
) -> Change:
    first = movement.regions[0]
    displacement, covariance = movement.displacement_px, movement.covariance_px2
    if not compared.is_on_followup:
        at = (float(regions[first].row), float(regions[first].col))
        slope = _followup_slope(pose.plane, at)
        displacement = tuple(slope @ displacement)
        covariance = slope @ covariance @ slope.T
    err = np.sqrt(np.diag(covariance))
    return changes[first].model_copy(
        update={
            "area_px": sum(changes[index].area_px for index in movement.regions),
            "displacement_px": (float(displacement[1]), float(displacement[0])),
            "displacement_err_px": (float(err[1]), float(err[0])),
            "is_moved": True,
        }
    )


def _followup_slope(pose: DistortedPose, at: tuple[float, float]) -> FloatArray:
    """Follow-up pixels (y, x) by reference pixels (y, x), shape (2, 2)."""
    y, x = (
        np.array([at[0] + 0.5, at[0] - 0.5, at[0], at[0]]),
        np.array([at[1], at[1], at[1] + 0.5, at[1] - 0.5]),
    )
    rows, cols = pose.to_followup_px(y, x)
    return np.array(
        [[rows[0] - rows[1], rows[2] - rows[3]], [cols[0] - cols[1], cols[2] - cols[3]]]
    )


_REACH: Final = 0.3
_REACHES_PX: Final = (2.0, 3.0, 4.0, 6.0, 9.0, 12.0)
"""How far around itself a change takes others for parts of one thing: over the root of its area,
and the distances that are looked at."""

_MOST_ENCLOSED: Final = 3.0
"""Area of an outline over that of the changes along it, beyond which what it holds is apart."""

_RING_PX: Final = (3.0, 9.0)
"""Distances from a thing of its surroundings."""

_SAME_THING: Final = 0.65
"""Correlation of before and after, above which a thing is the same one in another light: of 72
things in scikit-image's pictures 32 of the 36 that were made brighter or darker are above it, and
32 of the 36 that were put in or taken out below."""

_AS_PLAIN: Final = 3.0
"""Structure over that of the surroundings, up to which a place is part of these."""

_BESIDE_PX, _BEYOND_PX = 2.0, 3.0
"""Distances from the outline of a change at which it is asked whether light steps there: outside,
and within, where smoothing has moved the outline outwards."""

_BY_STRUCTURE, _BY_STEEPNESS, _CLEARLY = 0.3, 0.5, 0.22
"""How much the logarithms of what stands out within, and of how steep the outline is, count beside
that of the squares of these steps; and up to which sum neither photograph is said to lack a thing.
Of 31 things put in or taken out of rendered scenes 25 are told rightly, 3 wrongly, and of 3 it is
left open."""

_SURELY: Final = 4.0
"""Standard errors of its luma, below which a thing has changed its colour alone."""

_SAME_SHIFT_PX: Final = 1.0
"""Distance of the displacements of one thing's parts."""

_LEAST_MOVED: Final = 0.2
"""Share of a thing's area that movements must be, to be ones."""

_MOST_LEFT: Final = 1.0
"""Area of a change over that of the movement beside it, up to which it is left over from that."""


def as_things(
    apart: ToldApart, compared: Comparison, colours: PairColours | None = None
) -> ToldApart:
    """Join changes and movements to things, and order them.

    ``colours``: of both photographs, where they are in colour.
    """
    entries = [*apart.shifted, *apart.found]
    if not entries:
        return apart
    images = _images_of(compared)
    view = _View.of(images)
    in_colour = None
    if colours is not None and compared.colours is not None:
        in_colour = _InColour.of(colours, compared, compared.colours)
    shape = images.valid.shape
    shifted: list[Entry] = []
    found: list[Entry] = []
    for members in _groups(entries, (shape[0], shape[1])):
        group = [entries[index] for index in members]
        movements = [entry for entry in group if entry.change.is_moved]
        others = [entry for entry in group if not entry.change.is_moved]
        if not _is_enough(movements, group):
            others, movements = [*others, *map(_at_rest, movements)], []
        if movements:
            largest = max(movements, key=lambda entry: entry.area_px)
            left = [one for one in others if one.area_px <= _MOST_LEFT * largest.area_px]
            others = [one for one in others if one.area_px > _MOST_LEFT * largest.area_px]
            shifted += _as_movements(movements, left)
        if others:
            thing = _as_thing(others, images, in_colour)
            found.append(thing if in_colour is None else in_colour.with_colours(thing))
    return ToldApart(found=view.ordered(found), shifted=view.ordered(shifted))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _View:
    """Both photographs in lightness, for what catches the eye."""

    before: FloatArray
    after: FloatArray

    @classmethod
    def of(cls, images: Images) -> "_View":
        levels = images.after_dn[images.valid]
        white = float(np.percentile(levels, 99.9)) if levels.size else 1.0
        return cls(
            before=_lightness(images.before_dn, white), after=_lightness(images.after_dn, white)
        )

    def ordered(self, entries: Sequence[Entry]) -> tuple[Entry, ...]:
        """First what catches the eye first."""
        seen = [replace(entry, visibility=self._visibility(entry)) for entry in entries]
        return tuple(sorted(seen, key=lambda entry: -entry.visibility))

    def _visibility(self, entry: Entry) -> float:
        """Contrast in lightness, or in colour, times the root of the area."""
        rows, cols = entry.pixels
        contrast = np.mean(np.abs(self.after[rows, cols] - self.before[rows, cols]))
        return float(max(contrast, entry.change.delta_e or 0.0) * np.sqrt(len(rows)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _InColour:
    """Red, green and blue of the photograph whose pixels the grid has, and of the difference.

    ``own_dn``: shape ``(rows, cols, 3)``, times ``light`` in the follow-up's levels. ``is_after``:
    whether it is the follow-up. ``white_dn``: level of white in the follow-up's levels, and whether
    the files say it.
    """

    planes: ColourPlanes
    own_dn: AnyArray
    is_after: bool
    light: float
    white_dn: float
    is_white_known: bool

    @classmethod
    def of(cls, colours: PairColours, compared: Comparison, planes: ColourPlanes) -> "_InColour":
        is_after = compared.is_on_followup
        own = colours.followup_dn if is_after else colours.reference_dn
        known, light = colours.white_dn[1], 1.0 if is_after else compared.gain
        white = (
            light * float(np.percentile(np.asarray(own[::4, ::4], dtype=np.float64), 99.9))
            if known is None
            else known
        )
        return cls(
            planes=planes,
            own_dn=own,
            is_after=is_after,
            light=light,
            white_dn=max(white, 1e-30),
            is_white_known=None not in colours.white_dn,
        )

    def with_colours(self, thing: Entry) -> Entry:
        """The thing with its difference in colour, and called one where it is mainly that."""
        # What is brighter here and darker there has a mean of no difference: of its parts the one
        # that is seen first.
        each = [(self._seen(one.rows, one.cols), len(one.rows)) for one in thing.regions]
        seen, _ = max(each, key=lambda one: one[0].delta_e * one[1] ** 0.5)
        update: dict[str, object] = {}
        if self.is_white_known:
            update["delta_e"] = seen.delta_e
        change = thing.change
        if seen.is_of_colour and (change.what in _LIT or not _is_lit(change)):
            update["what"] = "colour"
        return replace(thing, change=change.model_copy(update=update))

    def sides(self, around: Surroundings) -> list[FloatArray]:
        """Before and after around a change, shape ``(rows, cols, 3)`` each."""
        more = np.moveaxis(to_rgb(self._channels(*around.crop)), 0, -1)
        own = self.light * np.asarray(self.own_dn[around.crop], dtype=np.float64)
        return [own - more, own] if self.is_after else [own, own + more]

    def _channels(self, rows: IntArray | slice, cols: IntArray | slice) -> FloatArray:
        """Luma, red and blue of the difference."""
        planes = self.planes
        difference = planes.difference_dn[:, rows, cols].astype(np.float64)
        return to_channels(difference, planes.by_others[:, rows, cols])

    def _seen(self, rows: IntArray, cols: IntArray) -> SeenDifference:
        """Between the mean colours of some pixels."""
        more = to_rgb(self._channels(rows, cols).mean(axis=1))
        own = self.light * self.own_dn[rows, cols].mean(axis=0, dtype=np.float64)
        before, after = (own - more, own) if self.is_after else (own, own + more)
        return SeenDifference.of(before, after, self.white_dn)


_LIT: Final = ("brighter", "darker")


def _is_lit(change: Change) -> bool:
    """Whether its luma has changed for sure, or that of a part of it."""
    return any(
        abs(one.amplitude_dn) > _SURELY * one.amplitude_err_dn
        for one in (change.parts or (change,))
    )


def _lightness(levels_dn: FloatImage, white_dn: float) -> FloatArray:
    """CIE 1976 lightness of levels that are linear in light."""
    share = np.clip(np.asarray(levels_dn) / max(white_dn, 1e-30), 0, None)
    cubic = np.cbrt(share)
    return np.asarray(np.where(share > (6 / 29) ** 3, 116 * cubic - 16, share * (29 / 3) ** 3))


def _groups(entries: Sequence[Entry], shape: tuple[int, int]) -> list[list[int]]:
    """Indices of entries that belong together."""
    if len(entries) == 1:
        return [[0]]
    reach = [_REACH * np.sqrt(entry.area_px) for entry in entries]
    wide: BoolArray = np.zeros(shape, dtype=np.bool_)
    kinds = np.maximum(np.searchsorted(_REACHES_PX, reach, side="right") - 1, 0)
    for kind, reach_px in enumerate(_REACHES_PX):
        mask = np.ones(shape, dtype=np.uint8)
        for index in np.flatnonzero(kinds == kind).tolist():
            mask[entries[index].pixels] = 0
        if not mask.all():
            wide |= cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_5) <= reach_px
    _, labels = cv2.connectedComponents(_filled(wide), connectivity=8)
    groups: dict[int, list[int]] = {}
    for index, entry in enumerate(entries):
        rows, cols = entry.pixels
        groups.setdefault(int(labels[rows[0], cols[0]]), []).append(index)
    return list(groups.values())


def _filled(mask: BoolArray) -> "cv2.typing.MatLike":
    """The mask with what its outlines enclose, where that is not much more than they are."""
    made = mask.astype(np.uint8)
    outlines, _ = cv2.findContours(made, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    for outline in outlines:
        left, top, width, height = cv2.boundingRect(outline)
        part = np.s_[top : top + height, left : left + width]
        inside = np.zeros((height, width), dtype=np.uint8)
        cv2.drawContours(inside, [outline], -1, 1, cv2.FILLED, offset=(-left, -top))
        own = np.count_nonzero(made[part] & inside)
        if np.count_nonzero(inside) <= _MOST_ENCLOSED * own:
            made[part] |= inside
    return made


def _as_movements(movements: Sequence[Entry], left: Sequence[Entry]) -> list[Entry]:
    """Movements by one displacement as one, the largest with what is left over beside them."""
    joined: list[list[Entry]] = []
    for entry in sorted(movements, key=lambda one: -one.area_px):
        for others in joined:
            if _apart_px(entry.change, others[0].change) < _SAME_SHIFT_PX:
                others.append(entry)
                break
        else:
            joined.append([entry])
    made = []
    for number, members in enumerate(joined):
        beside = [*members[1:], *(left if number == 0 else ())]
        area_px = sum(entry.change.area_px for entry in members)
        update = {
            "what": "moved",
            "area_px": area_px,
            "parts": tuple(entry.change for entry in beside),
        }
        regions = [region for entry in (members[0], *beside) for region in entry.regions]
        change = members[0].change.model_copy(update=update)
        made.append(Entry(change=change, regions=tuple(regions)))
    return made


def _is_enough(movements: Sequence[Entry], thing: Sequence[Entry]) -> bool:
    """Whether a thing has moved; a shift explains small parts of others by chance."""
    moved_px, area_px = (sum(entry.area_px for entry in some) for some in (movements, thing))
    return moved_px > _LEAST_MOVED * area_px


def _at_rest(entry: Entry) -> Entry:
    """A movement as a change that is none."""
    update = {"is_moved": False, "displacement_px": None, "displacement_err_px": None}
    return replace(entry, change=entry.change.model_copy(update=update))


def _apart_px(one: Change, other: Change) -> float:
    """Distance of two displacements."""
    if one.displacement_px is None or other.displacement_px is None:
        return inf
    return dist(one.displacement_px, other.displacement_px)


def _as_thing(group: Sequence[Entry], images: Images, in_colour: "_InColour | None") -> Entry:
    regions = tuple(region for entry in group for region in entry.regions)
    whole = Entry(change=group[0].change, regions=regions)
    update: dict[str, object] = {"what": _happened(whole, images, in_colour)}
    if len(group) > 1:
        parts = [entry.change for entry in group]
        first = max(parts, key=lambda one: _peak(one) * one.area_px**0.5)
        area_px = sum(one.area_px for one in parts)
        update |= {
            name: sum(getattr(one, name) * one.area_px for one in parts) / area_px
            for name in ("x_px", "y_px", "reference_x_px", "reference_y_px")
        }
        update |= {
            "area_px": area_px,
            "spot_sigma_px": float(np.sqrt(area_px / np.pi) / 2),
            "amplitude_dn": first.amplitude_dn,
            "amplitude_err_dn": first.amplitude_err_dn,
            "amplitude_rgb_dn": first.amplitude_rgb_dn,
            "significance": max(one.significance for one in parts),
            "q_value": min(one.q_value for one in parts),
            "parts": tuple(sorted(parts, key=lambda one: -one.significance)),
        }
    return Entry(change=whole.change.model_copy(update=update), regions=regions)


def _peak(change: Change) -> float:
    """Size of its amplitude; of colours that of the channel which changed most."""
    rgb = change.amplitude_rgb_dn
    return abs(change.amplitude_dn) if rgb is None else max(map(abs, rgb))


def _happened(thing: Entry, images: Images, in_colour: "_InColour | None") -> Happened:
    """Say what happened: gone and new only where one side is what surrounds it."""
    rows, cols = thing.pixels
    around = Surroundings.of(rows, cols, images.valid, _RING_PX, int(_RING_PX[1]) + 1)
    before, after = images.before_dn[rows, cols], images.after_dn[rows, cols]
    word: Happened = (
        "brighter" if float(np.mean(after - before, dtype=np.float64)) > 0 else "darker"
    )
    if _correlation(before, after) > _SAME_THING:
        return word
    least = float(np.mean(np.square(images.sd_dn[rows, cols], dtype=np.float64))) / 2
    sides = [
        np.asarray(image[around.crop], dtype=np.float64)
        for image in (images.before_dn, images.after_dn)
    ]
    stands_out = [around.structure(side, least) for side in sides]
    if min(stands_out) > _AS_PLAIN:
        return word
    if in_colour is not None:
        sides = in_colour.sides(around)
    steps = _steps(around, images.valid[around.crop], sides)
    more = np.log((steps[1] + least) / (steps[0] + least))
    # A word that is erased lay on paper, which goes on: its ink tells, its outline does not.
    more += _BY_STRUCTURE * np.log((stands_out[1] + 0.1) / (stands_out[0] + 0.1))
    steepness = [_steepness(around, side) for side in sides]
    more += _BY_STEEPNESS * np.log((steepness[1] + least) / (steepness[0] + least))
    if abs(more) < _CLEARLY:
        return word
    return "new" if more > 0 else "gone"


def _steepness(around: Surroundings, side: FloatArray) -> float:
    """Mean square slope beside the outline of a change."""
    inside_px: FloatArray = distance_transform_edt(around.inside)
    outline = (around.outside_px <= _BESIDE_PX) & (inside_px <= _BESIDE_PX)
    slope_y, slope_x = np.gradient(side, axis=0), np.gradient(side, axis=1)
    squares: FloatArray = np.square(slope_y) + np.square(slope_x)
    return float(np.mean(squares[outline]))


def _steps(around: Surroundings, valid: BoolArray, sides: Sequence[FloatArray]) -> list[float]:
    """Mean square step across the outline of a change, of each side.

    Where a thing lies, light steps at its outline; where it does not, what surrounds it goes on.
    Both have what surrounds it, which a step between equal distances does not tell apart.
    """
    inside_px = distance_transform_edt(around.inside)
    beside = (around.outside_px > 0) & (around.outside_px <= _BESIDE_PX) & valid
    y, x = np.nonzero(beside)
    nearest = distance_transform_edt(~around.inside, return_distances=False, return_indices=True)
    own_y, own_x = nearest[:, y, x]
    depth_px = min(_BEYOND_PX, float(inside_px.max()))
    along = depth_px / around.outside_px[y, x]
    within_y = np.rint(own_y + along * (own_y - y)).astype(np.int64)
    within_x = np.rint(own_x + along * (own_x - x)).astype(np.int64)
    last = np.subtract(around.inside.shape, 1)
    within_y, within_x = np.clip(within_y, 0, last[0]), np.clip(within_x, 0, last[1])
    counts = around.inside[within_y, within_x]
    if not counts.any():
        return [0.0] * len(sides)
    y, x, within_y, within_x = (at[counts] for at in (y, x, within_y, within_x))
    return [float(np.mean((side[y, x] - side[within_y, within_x]) ** 2)) for side in sides]


def _correlation(one: FloatImage, other: FloatImage) -> float:
    """Of levels at the same pixels; 0 where either has but one."""
    own, its = (levels - levels.mean(dtype=np.float64) for levels in (one, other))
    spread = float(np.sqrt(np.sum(own**2) * np.sum(its**2)))
    return float(np.sum(own * its)) / spread if spread > 0 else 0.0
