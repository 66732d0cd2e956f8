"""The list of changes, each with its place, amplitude and size, and what is too small for it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
from scipy.spatial import cKDTree

from analysis.changes._colour import Steps, to_luma_red_blue
from analysis.changes._comparison import Comparison
from analysis.changes._document import Change
from analysis.changes._levels import DetectionLevel, LevelColours
from analysis.changes._photograph_pair import ChangeOptions
from analysis.changes._regions import LinkedRegion, q_values
from analysis.changes._spot_fit import NEIGHBOUR_REACH, FittedSpot, SmoothedField, fit_spot
from calibration.registration import DistortedPose
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray

_SURE = 2.0
"""Times the height of the strongest of many values of noise, by which a peak must be higher."""

_MARGIN_PX = 16.0
"""Beside what a fit reaches of the pixels around a region."""

_CLEAR = 10.0
"""Standard deviations of a peak from which an outline at half of it is clear of the noise."""

_OUTLINE_WIDTHS = 2.0
"""Widths of the smoothing around its pixels that a change's outline is looked for in."""

_MOST_FITTED = 300
"""Changes whose shape is fitted; a frame with more is another scene, and the rest get levels."""


def list_changes(
    regions: Sequence[LinkedRegion],
    levels: Sequence[DetectionLevel],
    compared: Comparison,
    pose: DistortedPose,
) -> tuple[Change, ...]:
    """Describe changes, in their order.

    ``regions``: what stands out, the most significant first. ``levels``: the difference behind each
    width, the narrowest first. ``pose``: of the follow-up in the reference: gives the places in the
    photograph that is not the grid.
    """
    if not regions:
        return ()
    spots = _fitted(regions, levels, compared)
    colours = [spot.amplitude_rgb_dn if isinstance(spot, _ColourSpot) else None for spot in spots]
    y, x = np.array([(spot.y_px, spot.x_px) for spot in spots]).T
    area_px = np.array([spot.area_px for spot in spots])
    sigma_px = np.array([spot.sigma_px for spot in spots])
    # Places (y, x) in both photographs.
    if compared.is_on_followup:
        followup, reference = (y, x), pose.to_reference_px(y, x)
    else:
        followup, reference = pose.to_followup_px(y, x), (y, x)
        scale = _followup_px_by_pixel(pose.plane, y, x)
        area_px, sigma_px = area_px * scale, sigma_px * np.sqrt(scale)
    heights = np.abs([region.significance for region in regions])
    compared_px = int(np.count_nonzero(compared.valid))
    q_value = q_values(heights, compared_px, [level.filter_width for level in levels])
    columns = np.stack(
        [followup[1], followup[0], reference[1], reference[0], area_px, sigma_px, heights, q_value],
        axis=1,
    )
    return tuple(
        Change(
            x_px=row[0],
            y_px=row[1],
            reference_x_px=row[2],
            reference_y_px=row[3],
            area_px=row[4],
            spot_sigma_px=row[5],
            amplitude_dn=spot.amplitude_dn,
            amplitude_err_dn=spot.amplitude_err_dn,
            significance=row[6],
            q_value=row[7],
            amplitude_rgb_dn=rgb,
        )
        for row, spot, rgb in zip(columns.tolist(), spots, colours, strict=True)
    )


def _fitted(
    regions: Sequence[LinkedRegion], levels: Sequence[DetectionLevel], compared: Comparison
) -> list[FittedSpot]:
    fields = [SmoothedField.of_comparison(compared), *map(SmoothedField.of, levels)]
    colours = None if compared.colours is None else _ColourFields.of(compared, levels)
    at = np.array([(region.row, region.col) for region in regions])
    tree = cKDTree(at)
    spots: list[FittedSpot] = []
    for index, region in enumerate(regions):
        # One level narrower than the one that finds it best: there its shape is still seen.
        number = region.level if region.level > 1 else 0
        field = fields[number]
        part = None
        if colours is not None:
            part = colours.around(region, NEIGHBOUR_REACH * field.width_px)
        if index >= _MOST_FITTED:
            spots.append(
                _as_it_stands(region, fields)
                if part is None
                else part.spot(_as_it_stands(part.region, part.fields))
            )
            continue
        near = tree.query_ball_point(at[index], NEIGHBOUR_REACH * field.width_px)
        others = np.array([other for other in near if other != index], dtype=np.int64)
        distance = np.linalg.norm(at[others] - at[index], axis=1)
        nearest = at[others[np.argsort(distance, kind="stable")]]
        if part is None:
            spots.append(_described(region, fields, number, nearest))
            continue
        spots.append(part.spot(_described(part.region, part.fields, number, nearest - part.origin)))
    return spots


def _described(
    region: LinkedRegion, fields: Sequence[SmoothedField], number: int, nearest: IntArray
) -> FittedSpot:
    """A spot where that is what the change is, else its outline, with the peak that was fitted."""
    found = fit_spot(fields[number], (region.row, region.col), nearest)
    if found is None:
        return _as_it_stands(region, fields)
    return found if found.is_whole else _with_outline(found, region, fields)


def _as_it_stands(region: LinkedRegion, fields: Sequence[SmoothedField]) -> FittedSpot:
    """Take the strongest place for the peak of a change that is no spot, its outline for the rest.

    Of the fields that are no wider than the one that finds it best, the one that is surest of the
    peak tells: the narrower ones have the more noise, the wider ones less of what is narrow. A disc
    has the second moments of a Gaussian half as wide as its radius.
    """
    peak = max(_peaks(region, fields), key=lambda one: one.surely_dn)
    spot = FittedSpot(
        y_px=float(peak.row * peak.field.step_px),
        x_px=float(peak.col * peak.field.step_px),
        amplitude_dn=float(peak.field.difference_dn[peak.row, peak.col]),
        amplitude_err_dn=float(peak.field.sd_dn[peak.row, peak.col]),
        sigma_px=0.0,
        area_px=0.0,
    )
    return _with_outline(spot, region, fields)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Peak:
    """The strongest place of a change in a field, its standard deviations, and its sure part."""

    field: SmoothedField
    row: int
    col: int
    height: float
    surely_dn: float


def _peaks(region: LinkedRegion, fields: Sequence[SmoothedField]) -> list[_Peak]:
    """Those of a change in the fields no wider than the one that finds it best, narrowest first."""
    peaks = []
    for field in fields[: region.level + 2]:
        last = np.subtract(field.valid.shape, 1)
        rows = np.minimum(np.rint(region.rows / field.step_px).astype(np.int64), last[0])
        cols = np.minimum(np.rint(region.cols / field.step_px).astype(np.int64), last[1])
        counts = field.valid[rows, cols]
        if not counts.any():
            continue
        rows, cols = rows[counts], cols[counts]
        sd_dn = field.sd_dn[rows, cols]
        signed = field.difference_dn[rows, cols] * np.sign(region.significance)
        top = int(np.argmax(signed / sd_dn))
        independent = len(region.rows) / (4 * np.pi * field.width_px**2)
        chance = np.sqrt(2 * np.log(max(independent, math.e)))
        peaks.append(
            _Peak(
                field=field,
                row=int(rows[top]),
                col=int(cols[top]),
                height=float(signed[top] / sd_dn[top]),
                surely_dn=float(signed[top] - _SURE * chance * sd_dn[top]),
            )
        )
    assert peaks, "a region has pixels that were compared"
    return peaks


def _with_outline(
    spot: FittedSpot, region: LinkedRegion, fields: Sequence[SmoothedField]
) -> FittedSpot:
    """The change with the middle, the area and the width of what lies within its outline.

    The narrowest field in which noise hardly moves the outline shows it; smoothing only widens it.
    """
    peaks = _peaks(region, fields)
    clear = [one for one in peaks if one.height > _CLEAR]
    peak = clear[0] if clear else max(peaks, key=lambda one: one.surely_dn)
    rows, cols = _outlined(region, peak.field)
    return replace(
        spot,
        y_px=float(rows.mean()),
        x_px=float(cols.mean()),
        sigma_px=math.sqrt(len(rows) / math.pi) / 2,
        area_px=float(len(rows)),
    )


def _outlined(region: LinkedRegion, field: SmoothedField) -> tuple[IntArray, IntArray]:
    """Pixels ``(rows, cols)`` of the grid within the outline of a change.

    Blur and smoothing spread light to either side of an outline alike, so that it lies where the
    difference has half of what it has inside; the pixels beyond a threshold reach as much further
    as the change is stronger. What it has inside is the median of what exceeds half the peak, which
    is high by chance where there is noise.
    """
    step = field.step_px
    margin = math.ceil(_OUTLINE_WIDTHS * field.width_px) + step
    places = np.stack([region.rows, region.cols])
    first = np.maximum(places.min(axis=1) - margin, 0)
    end = np.minimum(places.max(axis=1) + margin, (np.array(field.valid.shape) - 1) * step) + 1
    own = np.zeros(end - first, dtype=np.bool_)
    rows, cols = places - first[:, None]
    seen = (rows < own.shape[0]) & (cols < own.shape[1])
    own[rows[seen], cols[seen]] = True
    signed = np.where(field.valid, field.difference_dn, 0) * np.float32(
        np.sign(region.significance)
    )
    light = cv2.warpAffine(
        np.asarray(signed, dtype=np.float32),
        np.array([[1 / step, 0, first[1] / step], [0, 1 / step, first[0] / step]]),
        (own.shape[1], own.shape[0]),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    highest = light[own].max(initial=0)
    # Of the other sign in this field, or in rows that it is too coarse for: what was marked is all.
    if highest <= 0:
        return region.rows, region.cols
    level = np.median(light[own & (light > highest / 2)])
    above = light > level / 2
    _, labels = cv2.connectedComponents(above.astype(np.uint8), connectivity=8)
    rows, cols = np.nonzero(above & np.isin(labels, np.unique(labels[above & own])))
    return rows + first[0], cols + first[1]


def _followup_px_by_pixel(pose: DistortedPose, y: FloatArray, x: FloatArray) -> FloatArray:
    """Follow-up pixels that one pixel of the reference covers."""
    down = np.subtract(pose.to_followup_px(y + 0.5, x), pose.to_followup_px(y - 0.5, x))
    right = np.subtract(pose.to_followup_px(y, x + 0.5), pose.to_followup_px(y, x - 0.5))
    return np.asarray(np.abs(down[0] * right[1] - down[1] * right[0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class _ColourSpot(FittedSpot):
    """A change of colour; ``amplitude_dn`` is its luma."""

    amplitude_rgb_dn: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _RegionFields:
    """The fields around a region, along its direction.

    ``fields``: the comparison and the levels, from ``origin`` on. ``region``: with its places from
    there on; positive. ``origin``: row and column of the first pixel. ``rgb``: red, green and blue
    of an amplitude of 1; the largest is 1. ``luma_err``: standard error of the luma's amplitude
    over that of the amplitude.
    """

    fields: tuple[SmoothedField, ...]
    region: LinkedRegion
    origin: IntArray
    rgb: FloatArray
    luma_err: float

    def spot(self, found: FittedSpot) -> _ColourSpot:
        """What was found there, in the frame's pixels and in levels."""
        red, green, blue = (found.amplitude_dn * self.rgb).tolist()
        luma = float(to_luma_red_blue(self.rgb)[0])
        return _ColourSpot(
            y_px=found.y_px + float(self.origin[0]),
            x_px=found.x_px + float(self.origin[1]),
            amplitude_dn=found.amplitude_dn * luma,
            amplitude_err_dn=found.amplitude_err_dn * self.luma_err,
            sigma_px=found.sigma_px,
            area_px=found.area_px,
            amplitude_rgb_dn=(red, green, blue),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Places:
    """What a `SmoothedField` is made of along any direction; places are ``step_px`` apart."""

    colours: LevelColours
    valid: BoolArray
    step_px: int
    smoothing: float

    def around(self, first: IntArray, last: IntArray, rgb: FloatArray) -> SmoothedField:
        """The part of it between two pixels of the grid."""
        (top, left), (bottom, right) = first // self.step_px, last // self.step_px + 1
        part = np.s_[top:bottom, left:right]
        amplitude_dn, error_dn = self.colours.part(part).along(rgb)
        return SmoothedField(
            step_px=self.step_px,
            smoothing=self.smoothing,
            difference_dn=amplitude_dn,
            sd_dn=error_dn,
            valid=self.valid[part],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _ColourFields:
    """A comparison in colour and its levels."""

    levels: tuple[DetectionLevel, ...]
    fields: tuple[_Places, ...]
    shape: tuple[int, int]

    @classmethod
    def of(cls, compared: Comparison, levels: Sequence[DetectionLevel]) -> Self:
        """Take every pixel of the difference, and places of the levels a width of theirs apart."""
        planes = compared.colours
        assert planes is not None, "photographs in colour"
        own = _colours_of(levels[0])
        whole = replace(
            own, difference_dn=planes.difference_dn, sd_dn=planes.sd_dn, by_others=planes.by_others
        )
        fields = [
            _Places(colours=whole, valid=compared.valid, step_px=1, smoothing=compared.smoothing_px)
        ]
        for level in levels:
            every = max(round(level.width_px / level.step_px), 1)
            part = np.s_[::every, ::every]
            fields.append(
                _Places(
                    colours=_colours_of(level)
                    .part(part)
                    .strict_as(1 / level.filter_width.allowance),
                    valid=level.valid[part],
                    step_px=level.step_px * every,
                    smoothing=level.width_px / (level.step_px * every),
                )
            )
        rows, cols = compared.valid.shape
        return cls(levels=tuple(levels), fields=tuple(fields), shape=(rows, cols))

    def around(self, region: LinkedRegion, reach_px: float) -> _RegionFields:
        """The fields so far around a region, along its direction."""
        assert region.direction is not None, "a region of colours"
        level = self.levels[region.level]
        colours = _colours_of(level)
        row, col = (
            min(round(place / level.step_px), most - 1)
            for place, most in zip((region.row, region.col), level.valid.shape, strict=True)
        )
        rgb = colours.change_dn(region.direction, (row, col))
        rgb = rgb / np.abs(rgb).max()
        margin = int(reach_px + _MARGIN_PX)
        fields = self.fields[: region.level + 2]
        whole = math.lcm(*(field.step_px for field in fields))
        at = np.stack([region.rows, region.cols])
        first = np.maximum(at.min(axis=1) - margin, 0) // whole * whole
        last = np.minimum(at.max(axis=1) + margin, np.subtract(self.shape, 1))
        here = colours.part(np.s_[row : row + 1, col : col + 1])
        return _RegionFields(
            fields=tuple(field.around(first, last, rgb) for field in fields),
            region=replace(
                region,
                row=region.row - int(first[0]),
                col=region.col - int(first[1]),
                rows=region.rows - first[0],
                cols=region.cols - first[1],
                significance=abs(region.significance),
            ),
            origin=first,
            rgb=rgb,
            luma_err=float(here.sd_dn[0, 0, 0] / here.error_along(rgb)[0, 0]),
        )


def _colours_of(level: DetectionLevel) -> LevelColours:
    """Colours of a level that has them."""
    assert level.colours is not None, "photographs in colour"
    return level.colours


def large_enough(changes: Sequence[Change], options: ChangeOptions, gain: float) -> BoolArray:
    """Tell the changes whose amplitude is at least what was asked for, or the files' step there.

    Of colours those of which any channel's is. ``gain``: of light, follow-up over reference:
    amplitudes are in the follow-up's levels.
    """
    if options.colours is not None and any(one.amplitude_rgb_dn for one in changes):
        steps = options.colours.step_dn
        return np.array([_of_colour(change, options.least_dn, steps, gain) for change in changes])
    amplitudes = np.abs([change.amplitude_dn for change in changes])
    if options.least_dn is not None:
        return np.asarray(amplitudes >= options.least_dn)
    reference, followup = options.step_dn
    least = [
        max(
            _step_at(followup, change.y_px, change.x_px),
            gain * _step_at(reference, change.reference_y_px, change.reference_x_px),
        )
        for change in changes
    ]
    return np.asarray(amplitudes >= np.array(least))


def _of_colour(change: Change, least_dn: float | None, steps_dn: Steps, gain: float) -> bool:
    amplitudes = np.abs(change.amplitude_rgb_dn or (change.amplitude_dn,) * 3)
    if least_dn is not None:
        return bool((amplitudes >= least_dn).any())
    reference, followup = (
        (0.0, 0.0, 0.0)
        if one is None
        else [_step_at(one[..., number], y, x) for number in range(3)]
        for one, y, x in zip(
            steps_dn,
            (change.reference_y_px, change.y_px),
            (change.reference_x_px, change.x_px),
            strict=True,
        )
    )
    return bool((amplitudes >= np.maximum(followup, gain * np.array(reference))).any())


def _step_at(step_dn: Float32Array | None, y_px: float, x_px: float) -> float:
    if step_dn is None:
        return 0.0
    rows, cols = step_dn.shape
    row, col = min(max(round(y_px), 0), rows - 1), min(max(round(x_px), 0), cols - 1)
    return float(step_dn[row, col])
