"""The document summary.json of several follow-ups whose poses were judged."""

from typing import TYPE_CHECKING, Final, Literal, Self

from pydantic import Field

from acquisition.dataframe import dataframe
from analysis.choices import Criterion
from analysis.detectability import CurveChoice
from analysis.errors import ResultsFileError
from analysis.pose.decision import Verdict
from analysis.pose.quality import PoseSummary
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import read_document
from simulation.arguments import FilePath, checked

if TYPE_CHECKING:
    from pandas import DataFrame


POSE_SERIES_SCHEMA: Final = "standoff.pose-summary/1"

_Row3 = tuple[float, float, float]


class JudgedFollowup(StoredValues):
    """One follow-up: a line of poses.csv, which leaves out the homography.

    Parameters
    ----------
    followup, sha256
        The file, and the hash of its bytes if it could be read.
    is_accepted, dprime_decisive, dprime_min, dprime_max, zoom_min, zoom_max, anisotropy_max,
    overlap, beyond_curve, registration_correlation, homography, verdict, probability
        As in `PoseSummary`; None if it could not be judged.
    refused
        Why it could not.
    """

    followup: str
    sha256: str | None = None
    is_accepted: bool | None = None
    dprime_decisive: float | None = None
    dprime_min: float | None = None
    dprime_max: float | None = None
    zoom_min: float | None = None
    zoom_max: float | None = None
    anisotropy_max: float | None = None
    overlap: float | None = None
    beyond_curve: float | None = None
    registration_correlation: float | None = None
    verdict: Verdict | None = None
    probability: float | None = None
    homography: tuple[_Row3, _Row3, _Row3] | None = None
    refused: str | None = None

    @classmethod
    def of(cls, followup: str, sha256: str | None, judged: PoseSummary) -> Self:
        """Take the verdict's own figures."""
        own = judged.model_dump(include=set(cls.model_fields))
        return cls(followup=followup, sha256=sha256, **own)


class PoseSeries(ResultsDocument):
    """Several follow-ups of one reference, in the order of their paths.

    ``accepted``, ``rejected`` and ``refused`` are numbers of follow-ups; a refused one could not
    be read or registered, and ``unsure`` counts those accepted or rejected without being sure. The
    provenance lists what they share; each follow-up has its own hash.
    """

    schema_name: Literal["standoff.pose-summary/1"] = Field(
        default=POSE_SERIES_SCHEMA, alias="schema"
    )
    reference: str
    criterion: Criterion
    min_dprime: float
    curve: CurveChoice
    is_upper_bound: bool = True
    accepted: int
    rejected: int
    refused: int
    unsure: int | None = None
    followups: tuple[JudgedFollowup, ...] = ()

    def to_dataframe(self) -> "DataFrame":
        """Return the follow-ups as a pandas table, a line each.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(one.model_dump() for one in self.followups)


@checked
def read_pose_series(path: FilePath) -> PoseSeries:
    """Read the summary.json of ``standoff pose`` with several follow-ups.

    Parameters
    ----------
    path
        Of the file, in the folder of ``judge_poses``.

    Returns
    -------
    PoseSeries
        A verdict for each follow-up.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> judged = standoff.judge_poses("before.tif", "after", "poses", "curves.json", 2)
    >>> standoff.read_pose_series(judged.summary).accepted
    2
    """
    remedy = "write it with standoff pose and several follow-ups"
    return read_document(path, PoseSeries, ResultsFileError, remedy)
