"""The document summary.json of several follow-ups that were compared with one reference."""

from typing import TYPE_CHECKING, Final, Literal

from pydantic import Field

from acquisition.dataframe import dataframe
from analysis.changes import ChangeSummary
from analysis.errors import ResultsFileError
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import read_document
from simulation.arguments import FilePath, checked

if TYPE_CHECKING:
    from pandas import DataFrame


CHANGES_SERIES_SCHEMA: Final = "standoff.changes-summary/1"


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
        default=CHANGES_SERIES_SCHEMA, alias="schema"
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
