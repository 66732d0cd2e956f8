"""Changes of several follow-ups linked to tracks: the same place in the reference, the same sign.

Each follow-up is compared with the reference by itself, so tracks only say which entries of the
lists are one change of the scene, and how strong it can be where a list does not have it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import hypot, pi, sqrt
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from analysis.change_series.time_line import ChangeTrack, TrackPoint
from analysis.changes import Change
from simulation.arrays import FloatArray

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
