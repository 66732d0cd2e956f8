"""Every edge of a calibration: as rows of a report's tables, and as CSV."""

import csv
from collections.abc import Sequence
from io import StringIO
from itertools import groupby

import numpy as np

from analysis.reports.page import ReportSection, ReportTable
from calibration.edges import SFR_FREQ_CY_PER_PX, EdgeMeasurement
from calibration.psf import PsfCalibration
from calibration.sharpness import MODEL_REMARK, edge_cells, edge_row

_EDGES_LISTED = 200
_EDGES_IN_FULL = 12


def edge_table_section(psf: PsfCalibration) -> ReportSection:
    """Tabulate the edges: their sharpness, and what there is to say of their quality.

    Those of several photographs stand in groups, each under the name of its photograph. A remark
    on all of them is said once.
    """
    edges = psf.edges[:_EDGES_LISTED]
    columns, cells = edge_cells(edges, psf.pixel_pitch_um, has_image=False)
    # A row of figures is one line high: no line breaks within a position.
    sharpness = tuple((name.replace(" ", "\u00a0"), *others) for name, *others in cells)
    shared: frozenset[str] = frozenset()
    if len(edges) > 1:
        shared = frozenset.intersection(*(frozenset(edge.flags) for edge in edges))
    quality = [_quality_cells(edge, shared) for edge in edges]
    text = ["An edge is named by its middle in px and the direction of its line."]
    if shared:
        text.append(f"Remarks on all edges: {_remarks(sorted(shared))}.")
    if any(" *" in cell for row in sharpness for cell in row):
        text.append(MODEL_REMARK)
    more = len(psf.edges) - len(edges)
    if more > 0:
        text.append(f"{more} more edges are in psf.json.")
    joined = list(zip(sharpness, quality, strict=True))
    tables: tuple[ReportTable, ...]
    if len(edges) <= _EDGES_IN_FULL:
        tables = (
            ReportTable(columns=columns, rows=_grouped(edges, sharpness), caption="Sharpness."),
            ReportTable(
                columns=("edge", *_QUALITY_COLUMNS),
                rows=_grouped(edges, [(one[0], *other) for one, other in joined]),
                caption="Quality.",
                ends_in_words=True,
            ),
        )
    else:  # a row each on one line: five pages at most
        text.append("psf.json and the table of --csv also have contrast, roughness and clipping.")
        kept = (0, 1, len(_QUALITY_COLUMNS) - 1)
        rows = [(*one[:-1], *(other[k] for k in kept)) for one, other in joined]
        tables = (
            ReportTable(
                columns=(*columns[:-1], *(_QUALITY_COLUMNS[k] for k in kept)),
                rows=_grouped(edges, rows),
                ends_in_words=True,
            ),
        )
    return ReportSection(title="All edges", text=tuple(text), is_folded=True, tables=tables)


def _grouped(
    edges: Sequence[EdgeMeasurement], rows: Sequence[tuple[str, ...]]
) -> tuple[tuple[str, ...], ...]:
    """The rows of edges, those of several photographs each under its name."""
    if len({edge.image for edge in edges}) < 2:
        return tuple(rows)
    found: list[tuple[str, ...]] = []
    pairs = zip(edges, rows, strict=True)
    for image, group in groupby(pairs, lambda pair: pair[0].image):
        found += [(image,), *(row for _, row in group)]
    return tuple(found)


def _quality_cells(edge: EdgeMeasurement, shared: frozenset[str]) -> tuple[str, ...]:
    return (
        f"{edge.length_px:.0f}",
        "over 9999" if edge.snr is None or edge.snr > 9999 else f"{edge.snr:.0f}",
        _optional(edge.contrast, ".2f"),
        _optional(edge.roughness_px, ".3f"),
        _percent(edge.clipped_fraction),
        "" if edge.chi2_reduced is None else f"{edge.chi2_reduced:.2f}",
        _remarks([flag for flag in edge.flags if flag not in shared]),
    )


def _remarks(flags: Sequence[str]) -> str:
    return ", ".join(flag.replace("_", " ") for flag in flags)


_QUALITY_COLUMNS = (
    "length / px",
    "SNR",
    "contrast",
    "roughness / px",
    "clipped / %",
    "reduced chi²",
    "remarks",
)


def _optional(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _percent(fraction: float | None) -> str:
    return "" if fraction is None else f"{100 * fraction:.2f}"


def edge_csv(calibration: PsfCalibration) -> str:
    """Return the table: the entries of psf.json for each edge, then its contrast by frequency.

    ``mtf50_...`` is the measured one, ``gaussian_mtf50_...`` the fitted Gaussian's.

    Columns ``sfr_0.05`` to ``sfr_0.50`` are the contrast left at that many cy/px, by the e-SFR.
    An empty cell is a value that is not determined; flags share one cell, separated by spaces.
    """
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    freq = np.array(SFR_FREQ_CY_PER_PX)
    for number, edge in enumerate(calibration.edges):
        row = edge_row(edge)
        if number == 0:
            writer.writerow([*row, "is_used", *(f"sfr_{f:.2f}" for f in SFR_FREQ_CY_PER_PX)])
        row["flags"] = " ".join(row["flags"])
        sfr = [""] * freq.size if edge.esfr is None else [f"{v:.6f}" for v in edge.esfr.at(freq)]
        writer.writerow([*row.values(), "yes" if edge.is_used else "no", *sfr])
    return text.getvalue()
