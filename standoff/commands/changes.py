"""``standoff changes``: differences between photographs that their poses do not explain."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, BadParameter, Context, Option

from analysis.choices import FALSE_ALARMS, SPOT_SIGMA_PX
from standoff import library, terminal

if TYPE_CHECKING:
    from analysis.change_series import ChangesSeries, ComparedFollowup
    from analysis.changes import Change, ChangeSummary
    from analysis.sweep import SweepOptions

_RULES = (
    *terminal.HINT_RULES,
    terminal.excludes("geometry", "pixel_size_mm", because="either says how large a pixel is"),
    terminal.needs("reference_height_mm", "geometry"),
    terminal.needs("transfer", "psf"),
    terminal.needs("curve_noise", "curves"),
    terminal.needs("curve_model", "curves"),
    terminal.excludes(
        "false_discovery_rate", "false_alarms", because="either decides the threshold"
    ),
)
_SHOWN_WHOLE, _SHOWN_OF_MANY = 20, 10
_UNPAIRED_SHOWN = 5


def changes(
    context: Context,
    reference: Annotated[
        Path, Argument(help="The earlier photograph, or a folder of them: pairs by name.")
    ],
    followup: Annotated[
        list[Path],
        Argument(
            help="The later photograph, from nearer or further away. Of several, or a folder of "
            "them, each gets a folder.",
            show_default=False,
        ),
    ],
    *,
    out: Annotated[Path, Option(help="Folder for the results; a series is resumed.")],
    psf: Annotated[
        Path | None,
        Option(help="psf.json, or a PSF of your own; the blur is fitted to the pair by default."),
    ] = None,
    transfer: terminal.TransferForm = "best",
    noise: Annotated[
        Path | None, Option(help="noise.json of the camera; the noise is fitted by default.")
    ] = None,
    expect_zoom: terminal.ExpectZoom = None,
    homography: terminal.PoseHint = None,
    points: terminal.Points = None,
    mask: terminal.Mask = None,
    mirrored: terminal.Mirrored = False,
    white_level: Annotated[
        float | None,
        Option(
            min=1e-6,
            metavar="N",
            help="Level of the files at which they are clipped; the file's own by default.",
        ),
    ] = None,
    false_alarms: Annotated[
        float, Option(min=1e-6, max=1e4, help="Pixels flagged by chance per frame.")
    ] = FALSE_ALARMS,
    false_discovery_rate: Annotated[
        float | None,
        Option(
            min=1e-6,
            max=0.5,
            metavar="R",
            help="Share of false ones among the listed changes, instead of --false-alarms.",
        ),
    ] = None,
    spot_sigma: Annotated[
        float,
        Option(
            min=0.3,
            max=100,
            metavar="S",
            help="Width in px (sigma) of the spots whose detection limit is mapped.",
        ),
    ] = SPOT_SIGMA_PX,
    limit_contrast: Annotated[
        float | None,
        Option(
            min=1e-6,
            metavar="C",
            help="Also say where a spot of C DN would have been found.",
        ),
    ] = None,
    limit_colour: Annotated[
        str,
        Option(
            metavar="C",
            help="Change that the limit is for in photographs in colour: grey, red, green, blue, "
            "or R,G,B, its direction in linear levels.",
        ),
    ] = "grey",
    pixel_size_mm: Annotated[
        float | None,
        Option(
            min=1e-9,
            metavar="MM",
            help="Side of a follow-up pixel on the scene, for sizes in mm.",
        ),
    ] = None,
    geometry: Annotated[
        Path | None, Option(help="geometry.json of the camera, instead of --pixel-size-mm.")
    ] = None,
    reference_height_mm: Annotated[
        float | None,
        Option(
            metavar="MM",
            help="Height at which the reference was taken; the lowest of --geometry by default.",
        ),
    ] = None,
    curves: Annotated[
        Path | None,
        Option(
            help="curves.json with observer changes: says how the limit compares with the one "
            "that was predicted, and what the difference was lost to."
        ),
    ] = None,
    curve_noise: Annotated[
        float | None, Option(metavar="S", help="Use the curve for this noise in DN.")
    ] = None,
    curve_model: terminal.CurveModel = None,
    count_moved: Annotated[
        bool,
        Option(
            "--count-moved",
            help="Count what a shift of a few pixels explains among the changes, not apart.",
        ),
    ] = False,
    least: Annotated[
        float | None,
        Option(
            min=0.0,
            metavar="DN",
            help="Amplitude below which what is significant is counted, not listed; the step of "
            "the files' levels by default.",
            show_default=False,
        ),
    ] = None,
    report: Annotated[
        Path | None,
        Option(
            metavar="R.html",
            help="Also write the report here (HTML or PDF); report.html is always in the folder.",
        ),
    ] = None,
    parquet: terminal.AsParquet = False,
    workers: terminal.Workers = 1,
    scheduler: terminal.Scheduler = None,
    shard: terminal.PartOfShards = "1/1",
    strict: terminal.Strict = False,
    encoding: terminal.EncodingName = "auto",
    page: terminal.Page = None,
    mean: terminal.Mean = False,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Find the difference between two photographs: what changed that their poses do not explain.

    The two are aligned first. Without --psf the blur between them is fitted to the pair.
    """
    terminal.check_options(context, _RULES)
    terminal.refuse_suffix(report, "--report", terminal.REPORTS)
    inputs_given = [reference, *followup, psf, noise, geometry, curves, homography, points, mask]
    terminal.refuse_overwriting([report], inputs_given, force=force)
    sweep = terminal.sweep_options(workers, scheduler, shard, is_strict=strict)
    library.require_writable([report])
    how: dict[str, Any] = {
        "transfer": transfer,
        "noise": noise,
        "false_alarms": false_alarms,
        "false_discovery_rate": false_discovery_rate,
        "hints": library.alignment_hints(
            expect_zoom, homography=homography, points=points, mask=mask, mirrored=mirrored
        ),
        "white_level": white_level,
        "count_moved": count_moved,
        "least": least,
        "limit": library.DetectionLimitOptions(
            spot_sigma_px=spot_sigma,
            contrast_dn=limit_contrast,
            colour=limit_colour,
            pixel_size_mm=pixel_size_mm,
            geometry=geometry,
            reference_height_mm=reference_height_mm,
            curves=curves,
            curve_model=curve_model,
            curve_noise_dn=curve_noise,
        ),
        "reading": terminal.reading_options(encoding, page, mean),
        "progress": terminal.ShownProgress(),
    }
    if reference.is_dir() or library.is_series(followup):
        if points is not None:
            raise BadParameter("points are of one follow-up; give one", param_hint="--points")
        if not library.holds_series(out, library.CHANGES_TABLE):
            results = [out / name for name in library.FILES_OF_SERIES]
            terminal.refuse_overwriting(results, force=force)
        series = library.find_changes_of_series(
            reference, followup, out, psf, **how, report=report, parquet=parquet, sweep=sweep
        )
        _show_series(out, series, sweep, json=json)
        return
    terminal.refuse_sweep_of_one(sweep, parquet=parquet)
    results = [out / name for name in library.CHANGE_FILES]
    terminal.refuse_overwriting(results, inputs_given, force=force)
    found = library.find_changes(reference, followup[0], psf, **how)
    if report is not None:
        found.write_report(report)
    found.write(out)
    terminal.note_once(found.notes)
    if json:
        terminal.print_json({"out": str(out), **found.to_json()})
    else:
        _show_one(out, found.summary)


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
            [
                "change",
                "what",
                "x / px",
                "y / px",
                "area / px",
                "sigma / px",
                "amplitude / DN",
                "significance",
                "q",
            ],
            [_change_cells(number, change) for number, change in enumerate(shown, 1)],
        )
    terminal.say(
        f"{summary.changed_px} of {summary.compared_px} pixels changed by more than "
        f"{summary.threshold_sd:.2f} standard deviations (zoom {summary.zoom:.3f}); wrote {out}"
    )
    moved = describe_moved(summary)
    if moved is not None:
        terminal.say(moved)
    small = describe_least(summary)
    if small is not None:
        terminal.say(small)
    limit = describe_limit(summary)
    if limit is not None:
        terminal.say(limit)
    predicted = describe_prediction(summary)
    if predicted is not None:
        terminal.say(predicted)
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
    *,
    json: bool,
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
        terminal.say_part(out, found.sweep, options, json=json)
    elif json:
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
