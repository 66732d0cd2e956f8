"""Several follow-ups of one reference: the comparison of each, and each change over all of them.

Each follow-up is compared with the reference by itself, so tracks only say which entries of the
lists are one change of the scene, and how strong it can be where a list does not have it. The
documents are summary.json and series.json.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import hypot, pi, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol

import numpy as np
import tifffile
from pydantic import Field

from acquisition.dataframe import dataframe
from acquisition.untrusted import TIFF_DAMAGE
from analysis.changes import Change, ChangeSummary, read_changes
from analysis.detection_limits import DetectionLimit
from analysis.errors import ResultsFileError
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import read_document
from calibration.registration import DistortedPose
from simulation.arguments import FilePath, checked
from simulation.arrays import Float32Array, FloatArray

if TYPE_CHECKING:
    from pandas import DataFrame


_TIME_LINE_SCHEMA: Final = "standoff.changes-series/1"

_Sighting = Literal["seen", "not seen", "not compared"]


class TimeLineFollowup(StoredValues):
    """A follow-up of the time line.

    Parameters
    ----------
    followup, folder, taken
        The photograph, the folder of its results, and when it was taken according to its file.
    changes
        Number of changes in its list.
    detection_limit
        The least amplitudes that would have been found in it.
    """

    followup: str
    folder: str
    taken: str | None = None
    changes: int
    detection_limit: DetectionLimit | None = None


class TrackPoint(StoredValues):
    """A tracked change in one follow-up.

    Parameters
    ----------
    sighting
        ``seen`` if the follow-up's list has the change; ``not seen`` if it has not, although the
        place was compared; ``not compared`` if the place was not compared.
    x_px, y_px
        Place of the change in the follow-up; None where the follow-up does not show that place.
    amplitude_dn, amplitude_err_dn, significance
        As in the follow-up's list. Where the change is not seen: those of the difference at its
        place, the significance with the sign of the amplitude. None where it was not compared.
    upper_limit_dn
        Where the change is not seen: 95 % upper limit of its amplitude, in its direction.
    """

    sighting: _Sighting
    x_px: float | None = None
    y_px: float | None = None
    amplitude_dn: float | None = None
    amplitude_err_dn: float | None = None
    significance: float | None = None
    upper_limit_dn: float | None = None


class ChangeTrack(StoredValues):
    """One change of the scene over the follow-ups.

    Parameters
    ----------
    reference_x_px, reference_y_px
        Place of the change in the reference: the mean of the places where it was seen, weighted by
        significance^2.
    first_seen, last_seen
        The first and the last follow-up that lists it, as numbers from 0 in the order of the time
        line.
    points
        The change in each follow-up, in the order of the time line.
    """

    reference_x_px: float
    reference_y_px: float
    first_seen: int
    last_seen: int
    points: tuple[TrackPoint, ...]

    @property
    def seen(self) -> int:
        """Number of follow-ups that list the change."""
        return sum(point.sighting == "seen" for point in self.points)


class ChangeTimeLine(ResultsDocument):
    """Changes over the follow-ups of one reference.

    Parameters
    ----------
    reference
        Name of the reference.
    order
        ``time`` if the follow-ups are in the order of the times that their files state, ``path`` if
        in the order of their paths, because not all files state a time.
    followups
        Follow-ups that could be compared.
    tracks
        The changes, those seen in most follow-ups first, then the most significant.
    """

    schema_name: Literal["standoff.changes-series/1"] = Field(
        default=_TIME_LINE_SCHEMA, alias="schema"
    )
    reference: str
    order: Literal["time", "path"]
    followups: tuple[TimeLineFollowup, ...]
    tracks: tuple[ChangeTrack, ...]


@checked
def read_time_line(path: FilePath) -> ChangeTimeLine:
    """Read the series.json of ``standoff changes`` with several follow-ups.

    Parameters
    ----------
    path
        Path of the file, in the folder that ``find_changes_of_series`` wrote.

    Returns
    -------
    ChangeTimeLine
        The changes, each followed over all follow-ups.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> found = standoff.find_changes_of_series("before.tif", "after", "changes", "psf.json")
    >>> line = standoff.read_time_line(found.summary.with_name("series.json"))
    >>> [point.sighting for point in line.tracks[0].points]
    ['not seen', 'seen']
    """
    remedy = "write it with standoff changes and several follow-ups"
    return read_document(path, ChangeTimeLine, ResultsFileError, remedy)


_CHANGES_SERIES_SCHEMA: Final = "standoff.changes-summary/1"


class ComparedFollowup(StoredValues):
    """One follow-up: a row of changes.csv.

    Parameters
    ----------
    followup, sha256
        The file, and the hash of its bytes if it could be read.
    folder
        Folder of its results, beside summary.json.
    changed_px, compared_px, zoom, threshold_sd
        As in its changes.json; None if it could not be compared.
    refused
        Why it could not be compared; None if it could.
    changes, moved
        Number of changes in its list, and of movements, which are listed apart.
    taken
        When it was taken, according to its file.
    warnings
        The warnings of its changes.json, joined.
    reference
        In a series of pairs, the photograph that it was compared with.
    limit_spot_sigma_px, limit_median_dn, limit_p95_dn, limit_reached_fraction
        Detection limit for spots of this width: the amplitudes that suffice at half and at 95 % of
        the compared pixels, and the share of these pixels where the contrast that was asked about
        would have been found.
    """

    followup: str
    sha256: str | None = None
    folder: str | None = None
    changed_px: int | None = None
    compared_px: int | None = None
    zoom: float | None = None
    threshold_sd: float | None = None
    refused: str | None = None
    changes: int | None = None
    moved: int | None = None
    taken: str | None = None
    warnings: str | None = None
    reference: str | None = None
    limit_spot_sigma_px: float | None = None
    limit_median_dn: float | None = None
    limit_p95_dn: float | None = None
    limit_reached_fraction: float | None = None


def limit_columns(found: ChangeSummary) -> dict[str, float | None]:
    """Return the columns of a row that hold the detection limit; none for older files."""
    if found.detection_limit is None:
        return {}
    mapped = found.detection_limit.mapped
    return {
        "limit_spot_sigma_px": mapped.spot_sigma_px,
        "limit_median_dn": mapped.median_dn,
        "limit_p95_dn": mapped.p95_dn,
        "limit_reached_fraction": mapped.reached_fraction,
    }


class ChangesSeries(ResultsDocument):
    """Comparisons of follow-ups with one reference or with one each, in the order of their paths.

    For pairs, ``reference`` is the folder of the references. ``compared``, ``changed`` and
    ``refused`` are numbers of follow-ups; a changed one has at least one changed pixel, a refused
    one could not be compared. ``unpaired`` are photographs of either folder without a partner, or
    with several. The provenance lists the shared inputs; each follow-up has its own hash.
    """

    schema_name: Literal["standoff.changes-summary/1"] = Field(
        default=_CHANGES_SERIES_SCHEMA, alias="schema"
    )
    reference: str
    compared: int
    changed: int
    refused: int
    unpaired: tuple[str, ...] = ()
    followups: tuple[ComparedFollowup, ...] = ()

    def to_dataframe(self) -> "DataFrame":
        """Return the follow-ups as a pandas table, one row per follow-up.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(one.model_dump() for one in self.followups)


@checked
def read_changes_series(path: FilePath) -> ChangesSeries:
    """Read the summary.json of ``standoff changes`` with several follow-ups.

    Parameters
    ----------
    path
        Path of the file, in the folder that ``find_changes_of_series`` wrote.

    Returns
    -------
    ChangesSeries
        The figures of each follow-up.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> found = standoff.find_changes_of_series("before.tif", "after", "changes", "psf.json")
    >>> standoff.read_changes_series(found.summary).compared
    2
    """
    remedy = "write it with standoff changes and several follow-ups"
    return read_document(path, ChangesSeries, ResultsFileError, remedy)


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


class _TrackedFollowup(Protocol):
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


def track_changes(followups: Sequence[_TrackedFollowup]) -> tuple[ChangeTrack, ...]:
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


def _linked(tracks: list[_Track], number: int, followup: _TrackedFollowup) -> list[Change]:
    """Add changes to the tracks that they continue; return the others."""
    changes = list(followup.changes)
    if not tracks or not changes:
        return changes
    from scipy.spatial import cKDTree  # for whoever links, not for whoever reads

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


def _told(track: _Track, followups: Sequence[_TrackedFollowup]) -> ChangeTrack:
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


def _amplitude_over_reading(track: _Track, followups: Sequence[_TrackedFollowup]) -> float:
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
    followup: _TrackedFollowup, place: tuple[float, float], sign: float, scale: float
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
