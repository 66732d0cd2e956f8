"""Tables I and II as text, CSV and LaTeX."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from io import StringIO

from analysis.validation.document import METRICS, CurveDifferenceRow, MeanRow, Validation

_HEADINGS = ("correlation", "MSE", "NMI", "PSNR / dB", "SSIM")
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
                (
                    row.alignment,
                    row.label,
                    *_cells(row, _DIGITS_2),
                    f"{row.psnr_of_mean_db:.2f}",
                )
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


def _keys(
    rows: Iterable[CurveDifferenceRow | MeanRow],
) -> tuple[tuple[str, str, int | None], ...]:
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
