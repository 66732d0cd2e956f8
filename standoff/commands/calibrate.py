"""``standoff calibrate`` and ``standoff compare``: the PSF, and whether it has changed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import BadParameter, Option

from calibration.choices import CalibrationMethod, Channel, Pattern, TargetChoice
from standoff import library, terminal

if TYPE_CHECKING:
    from calibration.edges import Region
    from standoff import PsfComparison, PsfHistory

_WITH_AN_EDGE_TARGET = terminal.Given("method", ("all-angles", "paper"))
_LINEAR = "--noise and --correct apply to linear grey levels"


def _spelt(region: str | None) -> str | None:
    return "centre" if region == "center" else region


@terminal.command(
    terminal.exactly_one("images", "session"),
    terminal.excludes("session", "srgb", because="captures are linear and grey"),
    terminal.needs("channel", "images", "bayer", because="captures are linear and grey"),
    terminal.excludes(
        "bayer", terminal.Given("channel", ("luma",)), because="a mosaic has red, green and blue"
    ),
    terminal.excludes("bayer", "srgb", because="raw mosaics are linear"),
    terminal.excludes("noise", "bayer", "srgb", because=_LINEAR),
    terminal.excludes("correct", "bayer", "srgb", because=_LINEAR),
    terminal.needs("zoom", terminal.Given("method", ("two-distance",))),
    *(
        terminal.needs(option, _WITH_AN_EDGE_TARGET)
        for option in ("report", "bayer", "csv", "limits", "pixel_pitch_um", "target")
    ),
    suffixes_last=True,
)
def calibrate(
    images: list[Path] | None = None,
    *,
    out: Annotated[Path, terminal.Result(".json")],
    session: Path | None = None,
    method: CalibrationMethod = "all-angles",
    zoom: Annotated[float | None, Option(callback=terminal.checked_zoom)] = None,
    region: Annotated[str | None, Option(callback=_spelt)] = None,
    target: TargetChoice = "auto",
    reading: terminal.ReadingWithShortForms,
    channel: Channel | None = None,
    bayer: Pattern | None = None,
    noise: Path | None = None,
    correct: Path | None = None,
    csv: Annotated[Path | None, terminal.Result(".csv")] = None,
    report: Annotated[Path | None, terminal.REPORT] = None,
    pixel_pitch_um: terminal.PixelPitch = None,
    labels: terminal.Labels,
    bench: Path | None = None,
    limits: Path | None = None,
) -> None:
    """Measure the sharpness of a lens and camera: PSF, MTF and SFR of straight edges, at any angle.

    Photographs in colour also show lateral chromatic aberration. --report writes a lens report.

    Options
    -------
    images: Photographs of edges.
    out: Where to write psf.json.
    session: Capture session whose edge captures are used.
    method: With an edge target: edges at any angle, or as in the paper. Without one: the edges of a
        scene, or one scene from two distances.
    zoom: Distance ratio (two-distance); found from image features by default.
    region: Part of the image to use: centre, or X,Y,W,H in px; all of it by default.
    target: Whether to leave out edges of the scene beside an edge target (auto), or to use all
        edges.
    channel: Channel of colour photographs; luma by default, green with --bayer.
    bayer: Bayer pattern of raw mosaics; each colour is measured separately.
    noise: noise.json of the camera, for photographs of unknown variance.
    correct: noise.json whose dark, flat and defect maps are applied first.
    csv: Also write a CSV table of the edges of an edge target, with their SFR.
    report: Also write a report on an edge target (HTML or PDF).
    bench: Bench file (TOML) with the names for the report (table labels) and the pixel pitch (table
        optics).
    limits: Limits for pass and fail (TOML); the exit status is 0 even if a limit is not met.
    """
    how = terminal.keywords_of(
        library.calibrate_psf,
        region=_region(region),
    )
    psf = library.calibrate_psf(
        (images or ()) if session is None else library.Session(session), **how
    )
    library.write_psf(out, psf)
    if csv is not None:
        library.write_edge_table(csv, psf)

    def show() -> None:
        terminal.print_psf(psf)
        if method in ("all-angles", "paper"):
            terminal.print_edges(psf)
        if psf.verdict is not None:
            terminal.print_verdict(psf.verdict)
        terminal.say(
            f"wrote {', '.join(str(one) for one in (out, csv, report) if one is not None)}"
        )

    terminal.answer(psf, show, psf.notes)


def _region(text: str | None) -> Region | Literal["centre"] | None:
    if text is None:
        return None
    if text == "centre":
        return "centre"
    from calibration.edges import Region

    return terminal.parsed_region(text, "centre or X,Y,W,H in px", Region)


@terminal.command(terminal.needs("report", "history"))
def compare(
    files: list[Path],
    *,
    history: Annotated[bool, Option("--history")] = False,
    report: Annotated[Path | None, terminal.REPORT] = None,
) -> None:
    """Test whether the PSF has changed between two calibrations, or show it over time.

    Options
    -------
    files: Two psf.json files; with --history, any number of files or folders.
    history: Show all calibrations by camera and over time.
    report: Also write a report on the history (HTML or PDF).
    """
    if history:
        told = library.psf_history(files, progress=terminal.ShownProgress())
        if report is not None:
            told.write_report(report)
        terminal.answer(told.to_json, lambda: _show_history(told, report))
        return
    if len(files) != 2:
        raise BadParameter(f"give two psf.json files, got {len(files)}; or use --history")
    change = library.compare_psfs(*files)
    terminal.answer(change.to_json, lambda: _show_change(change), change.notes)


def _show_change(change: PsfComparison) -> None:
    from calibration.estimate import NORMAL_95, with_reach

    terminal.print_items(
        "PSF, ± at 95 %",
        change.parameters,
        {
            "": lambda one: one.name,
            "first": lambda one: with_reach(one.first, NORMAL_95 * one.first_err, 4),
            "second": lambda one: with_reach(one.second, NORMAL_95 * one.second_err, 4),
            "difference": lambda one: with_reach(one.difference, NORMAL_95 * one.difference_err, 4),
            "z": lambda one: f"{one.z:+.2f}",
            "p": lambda one: f"{one.p_value:.2g}",
            "p (Holm)": lambda one: f"{one.p_value_holm:.2g}",
        },
    )
    terminal.say(change.verdict)


def _show_history(found: PsfHistory, report: Path | None) -> None:
    for section in found.sections:
        table = section.tables[0]
        terminal.print_table(
            f"{section.title}, ± at 95 %",
            table.columns,
            table.rows,
            ends_in_words=table.ends_in_words,
        )
        for sentence in section.text[1:]:
            terminal.say(sentence)
    if report is not None:
        terminal.say(f"wrote {report}")
