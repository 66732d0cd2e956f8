"""The document validation.json, its tables as text, CSV and LaTeX, and sentences on poor fits."""

import csv
import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from pydantic import Field

from acquisition.dataframe import dataframe
from acquisition.session import CaptureRecord
from analysis.choices import ValidationModel
from analysis.errors import ResultsFileError
from analysis.results_file import InfiniteAsNull, ResultsDocument, StoredValues
from analysis.validation._metrics import BACKGROUND_SIGMA_PX, FULL_SCALE_DN, ImageMetrics, Procedure
from calibration.documents import read_document
from calibration.registration import DistortedPose
from simulation import Psf
from simulation.arguments import FilePath, checked
from simulation.choices import POSE_MODELS, PsfForm
from simulation.notebook import html_table

if TYPE_CHECKING:
    from pandas import DataFrame


VALIDATION_SCHEMA: Final = "standoff.validation/1"

METRICS = ("correlation", "mse_dn2", "nmi", "psnr_db", "ssim")
"""The five metrics, as ``ImageMetrics`` names them."""

_Row3 = tuple[float, float, float]


class CurveDifference(StoredValues):
    """Mean squared differences between curves against zoom, one for each metric."""

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


class _PaperRow(StoredValues):
    """One row of a table as printed; the attributes are named like those of ``ImageMetrics``."""

    correlation: float
    mse_dn2: int
    nmi: float
    psnr_db: float
    ssim: float


PAPER_TABLE_1: dict[ValidationModel, _PaperRow] = {
    "bicubic": _PaperRow(correlation=0.0059, mse_dn2=22863, nmi=0.0256, psnr_db=53.8, ssim=0.062),
    "kernelgan": _PaperRow(correlation=0.0017, mse_dn2=5598, nmi=0.0062, psnr_db=16.1, ssim=0.013),
    "paper": _PaperRow(correlation=0.0004, mse_dn2=2320, nmi=0.0052, psnr_db=9.7, ssim=0.005),
}
"""Mean squared differences between the curves."""

PAPER_TABLE_2: dict[ValidationModel, _PaperRow] = {
    "bicubic": _PaperRow(correlation=0.953, mse_dn2=86, nmi=1.256, psnr_db=36.6, ssim=0.733),
    "kernelgan": _PaperRow(correlation=0.944, mse_dn2=104, nmi=1.213, psnr_db=34.8, ssim=0.677),
    "paper": _PaperRow(correlation=0.968, mse_dn2=64, nmi=1.275, psnr_db=37.8, ssim=0.760),
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
        Processed captured follow-up against the processed simulated one, averaged in Table II.
    """

    alignment: Procedure
    model: ValidationModel
    curve: ImageMetrics
    agreement: ImageMetrics


class ValidatedPair(StoredValues):
    """A pair of captures, their metrics, and those of every model and procedure.

    ``reference`` and ``followup`` are the indices of their captures. ``captured_curves`` compare
    the processed reference with the processed captured follow-up. ``chi2_reduced`` has, for each
    model, the mean square of captured minus simulated on the captured pixels, relative to what
    noise, PSF, focus, alignment and the model's stated error explain; it is empty if the noise of a
    capture is not known, and in older files.
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
    paper_table_1: dict[ValidationModel, _PaperRow] = PAPER_TABLE_1
    paper_table_2: dict[ValidationModel, _PaperRow] = PAPER_TABLE_2
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
        """Return the pairs as a pandas table, one row per pair, procedure and model.

        Metrics are in the columns ``agreement.NAME``, which Table II averages, and ``curve.NAME``,
        for Figure 3; ``chi2_reduced`` is that of the model, whatever the procedure.

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
        Path of the file, in the folder that ``validate`` or ``standoff validate`` wrote.

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


_FITS = 2.0
"""Reduced chi-squared up to which a model fits: what it states of its own error is an average."""

_NAMED = 3


def fit_remarks(pairs: Sequence[ValidatedPair], models: Sequence[ValidationModel]) -> Iterator[str]:
    """Say of the better of ``matched`` and ``lmmse`` in which pairs it does not fit.

    The other models leave more than physics needs, and say nothing of the captures.
    """
    physical = [model for model in models if model in POSE_MODELS]
    if not physical:
        return
    known = [pair for pair in pairs if pair.chi2_reduced]
    if not known:
        return
    if len(known) < len(pairs):
        yield (
            f"{len(pairs) - len(known)} of {len(pairs)} pairs have captures of a single frame: "
            "their noise is unknown, and therefore how well the models fit is unknown as well"
        )
    model = min(physical, key=lambda one: sum(pair.chi2_reduced[one] for pair in known))
    worst = sorted(known, key=lambda pair: -pair.chi2_reduced[model])
    beyond = [pair for pair in worst if pair.chi2_reduced[model] > _FITS]
    if not beyond:
        return
    named = ", ".join(
        f"{pair.target} {pair.reference_height_mm:g} to {pair.followup_height_mm:g} mm "
        f"({pair.chi2_reduced[model]:.1f})"
        for pair in beyond[:_NAMED]
    )
    more = "" if len(beyond) <= _NAMED else ", ..."
    yield (
        f"model {model} does not fit {len(beyond)} of {len(known)} pairs: the remaining difference "
        "is larger than noise, PSF, alignment and the model's own error explain; the worst "
        f"(reduced chi-squared): {named}{more}; check that the PSF is that of this lens, and check "
        "focus and light"
    )


_HEADINGS = ("correlation", "MSE", "NMI", "PSNR / dB", "SSIM")
_PAIR_NAMES = ("target", "orientation_deg", "reference_height_mm", "followup_height_mm", "zoom")
_DIGITS_1 = (6, 1, 6, 3, 5)
_DIGITS_2 = (4, 2, 4, 2, 4)

TABLE_NOTES = (
    "Processing: aligned, normalised to 0 to 255, a Gaussian of sigma 10 px subtracted, centre "
    "half. Correlation: Pearson's. MSE in squared levels of 255. NMI: (H(a) + H(b)) / H(a, b), in "
    "[1, 2], 100 bins. PSNR: data range 255, mean over pairs; beside it the PSNR of the mean MSE. "
    "SSIM: data range 255, 7 x 7 uniform window.",
    "as-in-paper: follow-ups are scaled up onto the reference's pixels by bicubic interpolation, "
    "captured ones by the homography of their features, simulated ones simply by the zoom. "
    "reference-grid: the same, but captured ones lie where features, pixels and the lens's "
    "distortion put them. followup-grid: simulated on the captured follow-up's own pixels.",
)
"""Explanation of the tables, for readers without the documentation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultTable:
    """One table, ready to be written in any form.

    ``rows`` are the alignment, the model and the figures as text; ``values`` the same figures in
    full, ``keys`` the alignment, the model and its training steps by themselves. ``paper`` are the
    paper's own rows.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    keys: tuple[tuple[str, str, int | None], ...]
    values: tuple[tuple[float, ...], ...]
    value_names: tuple[str, ...]
    paper: tuple[tuple[str, ...], ...]

    def text(self) -> str:
        """Plain text, the paper's rows at the end."""
        lines = [self.columns, *self.rows, *self.paper]
        widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
        printed = [
            "  ".join(
                cell.ljust(width) if column < 2 else cell.rjust(width)
                for column, (cell, width) in enumerate(zip(line, widths, strict=True))
            ).rstrip()
            for line in lines
        ]
        rule = "-" * max(map(len, printed))
        printed.insert(1, rule)
        printed.insert(2 + len(self.rows), rule)
        return "\n".join([self.title, "", *printed, "", *TABLE_NOTES]) + "\n"

    def csv(self) -> str:
        """Comma-separated figures in full; ours only."""
        buffer = StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(["alignment", "model", *self.value_names, "training_steps"])
        for (alignment, model, steps), values in zip(self.keys, self.values, strict=True):
            writer.writerow([alignment, model, *(repr(value) for value in values), steps])
        return buffer.getvalue()

    def latex(self) -> str:
        """A ``tabular`` with booktabs rules."""
        head = " & ".join(_escaped(column) for column in self.columns)
        blocks = [
            "\n".join(" & ".join(_escaped(cell) for cell in row) + r" \\" for row in rows)
            for rows in (self.rows, self.paper)
            if rows
        ]
        body = "\n\\midrule\n".join(blocks)
        alignment = "ll" + "r" * (len(self.columns) - 2)
        return (
            f"% {self.title}\n\\begin{{tabular}}{{{alignment}}}\n\\toprule\n{head} \\\\\n"
            f"\\midrule\n{body}\n\\bottomrule\n\\end{{tabular}}\n"
        )


def both_tables(validation: Validation) -> tuple[ResultTable, ResultTable]:
    """Tables I and II of a validation, the paper's rows below ours."""
    pairs = len(validation.pairs)
    return (
        ResultTable(
            name="table_1",
            title=(
                "Table I: mean squared difference between the captured and the simulated metric "
                f"curves, {pairs} pairs"
            ),
            columns=("alignment", "model", *_HEADINGS),
            rows=tuple(
                (row.alignment, row.label, *_cells(row, _DIGITS_1)) for row in validation.table_1
            ),
            keys=_keys(validation.table_1),
            values=tuple(_values(row) for row in validation.table_1),
            value_names=METRICS,
            paper=tuple(
                ("the paper's own", model, *_cells(row, _DIGITS_1))
                for model, row in validation.paper_table_1.items()
            ),
        ),
        ResultTable(
            name="table_2",
            title=(
                f"Table II: agreement of captured and simulated follow-ups, mean over {pairs} pairs"
            ),
            columns=("alignment", "model", *_HEADINGS, "PSNR of mean MSE / dB"),
            rows=tuple(
                (row.alignment, row.label, *_cells(row, _DIGITS_2), f"{row.psnr_of_mean_db:.2f}")
                for row in validation.table_2
            ),
            keys=_keys(validation.table_2),
            values=tuple((*_values(row), row.psnr_of_mean_db) for row in validation.table_2),
            value_names=(*METRICS, "psnr_of_mean_db"),
            paper=tuple(
                ("the paper's own", model, *_cells(row, _DIGITS_2), "")
                for model, row in validation.paper_table_2.items()
            ),
        ),
    )


def curves_csv(validation: Validation) -> str:
    """The points of Figure 3: one line for every pair and curve."""
    buffer = StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([*_PAIR_NAMES, "alignment", "model", *METRICS])
    for pair in validation.pairs:
        about = [
            pair.target,
            pair.orientation_deg,
            pair.reference_height_mm,
            pair.followup_height_mm,
            repr(pair.zoom),
        ]
        curves = {
            (str(alignment), "captured"): curve for alignment, curve in pair.captured_curves.items()
        }
        curves |= {(str(one.alignment), str(one.model)): one.curve for one in pair.models}
        for row, curve in curves.items():
            writer.writerow([*about, *row, *(repr(value) for value in _values(curve))])
    return buffer.getvalue()


def _keys(rows: Iterable[CurveDifferenceRow | MeanRow]) -> tuple[tuple[str, str, int | None], ...]:
    return tuple((row.alignment, row.model, row.training_steps) for row in rows)


def _values(row: object) -> tuple[float, ...]:
    return tuple(float(getattr(row, name)) for name in METRICS)


def _cells(row: object, digits: tuple[int, ...]) -> tuple[str, ...]:
    return tuple(_figure(value, count) for value, count in zip(_values(row), digits, strict=True))


def _figure(value: float, digits: int) -> str:
    """Fixed digits; small values keep three figures."""
    if value != 0 and abs(value) < 10 ** (2 - digits):
        return f"{value:.3g}"
    return f"{value:.{digits}f}"


def _escaped(text: str) -> str:
    return text.replace("\\", "").replace("_", r"\_").replace("%", r"\%").replace("&", r"\&")
