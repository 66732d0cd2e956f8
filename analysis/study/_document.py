"""study.json: predicted errors of a planned session, and what it would take to reduce them."""

from typing import TYPE_CHECKING, Final, Literal

from pydantic import Field

from acquisition.dataframe import dataframe
from analysis.errors import ResultsFileError
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import read_document
from simulation.arguments import FilePath, checked
from simulation.notebook import html_table

if TYPE_CHECKING:
    from pandas import DataFrame


STUDY_SCHEMA: Final = "standoff.study/1"

Quantity = Literal[
    "sigma_x_px",
    "sigma_y_px",
    "transfer_x",
    "transfer_y",
    "pupil_offset_mm",
    "d_prime",
    "tilt_limit_deg",
]

NAMES: dict[Quantity, str] = {
    "sigma_x_px": "sigma along x / px",
    "sigma_y_px": "sigma along y / px",
    "transfer_x": "transfer along x at 0.25 cy/px",
    "transfer_y": "transfer along y at 0.25 cy/px",
    "pupil_offset_mm": "pupil offset / mm",
    "d_prime": "d' at zoom 1.5",
    "tilt_limit_deg": "tilt limit / degrees",
}
"""What the quantities are called in a table."""


class BudgetShare(StoredValues):
    """Share of a source in the variance of a predicted error."""

    source: str
    share: float


class PredictedQuantity(StoredValues):
    """One quantity with its predicted standard error and 95 % interval.

    ``value`` is the value known today, null if none is; ``undetermined`` says why there is no
    error. ``half_width_95`` is half the interval: 1.96 standard errors, or Student's quantile where
    the calibration will estimate the scatter of the heights.
    """

    quantity: Quantity
    value: float | None
    err: float | None = None
    relative_err: float | None = None
    half_width_95: float | None = None
    interval_95: tuple[float, float] | None = None
    budget: tuple[BudgetShare, ...] = ()
    undetermined: str | None = None


class StudyNeeds(StoredValues):
    """Changes of the plan that would give a wanted error, each one alone; null if it cannot.

    ``frames_per_capture`` and ``edges`` replace those of the plan, ``session_runs`` is how often to
    run the whole plan, ``photographs`` the number of photographs of the scene in all. With
    ``is_together``, all changes that are not null are needed together.
    """

    frames_per_capture: int | None = None
    edges: int | None = None
    session_runs: int | None = None
    photographs: int | None = None
    is_together: bool = False


class StudiedWant(StoredValues):
    """A wanted 95 % half-width: relative for sigma, transfer and d', else in the quantity's unit.

    ``predicted`` is the half-width that the plan gives; null where it gives none.
    """

    quantity: str
    wanted: float
    is_relative: bool
    predicted: float | None
    reached: bool
    needs: StudyNeeds
    sentence: str


class PlanStudy(ResultsDocument):
    """Predicted errors of a planned capture session, and what the wanted errors would take."""

    schema_name: Literal["standoff.study/1"] = Field(default=STUDY_SCHEMA, alias="schema")
    predicted: tuple[PredictedQuantity, ...]
    wants: tuple[StudiedWant, ...]
    next_step: str
    d_ln_dprime_d_ln_sigma: float | None = None
    d_ln_dprime_d_ln_noise: float | None = None
    captures: int
    frames_per_capture: int
    edges: int
    photographs: int
    assumptions: tuple[str, ...] = ()
    notes: tuple[str, ...] = Field(default=(), exclude=True, repr=False)

    def of(self, quantity: Quantity) -> PredictedQuantity:
        """Return the prediction for one quantity."""
        return next(one for one in self.predicted if one.quantity == quantity)

    def to_dataframe(self) -> "DataFrame":
        """Return the predicted quantities as a pandas table, one row per quantity.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(one.model_dump() for one in self.predicted)

    def __repr__(self) -> str:
        return f"<PlanStudy: {self.captures} captures, {self.edges} edges. {self.next_step}>"

    def _repr_html_(self) -> str:
        rows = [
            (
                NAMES[one.quantity],
                "unknown" if one.value is None else f"{one.value:.5g}",
                one.undetermined or f"{one.half_width_95:.2g}",
            )
            for one in self.predicted
        ]
        return html_table(self.next_step, ("quantity", "value", "± at 95 %"), rows)


@checked
def read_study(path: FilePath) -> PlanStudy:
    """Read a study.json.

    Parameters
    ----------
    path
        Path of the file, as ``write_study`` and ``standoff plan-study`` write it.

    Returns
    -------
    PlanStudy
        The study, without its ``notes``, which are not stored in the file.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> study = standoff.plan_study("session.toml", "bench.toml", "psf.json")
    >>> standoff.write_study("study.json", study)
    >>> standoff.read_study("study.json") == study
    True
    """
    return read_document(path, PlanStudy, ResultsFileError, "write it with standoff plan-study")
