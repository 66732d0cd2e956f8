"""Measured edges in the terminal: MTF50 in every unit, the widths of each, and the verdict."""

from calibration.psf import PsfCalibration
from calibration.sharpness import (
    MODEL_REMARK,
    VERDICT_COLUMNS,
    SharpnessVerdict,
    edge_cells,
    reported_mtf50,
    verdict_rows,
)
from standoff.terminal.output import print_table, say

_LISTED_MOST = 12
_AT_EITHER_END = 5


def print_edges(calibration: PsfCalibration) -> None:
    """Print every edge, or the softest and the sharpest of many, with 95 % uncertainties."""
    edges = calibration.edges_used
    if not edges:
        return
    ranked = sorted(edges, key=lambda edge: reported_mtf50(edge).cy_per_px)
    is_many = len(edges) > _LISTED_MOST
    shown = [*ranked[:_AT_EITHER_END], *ranked[-_AT_EITHER_END:]] if is_many else list(edges)
    has_image = len({edge.image for edge in calibration.edges}) > 1
    columns, rows = edge_cells(shown, calibration.pixel_pitch_um, has_image=has_image)
    if len(rows) == 1:
        [row] = rows
        print_table(
            f"Edge at {row[0]}",
            ["", "± at 95 %"],
            [[name, cell] for name, cell in zip(columns[1:], row[1:], strict=True)],
        )
    else:
        name = f"The {_AT_EITHER_END} softest and {_AT_EITHER_END} sharpest edges" * is_many
        print_table(f"{name or 'Edges'}, ± at 95 %", list(columns), [list(row) for row in rows])
    if is_many:
        middle = reported_mtf50(ranked[len(ranked) // 2]).cy_per_px
        say(
            f"median MTF50 of {len(edges)} edges: {middle:.4f} cy/px; psf.json and the table of "
            "--csv list them all"
        )
    _say_units(calibration, has_model=not all(reported_mtf50(e).is_model_free for e in shown))


def _say_units(calibration: PsfCalibration, *, has_model: bool) -> None:
    """Say what the units stand on: picture height and pixel pitch, and whose MTF50 is a model's."""
    height, pitch_um = calibration.picture_height_px, calibration.pixel_pitch_um
    parts = [
        "the picture height (PH) is that of each photograph"
        if height is None
        else f"picture height (PH) {height} px, the rows of the photograph",
        "pixel pitch unknown, so no lp/mm: give --pixel-pitch-um"
        if pitch_um is None
        else f"pixel pitch {pitch_um:g} µm ({calibration.pixel_pitch_from})",
    ]
    say("; ".join([*parts, MODEL_REMARK] if has_model else parts))


def print_verdict(verdict: SharpnessVerdict) -> None:
    """Print the verdict, and every limit with its figure."""
    print_table(
        f"Verdict by {verdict.limits_file}: {verdict.outcome}",
        list(VERDICT_COLUMNS[:-1]),
        [_with_place_first(*row) for row in verdict_rows(verdict)],
    )


def _with_place_first(limit: str, *others: str) -> list[str]:
    """The cells of a limit, with where it was measured beside its name: that column may wrap."""
    *figures, where = others
    return [f"{limit}: {where}" if where else limit, *figures]
