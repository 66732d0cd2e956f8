"""The document series.json: each change over several follow-ups of one reference.

The document summary.json of several follow-ups that were compared with one reference.
"""

from typing import TYPE_CHECKING, Final, Literal

from pydantic import Field

from acquisition.dataframe import dataframe
from analysis.changes import ChangeSummary
from analysis.detection_limits import DetectionLimit
from analysis.errors import ResultsFileError
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import read_document
from simulation.arguments import FilePath, checked

if TYPE_CHECKING:
    from pandas import DataFrame


_TIME_LINE_SCHEMA: Final = "standoff.changes-series/1"

_Sighting = Literal["seen", "not seen", "not compared"]


class TimeLineFollowup(StoredValues):
    """A follow-up of the time line.

    Parameters
    ----------
    followup, folder, taken
        The photograph, the folder of its results, and when it was taken as its file says.
    changes
        How many changes it has.
    detection_limit
        What would have been found in it.
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
        Whether the follow-up's list has it, its place was compared without its being listed, or
        its place was not compared.
    x_px, y_px
        Its place in the follow-up; None where that does not show it.
    amplitude_dn, amplitude_err_dn, significance
        Of the list; where it is not seen, of what stands at its place, with the sign of the
        amplitude. None where it was not compared.
    upper_limit_dn
        Where it is not seen, the amplitude in its direction that is excluded at 95 %.
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
        Its place in the reference, the mean of where it was seen, weighted by significance^2.
    first_seen, last_seen
        Follow-ups that list it, as numbers from 0 in the order of the time line.
    points
        One for each follow-up, in their order.
    """

    reference_x_px: float
    reference_y_px: float
    first_seen: int
    last_seen: int
    points: tuple[TrackPoint, ...]

    @property
    def seen(self) -> int:
        """In how many follow-ups it is listed."""
        return sum(point.sighting == "seen" for point in self.points)


class ChangeTimeLine(ResultsDocument):
    """Changes over the follow-ups of one reference.

    Parameters
    ----------
    reference
        The reference.
    order
        Whether the follow-ups are in the order of the times that all their files state, or of
        their paths.
    followups
        Those that could be compared.
    tracks
        The longest seen first, then the most significant.
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
        Of the file, in the folder of ``find_changes_of_series``.

    Returns
    -------
    ChangeTimeLine
        Each change over the follow-ups.

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
    """One follow-up: a line of changes.csv.

    Parameters
    ----------
    followup, sha256
        The file, and the hash of its bytes if it could be read.
    folder
        Folder of its results, beside summary.json.
    changed_px, compared_px, zoom, threshold_sd
        As in its changes.json; None if it could not be compared.
    refused
        Why it could not.
    changes, moved
        How many changes its list has, and how many movements beside them.
    taken
        When it was taken, as its file says.
    warnings
        Those of its changes.json, one after the other.
    reference
        Of a folder of pairs, the photograph that it was compared with.
    limit_spot_sigma_px, limit_median_dn, limit_p95_dn, limit_reached_fraction
        Its detection limit: for spots of this width, at half and at 95 % of the compared pixels,
        and the share of them where a contrast that was asked about would have been found.
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
    """Return the columns of a line that hold the detection limit; none for files of before."""
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
    """Several follow-ups of one reference, or a folder of pairs, in the order of their paths.

    Of pairs, ``reference`` is the folder of the references. ``compared``, ``changed`` and
    ``refused`` are numbers of follow-ups; a changed one has at least one changed pixel.
    ``unpaired`` are photographs of either folder without a partner, or with several. The
    provenance lists what they share; each follow-up has its own hash.
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
        """Return the follow-ups as a pandas table, a line each.

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
        Of the file, in the folder of ``find_changes_of_series``.

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
