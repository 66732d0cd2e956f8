"""The document validation.json: the results of a validation."""

import hashlib
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from pydantic import Field

from acquisition.dataframe import dataframe
from acquisition.session import CaptureRecord
from analysis.choices import ValidationModel
from analysis.errors import ResultsFileError
from analysis.results_file import InfiniteAsNull, ResultsDocument, StoredValues
from analysis.validation.alignment import Procedure
from analysis.validation.metrics import ImageMetrics
from analysis.validation.processing import BACKGROUND_SIGMA_PX, FULL_SCALE_DN
from calibration.documents import read_document
from calibration.registration import DistortedPose
from simulation import Psf
from simulation.arguments import FilePath, checked
from simulation.choices import PsfForm
from simulation.notebook import html_table

if TYPE_CHECKING:
    from pandas import DataFrame

VALIDATION_SCHEMA: Final = "standoff.validation/1"

METRICS = ("correlation", "mse_dn2", "nmi", "psnr_db", "ssim")
"""The five metrics, as ``ImageMetrics`` names them."""

_Row3 = tuple[float, float, float]


class CurveDifference(StoredValues):
    """Mean squared differences between curves over the zoom, one for each metric."""

    correlation: float
    mse_dn2: float
    nmi: float
    psnr_db: InfiniteAsNull
    ssim: float
    pairs: int


class ModelMean(StoredValues):
    """Means over pairs; ``psnr_of_mean_db`` is the PSNR of the mean MSE."""

    correlation: float
    mse_dn2: float
    nmi: float
    psnr_db: InfiniteAsNull
    psnr_of_mean_db: InfiniteAsNull
    ssim: float
    pairs: int


class _Row(StoredValues):
    alignment: Procedure
    model: ValidationModel
    training_steps: int | None = None

    @property
    def label(self) -> str:
        """The model as a table names it: a learned one with the steps of its training."""
        steps = self.training_steps
        return self.model if steps is None else f"{self.model} ({steps} steps)"


# pydantic takes the fields of the last base first: a row begins with what it is about.
class CurveDifferenceRow(CurveDifference, _Row):
    """A row of Table I."""


class MeanRow(ModelMean, _Row):
    """A row of Table II."""


class PaperRow(StoredValues):
    """One row of a table as printed; the attributes are named like those of ``ImageMetrics``."""

    correlation: float
    mse_dn2: int
    nmi: float
    psnr_db: float
    ssim: float


PAPER_TABLE_1: dict[ValidationModel, PaperRow] = {
    "bicubic": PaperRow(correlation=0.0059, mse_dn2=22863, nmi=0.0256, psnr_db=53.8, ssim=0.062),
    "kernelgan": PaperRow(correlation=0.0017, mse_dn2=5598, nmi=0.0062, psnr_db=16.1, ssim=0.013),
    "paper": PaperRow(correlation=0.0004, mse_dn2=2320, nmi=0.0052, psnr_db=9.7, ssim=0.005),
}
"""Mean squared differences between the curves."""

PAPER_TABLE_2: dict[ValidationModel, PaperRow] = {
    "bicubic": PaperRow(correlation=0.953, mse_dn2=86, nmi=1.256, psnr_db=36.6, ssim=0.733),
    "kernelgan": PaperRow(correlation=0.944, mse_dn2=104, nmi=1.213, psnr_db=34.8, ssim=0.677),
    "paper": PaperRow(correlation=0.968, mse_dn2=64, nmi=1.275, psnr_db=37.8, ssim=0.760),
}
"""Means over pairs of captured and simulated follow-ups."""


class Processing(StoredValues):
    """What was done to the images before they were compared, and how the metrics were set."""

    normalised_to_dn: tuple[float, float] = (0.0, FULL_SCALE_DN)
    background_sigma_px: float = BACKGROUND_SIGMA_PX
    crop: str = "centre half of each axis"
    data_range_dn: float = FULL_SCALE_DN
    nmi_bins: int = 100
    ssim_window_px: int = 7


class ModelAgreement(StoredValues):
    """Results of one model with one procedure.

    Parameters
    ----------
    alignment, model
        The procedure and the model.
    curve
        Processed reference against the processed simulated follow-up, aligned to it: a point of
        the curves of Figure 3.
    agreement
        Processed captured follow-up against the processed simulated one: what Table II averages.
    """

    alignment: Procedure
    model: ValidationModel
    curve: ImageMetrics
    agreement: ImageMetrics


class ValidatedPair(StoredValues):
    """A pair of captures, their metrics, and those of every model and procedure.

    ``reference`` and ``followup`` are the indices of their captures. ``captured_curves`` compare
    the processed reference with the processed captured follow-up. ``chi2_reduced`` has for each
    model the mean square of captured minus simulated over what noise, PSF, focus, alignment and the
    model's stated error explain, on the captured pixels; it is empty where the noise of a capture
    is not known, and in files of before.
    """

    target: str
    orientation_deg: float
    reference: int
    followup: int
    reference_height_mm: float
    followup_height_mm: float
    zoom: float
    homography: tuple[_Row3, _Row3, _Row3]
    k1: float
    k1_err: float
    place_err_px: float
    match_rms_px: float
    matches: int
    captured_curves: dict[Procedure, ImageMetrics]
    models: tuple[ModelAgreement, ...]
    chi2_reduced: dict[ValidationModel, float] = Field(default_factory=dict)

    def of(self, alignment: Procedure, model: ValidationModel) -> ModelAgreement:
        """Return the results of a model with a procedure."""
        return next(one for one in self.models if (one.alignment, one.model) == (alignment, model))

    def pose(
        self, reference_shape: tuple[int, int], followup_shape: tuple[int, int]
    ) -> DistortedPose:
        """Return the pose of the follow-up; the shapes are those of the captures."""
        return DistortedPose(
            matrix=np.array(self.homography),
            k1=self.k1,
            reference_shape=reference_shape,
            followup_shape=followup_shape,
        )


class ExcludedCapture(StoredValues):
    """An excluded capture, and why."""

    capture: int
    target: str
    height_mm: float
    reason: str

    @classmethod
    def of(cls, record: CaptureRecord, reason: str) -> "ExcludedCapture":
        """Exclude the capture of a record."""
        return cls(
            capture=record.index, target=record.target, height_mm=record.height_mm, reason=reason
        )

    @property
    def text(self) -> str:
        """The exclusion as one line of text."""
        return f"capture {self.capture} ({self.target} at {self.height_mm:g} mm): {self.reason}"


class Validation(ResultsDocument):
    """All pairs of a session with their metrics, both tables, and what was excluded."""

    schema_name: Literal["standoff.validation/1"] = Field(default=VALIDATION_SCHEMA, alias="schema")
    session: str
    psf: str
    psf_covariance_px2: tuple[tuple[float, float], tuple[float, float]]
    psf_form: PsfForm = "gaussian"
    psf_sha256: str | None = None
    models: tuple[ValidationModel, ...]
    references_per_target: int
    training_steps: int
    training_seed: int
    processing: Processing = Processing()
    table_1: tuple[CurveDifferenceRow, ...]
    table_2: tuple[MeanRow, ...]
    paper_table_1: dict[ValidationModel, PaperRow] = PAPER_TABLE_1
    paper_table_2: dict[ValidationModel, PaperRow] = PAPER_TABLE_2
    pairs: tuple[ValidatedPair, ...]
    excluded: tuple[ExcludedCapture, ...]
    remarks: tuple[str, ...]

    def __repr__(self) -> str:
        means = ", ".join(
            f"{model} {mean.mse_dn2:.2f}" for model, mean in self.means("followup-grid").items()
        )
        return f"<Validation of {len(self.pairs)} pairs: MSE {means}>"

    def _repr_html_(self) -> str:
        columns = ("alignment", "model", "MSE / DN²", "SSIM")
        rows = [
            (row.alignment, row.model, f"{row.mse_dn2:.4g}", f"{row.ssim:.4g}")
            for row in self.table_2
        ]
        return html_table(repr(self)[1:-1], columns, rows)

    def means(self, alignment: Procedure) -> dict[ValidationModel, MeanRow]:
        """Return the rows of Table II of one procedure."""
        return {row.model: row for row in self.table_2 if row.alignment == alignment}

    def to_dataframe(self) -> "DataFrame":
        """Return the pairs as a pandas table, a line for each pair, procedure and model.

        Metrics stand in ``agreement.NAME`` (what Table II averages) and ``curve.NAME`` (Figure 3);
        ``chi2_reduced`` is of the model, whatever the procedure.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.

        Examples
        --------
        >>> tables = standoff.validate("session", "psf.json", "validation", models=["matched"])
        >>> tables.to_dataframe().groupby(["target", "model"])["agreement.mse_dn2"].mean().shape
        (1,)
        """
        left_out = {"models", "captured_curves", "homography", "chi2_reduced"}
        return dataframe(
            {
                **pair.model_dump(exclude=left_out),
                **one.model_dump(),
                "chi2_reduced": pair.chi2_reduced.get(one.model),
            }
            for pair in self.pairs
            for one in pair.models
        )

    def is_of(self, psf: Psf) -> bool:
        """Whether the follow-ups were simulated with this PSF."""
        return self.psf_sha256 == psf_sha256(psf)


def psf_sha256(psf: Psf) -> str:
    """Return a digest of all the numbers of a PSF."""
    return hashlib.sha256(repr(psf).encode()).hexdigest()


@checked
def read_validation(path: FilePath) -> Validation:
    """Read a validation.json.

    Parameters
    ----------
    path
        Of the file, in the folder of ``validate`` and ``standoff validate``.

    Returns
    -------
    Validation
        All pairs with their metrics, and both tables.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> tables = standoff.validate("session", "psf.json", "validation", models=["matched"])
    >>> len(standoff.read_validation("validation/validation.json").pairs) == len(tables.pairs)
    True
    """
    return read_document(path, Validation, ResultsFileError, "write it with standoff validate")
