"""Tables: a PSF with its edges and their verdict, a validation, a series of photographs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from typer import BadParameter

from calibration.edges import REJECTING_FLAGS
from calibration.estimate import NORMAL_95, with_reach
from calibration.psf import FEWEST_FIELD_EDGES, Estimate, PsfCalibration
from calibration.sharpness import (
    MODEL_REMARK,
    VERDICT_COLUMNS,
    SharpnessVerdict,
    edge_cells,
    median_of_edges,
    reported_mtf50,
    verdict_rows,
)
from standoff.errors import ApplicationError
from standoff.terminal._declaration import answer, wants_json
from standoff.terminal._output import (
    note,
    note_once,
    print_items,
    print_json_file,
    print_table,
    say,
)

if TYPE_CHECKING:
    from analysis.results_file import StoredValues
    from analysis.sweep import SweepOptions, SweepSummary
    from analysis.validation import Validation
    from standoff.library import SeriesResult

Listed = TypeVar("Listed", bound="StoredValues")

_LISTED_MOST = 12
_AT_EITHER_END = 5


def print_psf(calibration: PsfCalibration) -> None:
    """Print widths and correlation, and what they are based on."""
    _print_source(calibration)
    total, optical = calibration.total, calibration.optical
    print_table(
        "PSF",
        ["", "total", "95 % interval", "optical", "95 % interval"],
        [
            [name, *_cells(with_pixel), *_cells(lens)]
            for name, with_pixel, lens in (
                ("sigma_x / px", total.sigma_x_px, optical.sigma_x_px),
                ("sigma_y / px", total.sigma_y_px, optical.sigma_y_px),
                ("rho", total.rho, optical.rho),
            )
            if with_pixel is not None
        ],
    )
    if calibration.transfer_2d is not None:
        say(f"measured transfer: {calibration.transfer_2d}")
    if calibration.channels is not None:
        print_items(
            "Colours",
            calibration.channels.items(),
            {
                "": lambda row: row[0],
                "total sigma_x / px": lambda row: _cells(row[1].total.sigma_x_px)[0],
                "total sigma_y / px": lambda row: _cells(row[1].total.sigma_y_px)[0],
                "edges": lambda row: "" if row[1].edge_count is None else str(row[1].edge_count),
            },
        )
    if calibration.field is not None and calibration.field.worst_err is not None:
        say(
            "the PSF changes over the frame: psf.json holds its field, with every width known to "
            f"± {100 * NORMAL_95 * calibration.field.worst_err:.1f} % (95 %) or better"
        )
    elif calibration.no_field_because and len(calibration.edges_used) >= FEWEST_FIELD_EDGES:
        say(f"no PSF field: {calibration.no_field_because}")
    if calibration.softness_px2 is not None:
        say(f"the scene's own edges have a mean blur of {calibration.softness_px2**0.5:.2f} px")
        note(
            "one image cannot tell a soft scene from a soft lens; the intervals assume a scene "
            "with edges sharper than a pixel; --method two-distance does better"
        )


def _print_source(calibration: PsfCalibration) -> None:
    """Print the pairs, or how many edges counted."""
    if calibration.pairs:
        print_items(
            "Pairs, ± at 95 %",
            calibration.pairs,
            {
                "near": lambda pair: Path(pair.near).name,
                "far": lambda pair: Path(pair.far).name,
                "zoom": lambda pair: f"{pair.zoom:.4f}",
                "sigma_x / px": lambda pair: with_reach(
                    pair.sigma_x_px, NORMAL_95 * pair.sigma_x_err_px, 4
                ),
                "sigma_y / px": lambda pair: with_reach(
                    pair.sigma_y_px, NORMAL_95 * pair.sigma_y_err_px, 4
                ),
            },
        )
    elif calibration.softness_px2 is not None:
        from calibration.blind import is_clear  # with what optimises a scene's edges, .1 s

        clear = sum(is_clear(edge) for edge in calibration.edges)
        say(f"{clear} of {len(calibration.edges)} edges are clear enough")
    else:
        used = f"{len(calibration.edges_used)} of {len(calibration.edges)} edges used"
        say("; ".join([used, *_left_out(calibration)]))


def _left_out(calibration: PsfCalibration) -> list[str]:
    """Why edges are left out, the commonest first; each edge counts once, with all its flags."""
    counted = Counter(
        " and ".join(sorted(REJECTING_FLAGS.intersection(edge.flags)))
        for edge in calibration.edges
        if not edge.is_used
    )
    if not counted:
        return []
    ordered = sorted(counted.items(), key=lambda one: (-one[1], one[0]))
    return ["left out: " + ", ".join(f"{count} {flag}" for flag, count in ordered)]


def _cells(estimate: Estimate | None) -> list[str]:
    if estimate is None:
        return ["not determined", ""]
    return [f"{estimate.value:.4f}", f"{estimate.low:.4f} to {estimate.high:.4f}"]


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
        facts = [*zip(columns[1:], row[1:], strict=True)]
        print_table(f"Edge at {row[0]}", ["", "± at 95 %"], facts)
    else:
        name = f"The {_AT_EITHER_END} softest and {_AT_EITHER_END} sharpest edges" * is_many
        print_table(f"{name or 'Edges'}, ± at 95 %", columns, rows)
    if is_many:
        middle = median_of_edges(edges).value
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
        VERDICT_COLUMNS[:-1],
        [_with_place_first(*row) for row in verdict_rows(verdict)],
    )


def _with_place_first(limit: str, *others: str) -> list[str]:
    """The cells of a limit, with where it was measured beside its name: that column may wrap."""
    *figures, where = others
    return [f"{limit}: {where}" if where else limit, *figures]


def print_validation(validation: Validation) -> None:
    """Print both tables, the paper's rows below ours."""
    from analysis.validation import both_tables

    for table in both_tables(validation):
        print_table(table.title, table.columns, [*table.rows, *table.paper])


def value_cells(
    value: float | None, err: float | None, digits: int, factor: float = NORMAL_95
) -> list[str]:
    """The cells of a value and of half its 95 % interval, ``factor`` standard errors."""
    if value is None or err is None:
        return ["not determined", ""]
    return [f"{value:.{digits}f}", f"{factor * err:.{digits}f}"]


def refuse_sweep_of_one(options: SweepOptions, *, parquet: bool) -> None:
    """Refuse options that have no meaning for one photograph; one worker does for it."""
    given = {
        "--scheduler": options.scheduler is not None,
        "--shard": options.part != (1, 1),
        "--parquet": parquet,
    }
    for option in (name for name, is_given in given.items() if is_given):
        raise BadParameter(f"{option} needs several follow-ups, or a folder of them")


def show_series(
    found: SeriesResult[Any, Any],
    options: SweepOptions,
    out: Path,
    show: Callable[[Any], None],
    others: str,
) -> None:
    """Show the results of several follow-ups, or of a part; ``others`` is said if some are refused.

    ``show`` shows their document to people.
    """
    note_once(found.notes)
    sweep = found.sweep
    if found.document is None:
        say_part(options, sweep, f"follow-ups done, {sweep.refused} refused", out=out)
    elif wants_json():
        print_json_file(found.summary)
    else:
        show(found.document)
    is_cut = sweep.refused > len(sweep.refused_lines)
    listed = f" ({sweep.refused_list} lists them)" if is_cut else ""
    count = f"{sweep.refused} of {sweep.images + sweep.refused} follow-ups"
    _end_refused(sweep, f"{count} gave nothing{listed}; {others}")


def print_few(
    found: SeriesResult[Any, Listed],
    cells: Mapping[str, Callable[[Listed], str]],
    title_of_worst: str,
) -> None:
    """Print a table of all follow-ups, or tables of the first and of the worst few of many."""
    print_items("First follow-ups" if found.worst else "Follow-ups", found.first, cells)
    if found.worst:
        print_items(title_of_worst, found.worst, cells)


def say_part(
    options: SweepOptions,
    sweep: SweepSummary,
    what: str,
    *,
    writes: str = "",
    out: Path | None = None,
) -> None:
    """Tell of one of several parts, while others are not done: ``sweep`` counts ``what``.

    ``writes`` is what the command does once all parts are done; without it the last part writes
    tables, into ``out``.
    """
    shard = f"{options.part[0]}/{options.part[1]}"
    then = "the part that finishes last writes the tables"
    if writes:
        then = f"the same command without --shard {writes} once all parts are done"
    answer(
        {
            "out": None if out is None else str(out),
            "shard": shard,
            "images": sweep.images,
            "refused": sweep.refused,
        },
        lambda: say(
            f"part {shard}: {sweep.images} {what} ({sweep.found_done} already done); {then}"
        ),
    )


def end_refused(sweep: SweepSummary, could: str, rest: str) -> None:
    """End with the photographs that could not be measured or used, if there are any.

    ``rest`` says what is of the others, who may stand in it as ``{others}``.
    """
    sentence = rest.format(others="others")
    if sweep.refused > 1:
        listed = f"({sweep.refused_list} lists them)"
        rest = rest.format(others=f"other {sweep.images}")
        sentence = f"{sweep.refused} photographs could not be {could} {listed}; {rest}"
    _end_refused(sweep, sentence)


def _end_refused(sweep: SweepSummary, sentence: str) -> None:
    """End with a sentence; an error says why one was refused, remarks for the first of several."""
    if sweep.refused == 1:
        raise ApplicationError(f"{sweep.refused_lines[0]}; {sentence}")
    note(*sweep.refused_lines)
    if sweep.refused:
        raise ApplicationError(sentence)
