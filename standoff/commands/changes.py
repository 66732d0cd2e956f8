"""``standoff changes``: differences between photographs that their poses do not explain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import BadParameter, Option

from analysis.choices import FALSE_ALARMS, SPOT_SIGMA_PX
from standoff import library, terminal

if TYPE_CHECKING:
    from analysis.change_series import ChangesSeries, ComparedFollowup
    from analysis.changes import Change, ChangeSummary
    from analysis.sweep import SweepOptions

_SHOWN_WHOLE, _SHOWN_OF_MANY = 20, 10
_UNPAIRED_SHOWN = 5


def _limit(
    *,
    spot_sigma_px: Annotated[
        float, Option("--spot-sigma", min=0.3, max=100, metavar="S")
    ] = SPOT_SIGMA_PX,
    contrast_dn: Annotated[float | None, Option("--limit-contrast", min=1e-6, metavar="C")] = None,
    colour: Annotated[str, Option("--limit-colour", metavar="C")] = "grey",
    pixel_size_mm: Annotated[float | None, Option(min=1e-9, metavar="MM")] = None,
    geometry: Path | None = None,
    reference_height_mm: Annotated[float | None, Option(metavar="MM")] = None,
    curves: Path | None = None,
    curve_noise_dn: Annotated[float | None, Option("--curve-noise", metavar="S")] = None,
    curve_model: terminal.CurveModel = None,
) -> library.DetectionLimitOptions:
    """Which spots the detection limit is for, and how large a pixel is.

    Options
    -------
    spot_sigma_px: Width in px (sigma) of the spots whose detection limit is mapped.
    contrast_dn: Also say where a spot of C DN would have been found.
    colour: For colour photographs, the colour of the change to which the limit applies: grey, red,
        green or blue, or its direction in linear levels as R,G,B.
    pixel_size_mm: Side of a follow-up pixel on the scene, for sizes in mm.
    geometry: geometry.json of the camera, instead of --pixel-size-mm.
    reference_height_mm: Height at which the reference was taken; the lowest of --geometry by
        default.
    curves: curves.json for the observer "changes": also report how the limit compares with the
        predicted one, and what caused the difference.
    curve_noise_dn: Use the curve for this noise in DN.
    """
    return library.DetectionLimitOptions(**locals())


_Limit = Annotated["library.DetectionLimitOptions", terminal.MadeBy(_limit)]


@terminal.command(
    *terminal.HINT_RULES,
    terminal.excludes("geometry", "pixel_size_mm", because="both give the size of a pixel"),
    terminal.needs("reference_height_mm", "geometry"),
    terminal.needs("transfer", "psf"),
    terminal.needs("curve_noise_dn", "curves"),
    terminal.needs("curve_model", "curves"),
    terminal.excludes("false_discovery_rate", "false_alarms", because="both set the threshold"),
)
def changes(
    reference: Path,
    followup: list[Path],
    *,
    out: Path,
    psf: Path | None = None,
    transfer: terminal.TransferForm = "best",
    noise: Path | None = None,
    hints: terminal.Hints,
    white_level: Annotated[float | None, Option(min=1e-6, metavar="N")] = None,
    false_alarms: Annotated[float, Option(min=1e-6, max=10000.0)] = FALSE_ALARMS,
    false_discovery_rate: Annotated[float | None, Option(min=1e-6, max=0.5, metavar="R")] = None,
    limit: _Limit,
    count_moved: Annotated[bool, Option("--count-moved")] = False,
    flat: Annotated[bool, Option("--flat")] = False,
    least: Annotated[float | None, Option(min=0.0, metavar="DN", show_default=False)] = None,
    report: Annotated[Path | None, Option(metavar="R.html"), terminal.REPORT] = None,
    parquet: terminal.AsParquet = False,
    sweep: terminal.Sweep,
    reading: terminal.Reading,
) -> None:
    """Find the difference between two photographs: what changed that their poses do not explain.

    The two are aligned first. Without --psf the blur between them is fitted to the pair.

    Options
    -------
    reference: The earlier photograph, or a folder of them, paired with the follow-ups by name.
    followup: The later photograph, from nearer or further away. If there are several, or a folder
        of them, the results of each go to a folder of its own.
    out: Folder for the results; a series is resumed.
    psf: psf.json, or a PSF of your own; the blur is fitted to the pair by default.
    noise: noise.json of the camera; the noise is fitted by default.
    white_level: Level at which the files are clipped; by default as each file states.
    false_alarms: Expected number of pixels per frame that are flagged by chance.
    false_discovery_rate: Share of false changes among those listed, instead of --false-alarms.
    count_moved: List differences that a shift of a few pixels explains among the changes, instead
        of separately.
    flat: Treat the scene as a plane; by default, the parallax of a scene with depth is followed.
    least: Amplitude below which significant differences are counted but not listed; by default the
        step of the files' levels.
    report: Also write the report here (HTML or PDF); report.html is always in the folder.
    """
    if reference.is_dir() or library.is_series(followup):
        if hints is not None and hints.points is not None:
            raise BadParameter("points are for a single follow-up", param_hint="--points")
        if not library.holds_series(out, library.CHANGES_TABLE):
            terminal.refuse_replacing(*(out / name for name in library.FILES_OF_SERIES))
        how = terminal.keywords_of(library.find_changes_of_series)
        series = library.find_changes_of_series(reference, followup, out, psf, **how)
        _show_series(out, series, sweep)
        return
    terminal.refuse_sweep_of_one(sweep, parquet=parquet)
    terminal.refuse_replacing(*(out / name for name in library.CHANGE_FILES))
    found = library.find_changes(
        reference, followup[0], psf, **terminal.keywords_of(library.find_changes)
    )
    if report is not None:
        found.write_report(report)
    found.write(out)
    terminal.answer(
        lambda: {"out": str(out), **found.to_json()},
        lambda: _show_one(out, found.summary),
        found.notes,
    )


def _show_one(out: Path, summary: ChangeSummary) -> None:
    from analysis.changes import (
        describe_depth,
        describe_focus,
        describe_least,
        describe_limit,
        describe_moved,
        describe_prediction,
    )

    _print_changes(summary.changes)
    terminal.say(
        f"{summary.changed_px} of {summary.compared_px} pixels changed by more than "
        f"{summary.threshold_sd:.2f} standard deviations (zoom {summary.zoom:.3f}); wrote {out}"
    )
    describe = describe_depth, describe_moved, describe_least, describe_limit, describe_prediction
    terminal.say(*filter(None, (sentence_of(summary) for sentence_of in describe)))
    focus = describe_focus(summary)
    if focus is not None and summary.kernel != "both":  # of which a warning tells
        terminal.say(focus)


def _print_changes(found: Sequence[Change]) -> None:
    from analysis.reports import amplitude_text, count_text, q_text

    if not found:
        return
    shown = found if len(found) <= _SHOWN_WHOLE else found[:_SHOWN_OF_MANY]
    title = count_text(len(found))
    if len(shown) < len(found):
        title = f"The first {len(shown)} of {title}"
    terminal.print_items(
        title,
        enumerate(shown, 1),
        {
            "change": lambda one: str(one[0]),
            "what": lambda one: one[1].what or "",
            "x / px": lambda one: f"{one[1].x_px:.1f}",
            "y / px": lambda one: f"{one[1].y_px:.1f}",
            "area / px": lambda one: f"{one[1].area_px:.0f}",
            "sigma / px": lambda one: (
                "" if one[1].spot_sigma_px is None else f"{one[1].spot_sigma_px:.1f}"
            ),
            "amplitude / DN": lambda one: amplitude_text(one[1]),
            "significance": lambda one: f"{one[1].significance:.1f}",
            "q": lambda one: q_text(one[1].q_value),
        },
    )


def _show_series(
    out: Path,
    found: library.SeriesResult[ChangesSeries, ComparedFollowup],
    options: SweepOptions,
) -> None:
    document = found.document
    if document is not None and document.unpaired:
        count, listed = len(document.unpaired), ", ".join(document.unpaired[:_UNPAIRED_SHOWN])
        more = ", ..." if count > _UNPAIRED_SHOWN else ""
        terminal.note(
            f"{count} photographs have no partner with the same name, or several: {listed}{more}"
        )

    def show(document: ChangesSeries) -> None:
        terminal.print_few(found, _CELLS, "Follow-ups with the most changed pixels")
        terminal.say(
            f"{document.compared} follow-ups compared, {document.changed} with changed pixels "
            f"({found.sweep.found_done} already done); wrote {out}"
        )

    terminal.show_series(found, options, out, show, "the results of the others are complete")


_CELLS: dict[str, Callable[[ComparedFollowup], str]] = {
    "folder": lambda one: one.folder or Path(one.followup).name,
    "changes": lambda one: "" if one.folder is None else str(one.changes),
    "changed px": lambda one: "" if one.folder is None else str(one.changed_px),
    "compared px": lambda one: "" if one.folder is None else str(one.compared_px),
    "zoom": lambda one: "none" if one.folder is None else f"{one.zoom:.3f}",
    "limit / DN": lambda one: "" if one.limit_p95_dn is None else f"{one.limit_p95_dn:.2g}",
}
