"""Changes of several follow-ups linked to tracks: the same place in the reference, the same sign.

Each follow-up is compared with the reference by itself, so tracks only say which entries of the
lists are one change of the scene, and how strong it can be where a list does not have it.

The comparisons of a series as they lie on disk, and the time line of their changes.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import hypot, pi, sqrt
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import tifffile
from scipy.spatial import cKDTree

from acquisition.untrusted import TIFF_DAMAGE
from analysis.change_series.time_line import (
    ChangesSeries,
    ChangeTimeLine,
    ChangeTrack,
    ComparedFollowup,
    TimeLineFollowup,
    TrackPoint,
)
from analysis.changes import Change, ChangeSummary, read_changes
from analysis.errors import ResultsFileError
from calibration.registration import DistortedPose
from simulation.arrays import Float32Array, FloatArray

_PLACE_ERR_PX = 0.5
"""Rms of a change's place along an axis, px of the coarser photograph, at 10 deviations."""

_REACH_SIGMAS = 4.0
"""Of the distance between two places: one in 3,000 pairs of the same change is further apart."""

_ONE_SIDED_95 = 1.645


@dataclass(frozen=True, slots=True)
class PlaceReading:
    """What the maps of a comparison say at a place of the follow-up.

    ``significance`` is signed, after minus before; ``sd_dn`` is the standard deviation of the
    difference there.
    """

    significance: float
    sd_dn: float


class TrackedFollowup(Protocol):
    """One follow-up of a series as the tracks need it."""

    @property
    def changes(self) -> Sequence[Change]:
        """The list of its changes."""
        ...

    @property
    def zoom(self) -> float:
        """Reference pixels per follow-up pixel."""
        ...

    def place_of(self, reference_x_px: float, reference_y_px: float) -> tuple[float, float]:
        """Return the place ``(x, y)`` in the follow-up of one in the reference."""
        ...

    def reading_at(self, x_px: float, y_px: float) -> PlaceReading | None:
        """Return what the maps say there; None where nothing was compared."""
        ...


@dataclass(slots=True)
class _Track:
    """Entries of the lists by the numbers of their follow-ups."""

    seen: dict[int, Change] = field(default_factory=dict)

    @property
    def sign(self) -> float:
        return float(np.sign(next(iter(self.seen.values())).amplitude_dn))

    @property
    def place(self) -> tuple[float, float]:
        weights = [change.significance**2 for change in self.seen.values()]
        x = [change.reference_x_px for change in self.seen.values()]
        y = [change.reference_y_px for change in self.seen.values()]
        return float(np.average(x, weights=weights)), float(np.average(y, weights=weights))

    @property
    def strength(self) -> float:
        return max(change.significance for change in self.seen.values())


def track_changes(followups: Sequence[TrackedFollowup]) -> tuple[ChangeTrack, ...]:
    """Link the changes of follow-ups, given in the order of the time line.

    A change continues the nearest track of its sign within reach; of several that could, nearer
    pairs come first, and a track takes one change of a follow-up. The reach is four standard
    deviations of the distance between two places, and the change's own radius where that is
    larger, as the strongest place of something extended may be anywhere in it.
    """
    tracks: list[_Track] = []
    for number, followup in enumerate(followups):
        left = _linked(tracks, number, followup)
        tracks += [_Track({number: change}) for change in left]
    tracks.sort(key=lambda track: (-len(track.seen), -track.strength, track.place))
    return tuple(_told(track, followups) for track in tracks)


def _linked(tracks: list[_Track], number: int, followup: TrackedFollowup) -> list[Change]:
    """Add changes to the tracks that they continue; return the others."""
    changes = list(followup.changes)
    if not tracks or not changes:
        return changes
    places = np.array([track.place for track in tracks])
    tree = cKDTree(places)
    own = np.array([(change.reference_x_px, change.reference_y_px) for change in changes])
    reaches_px = np.array([_reach_px(change, followup.zoom) for change in changes])
    pairs = [
        (hypot(*(places[at] - own[k])), k, at)
        for k, near in enumerate(tree.query_ball_point(own, reaches_px))
        for at in near
        if tracks[at].sign * changes[k].amplitude_dn > 0
    ]
    taken: set[int] = set()
    continued: set[int] = set()
    for _, k, at in sorted(pairs):
        if k not in taken and at not in continued:
            taken.add(k)
            continued.add(at)
            tracks[at].seen[number] = changes[k]
    return [change for k, change in enumerate(changes) if k not in taken]


def _reach_px(change: Change, zoom: float) -> float:
    """How far in the reference the same change may be listed."""
    # Places scatter by pixels of the coarser photograph.
    scatter_px = _REACH_SIGMAS * sqrt(2.0) * _PLACE_ERR_PX * max(zoom, 1.0)
    return max(scatter_px, zoom * sqrt(change.area_px / pi))


def _told(track: _Track, followups: Sequence[TrackedFollowup]) -> ChangeTrack:
    scale = _amplitude_over_reading(track, followups)
    x, y = track.place
    points = tuple(
        _seen(track.seen[number])
        if number in track.seen
        else _not_seen(followup, (x, y), track.sign, scale)
        for number, followup in enumerate(followups)
    )
    return ChangeTrack(
        reference_x_px=x,
        reference_y_px=y,
        first_seen=min(track.seen),
        last_seen=max(track.seen),
        points=points,
    )


def _amplitude_over_reading(track: _Track, followups: Sequence[TrackedFollowup]) -> float:
    """Amplitude of the change over the smoothed difference at its strongest place.

    It is the change's own, so that a limit is for a change of the same shape.
    """
    ratios: FloatArray = np.array(
        [
            abs(change.amplitude_dn) / (abs(reading.significance) * reading.sd_dn)
            for number, change in track.seen.items()
            if (reading := followups[number].reading_at(change.x_px, change.y_px)) is not None
            and reading.significance * reading.sd_dn != 0
        ]
    )
    return float(np.median(ratios)) if len(ratios) else 1.0


def _seen(change: Change) -> TrackPoint:
    return TrackPoint(
        sighting="seen",
        x_px=change.x_px,
        y_px=change.y_px,
        amplitude_dn=change.amplitude_dn,
        amplitude_err_dn=change.amplitude_err_dn,
        significance=change.significance,
    )


def _not_seen(
    followup: TrackedFollowup, place: tuple[float, float], sign: float, scale: float
) -> TrackPoint:
    x_px, y_px = followup.place_of(*place)
    reading = followup.reading_at(x_px, y_px)
    if reading is None:
        return TrackPoint(sighting="not compared")
    err_dn = scale * reading.sd_dn
    amplitude_dn = reading.significance * err_dn
    return TrackPoint(
        sighting="not seen",
        x_px=x_px,
        y_px=y_px,
        amplitude_dn=amplitude_dn,
        amplitude_err_dn=err_dn,
        significance=abs(reading.significance),
        upper_limit_dn=max(sign * amplitude_dn, 0.0) + _ONE_SIDED_95 * err_dn,
    )


@dataclass(frozen=True, kw_only=True)
class _StoredComparison:
    """A follow-up's results as the tracks need them; its maps stay on disk."""

    row: ComparedFollowup
    summary: ChangeSummary
    folder: Path
    reference_shape: tuple[int, int]

    @property
    def changes(self) -> tuple[Change, ...]:
        return self.summary.changes

    @property
    def zoom(self) -> float:
        return self.summary.zoom

    def place_of(self, reference_x_px: float, reference_y_px: float) -> tuple[float, float]:
        y_px, x_px = self._pose.to_followup_px(np.array(reference_y_px), np.array(reference_x_px))
        return float(x_px), float(y_px)

    def reading_at(self, x_px: float, y_px: float) -> PlaceReading | None:
        if not np.isfinite([x_px, y_px]).all():
            return None
        row, col = round(y_px), round(x_px)
        rows, cols = self._sd_dn.shape
        if not (0 <= row < rows and 0 <= col < cols) or not self._sd_dn[row, col] > 0:
            return None
        sd_dn = float(self._sd_dn[row, col])
        # Not significance.tif, which is of the width at which each place stands out most.
        return PlaceReading(significance=float(self._difference_dn[row, col]) / sd_dn, sd_dn=sd_dn)

    @cached_property
    def _pose(self) -> DistortedPose:
        rows, cols = self._sd_dn.shape
        return DistortedPose(
            matrix=np.array(self.summary.homography),
            k1=self.summary.distortion_k1,
            reference_shape=self.reference_shape,
            followup_shape=(rows, cols),
        )

    @cached_property
    def _difference_dn(self) -> Float32Array:
        return _mapped(self.folder / "difference.tif")

    @cached_property
    def _sd_dn(self) -> Float32Array:
        return _mapped(self.folder / "uncertainty.tif")


def time_line_of(
    out: Path,
    series: ChangesSeries,
    rows: Iterable[Mapping[str, Any]],
    reference_shape: tuple[int, ...],
) -> ChangeTimeLine:
    """Return the time line of the changes of all follow-ups that could be compared.

    ``reference_shape``: ``(rows, cols)`` of the reference that all share.
    """
    rows_px, cols_px = reference_shape[:2]
    given = [ComparedFollowup.model_validate(row) for row in rows if row["refused"] is None]
    is_by_time = bool(given) and all(one.taken for one in given)
    if is_by_time:
        given.sort(key=lambda one: (one.taken or "", one.followup))
    stored = [_stored(out, one, (rows_px, cols_px)) for one in given]
    return ChangeTimeLine(
        reference=series.reference,
        order="time" if is_by_time else "path",
        followups=tuple(
            TimeLineFollowup(
                followup=one.row.followup,
                folder=one.row.folder or "",
                taken=one.row.taken,
                changes=len(one.changes),
                detection_limit=one.summary.detection_limit,
            )
            for one in stored
        ),
        tracks=track_changes(stored),
        provenance=series.provenance,
    )


def _stored(out: Path, row: ComparedFollowup, shape: tuple[int, int]) -> _StoredComparison:
    folder = out / (row.folder or "")
    return _StoredComparison(
        row=row, summary=read_changes(folder / "changes.json"), folder=folder, reference_shape=shape
    )


def _mapped(path: Path) -> Float32Array:
    """The pixels of a map, of which only those that are looked at are read."""
    try:
        mapped: Any = tifffile.memmap(path, mode="r")
    except TIFF_DAMAGE as error:
        raise ResultsFileError(
            f"{path}: not a map of standoff changes", source=str(path)
        ) from error
    return np.asarray(mapped)
