"""``standoff changes``: differences between photographs that their poses do not explain."""

from __future__ import annotations

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
_COLUMNS = (
    *("change", "what", "x / px", "y / px", "area / px", "sigma / px", "amplitude / DN"),
    *("significance", "q"),
)


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
    colour: Change that the limit is for in photographs in colour: grey, red, green, blue, or R,G,B,
        its direction in linear levels.
    pixel_size_mm: Side of a follow-up pixel on the scene, for sizes in mm.
    geometry: geometry.json of the camera, instead of --pixel-size-mm.
    reference_height_mm: Height at which the reference was taken; the lowest of --geometry by
        default.
    curves: curves.json with observer changes: says how the limit compares with the one that was
        predicted, and what the difference was lost to.
    curve_noise_dn: Use the curve for this noise in DN.
    """
    return library.DetectionLimitOptions(**locals())


_Limit = Annotated["library.DetectionLimitOptions", terminal.MadeBy(_limit)]


@terminal.command(
    *terminal.HINT_RULES,
    terminal.excludes("geometry", "pixel_size_mm", because="either says how large a pixel is"),
    terminal.needs("reference_height_mm", "geometry"),
    terminal.needs("transfer", "psf"),
    terminal.needs("curve_noise_dn", "curves"),
    terminal.needs("curve_model", "curves"),
    terminal.excludes(
        "false_discovery_rate", "false_alarms", because="either decides the threshold"
    ),
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
    reference: The earlier photograph, or a folder of them: pairs by name.
    followup: The later photograph, from nearer or further away. Of several, or a folder of them,
        each gets a folder.
    out: Folder for the results; a series is resumed.
    psf: psf.json, or a PSF of your own; the blur is fitted to the pair by default.
    noise: noise.json of the camera; the noise is fitted by default.
    white_level: Level of the files at which they are clipped; the file's own by default.
    false_alarms: Pixels flagged by chance per frame.
    false_discovery_rate: Share of false ones among the listed changes, instead of --false-alarms.
    count_moved: Count what a shift of a few pixels explains among the changes, not apart.
    least: Amplitude below which what is significant is counted, not listed; the step of the files'
        levels by default.
    report: Also write the report here (HTML or PDF); report.html is always in the folder.
    """
    if reference.is_dir() or library.is_series(followup):
        if hints is not None and hints.points is not None:
            raise BadParameter("points are of one follow-up; give one", param_hint="--points")
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
        describe_focus,
        describe_least,
        describe_limit,
        describe_moved,
        describe_prediction,
    )

    found, count = summary.changes, len(summary.changes)
    if found:
        shown = found if count <= _SHOWN_WHOLE else found[:_SHOWN_OF_MANY]
        title = "1 change" if count == 1 else f"{count} changes"
        if len(shown) < count:
            title = f"The first {len(shown)} of {title}"
        terminal.print_table(
            title,
            _COLUMNS,
            [_change_cells(number, change) for number, change in enumerate(shown, 1)],
        )
    terminal.say(
        f"{summary.changed_px} of {summary.compared_px} pixels changed by more than "
        f"{summary.threshold_sd:.2f} standard deviations (zoom {summary.zoom:.3f}); wrote {out}"
    )
    describe = describe_moved, describe_least, describe_limit, describe_prediction
    terminal.say(*filter(None, (sentence_of(summary) for sentence_of in describe)))
    focus = describe_focus(summary)
    if focus is not None and summary.kernel != "both":  # of which a warning tells
        terminal.say(focus)


def _change_cells(number: int, change: Change) -> list[str]:
    from analysis.reports import q_text
    from calibration.sharpness import NORMAL_95

    reach_dn = NORMAL_95 * change.amplitude_err_dn
    return [
        str(number),
        change.what or "",
        f"{change.x_px:.1f}",
        f"{change.y_px:.1f}",
        f"{change.area_px:.0f}",
        "" if change.spot_sigma_px is None else f"{change.spot_sigma_px:.1f}",
        f"{change.amplitude_dn:+.3g} ± {reach_dn:.2g}",
        f"{change.significance:.1f}",
        q_text(change.q_value),
    ]


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
            f"{count} photographs without a partner of their name, or with several: {listed}{more}"
        )
    terminal.note_once(found.notes)
    if document is None:
        done = f"follow-ups done, {found.sweep.refused} refused"
        terminal.say_part(options, found.sweep, done, out=out)
    elif terminal.wants_json():
        terminal.print_json_file(found.summary)
    else:
        terminal.print_few(
            ["folder", "changes", "changed px", "compared px", "zoom", "limit / DN"],
            _cells,
            found,
            "Follow-ups with the most changed pixels",
        )
        terminal.say(
            f"{document.compared} follow-ups compared, {document.changed} with changed pixels "
            f"({found.sweep.found_done} already done); wrote {out}"
        )
    terminal.report_refused(found.sweep, "the results of the others are complete")


def _cells(one: ComparedFollowup) -> list[str]:
    if one.folder is None:
        return [Path(one.followup).name, "", "", "", "none", ""]
    counts = (one.changes, one.changed_px, one.compared_px)
    limit = "" if one.limit_p95_dn is None else f"{one.limit_p95_dn:.2g}"
    return [one.folder, *map(str, counts), f"{one.zoom:.3f}", limit]
