"""The document series.json: each change over several follow-ups of one reference."""

from typing import Final, Literal

from pydantic import Field

from analysis.detection_limits import DetectionLimit
from analysis.errors import ResultsFileError
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import read_document
from simulation.arguments import FilePath, checked

TIME_LINE_SCHEMA: Final = "standoff.changes-series/1"

Sighting = Literal["seen", "not seen", "not compared"]


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

    sighting: Sighting
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
        default=TIME_LINE_SCHEMA, alias="schema"
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
