"""Tables I and II as text, CSV and LaTeX."""

import csv
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from io import StringIO
from typing import Any

from analysis.results_file import finite_or_null
from analysis.validation.metrics import ImageMetrics
from analysis.validation.models import ValidationModel
from analysis.validation.pair import PairValidation
from analysis.validation.processing import BACKGROUND_SIGMA_PX, FULL_SCALE_DN
from analysis.validation.session import METRICS, Validation, table_1, table_2

__all__ = [
    "PAPER_TABLE_1",
    "PAPER_TABLE_2",
    "TABLE_NOTES",
    "VALIDATION_SCHEMA",
    "PaperRow",
    "ResultTable",
    "both_tables",
    "curves_csv",
    "validation_document",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperRow:
    """One row of a table as printed; the attributes are named like those of ``ImageMetrics``."""

    correlation: float
    mse_dn2: float
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


_HEADINGS = ("correlation", "MSE", "NMI", "PSNR / dB", "SSIM")
_CSV_NAMES = ("correlation", "mse_dn2", "nmi", "psnr_db", "ssim")
_PAIR_NAMES = (
    "target",
    "orientation_deg",
    "reference_height_mm",
    "followup_height_mm",
    "zoom",
)
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
"""What the tables mean, for whoever reads them without the documentation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultTable:
    """One table, ready to be written in any form.

    ``rows`` are the alignment, the model and the figures as text; ``values`` the same figures in
    full. ``paper`` are the paper's own rows.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    values: tuple[tuple[float, ...], ...]
    value_names: tuple[str, ...]
    paper: tuple[tuple[str, ...], ...]

    def text(self) -> str:
        """Plain text, the paper's rows at the end."""
        lines = [self.columns, *self.rows, *self.paper]
        widths = [max(len(line[place]) for line in lines) for place in range(len(self.columns))]
        printed = [
            "  ".join(
                cell.ljust(width) if place < 2 else cell.rjust(width)
                for place, (cell, width) in enumerate(zip(line, widths, strict=True))
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
        writer.writerow(["alignment", "model", *self.value_names])
        for row, values in zip(self.rows, self.values, strict=True):
            writer.writerow([*row[:2], *(repr(value) for value in values)])
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
        places = "ll" + "r" * (len(self.columns) - 2)
        return (
            f"% {self.title}\n\\begin{{tabular}}{{{places}}}\n\\toprule\n{head} \\\\\n"
            f"\\midrule\n{body}\n\\bottomrule\n\\end{{tabular}}\n"
        )


def both_tables(validation: Validation) -> tuple[ResultTable, ResultTable]:
    """Tables I and II of a validation, the paper's rows below ours."""
    first, second = table_1(validation), table_2(validation)
    pairs = len(validation.pairs)
    return (
        ResultTable(
            name="table_1",
            title=(
                "Table I: mean squared difference between the captured and the simulated metric "
                f"curves, {pairs} pairs"
            ),
            columns=("alignment", "model", *_HEADINGS),
            rows=tuple((*row, *_cells(error, _DIGITS_1)) for row, error in first.items()),
            values=tuple(_values(error) for error in first.values()),
            value_names=_CSV_NAMES,
            paper=tuple(
                ("the paper's own", model, *_cells(row, _DIGITS_1))
                for model, row in PAPER_TABLE_1.items()
            ),
        ),
        ResultTable(
            name="table_2",
            title=(
                f"Table II: agreement of captured and simulated follow-ups, mean over {pairs} pairs"
            ),
            columns=("alignment", "model", *_HEADINGS, "PSNR of mean MSE / dB"),
            rows=tuple(
                (*row, *_cells(mean, _DIGITS_2), f"{mean.psnr_of_mean_db:.2f}")
                for row, mean in second.items()
            ),
            values=tuple((*_values(mean), mean.psnr_of_mean_db) for mean in second.values()),
            value_names=(*_CSV_NAMES, "psnr_of_mean_db"),
            paper=tuple(
                ("the paper's own", model, *_cells(row, _DIGITS_2), "")
                for model, row in PAPER_TABLE_2.items()
            ),
        ),
    )


def curves_csv(validation: Validation) -> str:
    """The points of Figure 3: one line for every pair and curve."""
    buffer = StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([*_PAIR_NAMES, "alignment", "model", *_CSV_NAMES])
    for pair in validation.pairs:
        place = [
            pair.reference.target,
            pair.reference.orientation_deg,
            pair.reference.height_mm,
            pair.followup.height_mm,
            repr(pair.registration.zoom),
        ]
        curves = {
            (str(alignment), "captured"): curve for alignment, curve in pair.captured_curves.items()
        }
        curves |= {(str(p), str(m)): one.curve for (p, m), one in pair.models.items()}
        for row, curve in curves.items():
            writer.writerow([*place, *row, *(repr(getattr(curve, name)) for name in METRICS)])
    return buffer.getvalue()


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


VALIDATION_SCHEMA = "standoff.validation/1"


def validation_document(validation: Validation, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return a validation as plain lists and numbers; ``facts`` are how it came about."""
    return {
        "schema": VALIDATION_SCHEMA,
        **facts,
        "processing": {
            "normalised_to_dn": [0.0, FULL_SCALE_DN],
            "background_sigma_px": BACKGROUND_SIGMA_PX,
            "crop": "centre half of each axis",
            "data_range_dn": FULL_SCALE_DN,
            "nmi_bins": 100,
            "ssim_window_px": 7,
        },
        "table_1": _rows({row: asdict(error) for row, error in table_1(validation).items()}),
        "table_2": _rows({row: asdict(mean) for row, mean in table_2(validation).items()}),
        "paper_table_1": {model: asdict(row) for model, row in PAPER_TABLE_1.items()},
        "paper_table_2": {model: asdict(row) for model, row in PAPER_TABLE_2.items()},
        "pairs": [_pair(pair) for pair in validation.pairs],
        "excluded": [
            {
                "capture": one.record.index,
                "target": one.record.target,
                "height_mm": one.record.height_mm,
                "reason": one.reason,
            }
            for one in validation.screening.excluded
        ],
        "remarks": list(validation.screening.remarks),
    }


def _rows(table: Mapping[tuple[str, str], dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        {"alignment": alignment, "model": model, **finite_or_null(values)}
        for (alignment, model), values in table.items()
    ]


def _pair(pair: PairValidation) -> dict[str, Any]:
    registration = pair.registration
    return {
        "target": pair.reference.target,
        "orientation_deg": pair.reference.orientation_deg,
        "reference": pair.reference.index,
        "followup": pair.followup.index,
        "reference_height_mm": pair.reference.height_mm,
        "followup_height_mm": pair.followup.height_mm,
        "zoom": registration.zoom,
        "homography": registration.pose.matrix.tolist(),
        "k1": registration.pose.k1,
        "k1_err": registration.k1_err,
        "place_err_px": registration.place_err_px,
        "match_rms_px": registration.match_rms_px,
        "matches": registration.inlier_count,
        "captured_curves": {
            alignment: _metrics(curve) for alignment, curve in pair.captured_curves.items()
        },
        "models": [
            {
                "alignment": alignment,
                "model": model,
                "curve": _metrics(one.curve),
                "agreement": _metrics(one.agreement),
            }
            for (alignment, model), one in pair.models.items()
        ],
    }


def _metrics(metrics: ImageMetrics) -> dict[str, Any]:
    return finite_or_null(asdict(metrics))
