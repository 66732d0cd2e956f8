"""``standoff calibrate``: the PSF from photographs of edges."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, Context, Option

from calibration.choices import CalibrationMethod, Channel, Pattern, TargetChoice
from standoff import library, terminal

if TYPE_CHECKING:
    from calibration.edges import Region

_WITH_AN_EDGE_TARGET = terminal.Given("method", ("all-angles", "paper"))
_LINEAR = "--noise and --correct apply to linear grey levels"

_NAMED = "What the first page of the report calls the {}."

_RULES = (
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
)


def _spelt(region: str | None) -> str | None:
    return "centre" if region == "center" else region


def calibrate(
    context: Context,
    images: Annotated[
        list[Path] | None, Argument(help="Photographs of edges.", show_default=False)
    ] = None,
    *,
    out: Annotated[Path, Option(help="Where to write psf.json.")],
    session: Annotated[
        Path | None, Option(help="Capture session whose edge captures are used.")
    ] = None,
    method: Annotated[
        CalibrationMethod,
        Option(
            help="Edges at any angle, or as in the paper; without an edge target, the edges of a "
            "scene, or one scene at two distances."
        ),
    ] = "all-angles",
    zoom: Annotated[
        float | None,
        Option(
            help="Distance ratio (two-distance); found from image features by default.",
            callback=terminal.checked_zoom,
        ),
    ] = None,
    region: Annotated[
        str | None,
        Option(
            help="Part of the image to use: centre, or X,Y,W,H in px; all of it by default.",
            callback=_spelt,
        ),
    ] = None,
    target: Annotated[
        TargetChoice,
        Option(
            help="Whether edges of the scene beside an edge target are left out (auto), or all "
            "edges count."
        ),
    ] = "auto",
    encoding: terminal.EncodingName = "auto",
    srgb: terminal.ShortEncoding = None,
    page: terminal.Page = None,
    mean: terminal.Mean = False,
    channel: Annotated[
        Channel | None,
        Option(help="Channel of colour photographs; luma by default, green with --bayer."),
    ] = None,
    bayer: Annotated[
        Pattern | None,
        Option(help="Bayer pattern of raw mosaics; each colour is measured separately."),
    ] = None,
    noise: Annotated[
        Path | None, Option(help="noise.json of the camera, for photographs of unknown variance.")
    ] = None,
    correct: Annotated[
        Path | None, Option(help="noise.json whose dark, flat and defect maps are applied first.")
    ] = None,
    csv: Annotated[
        Path | None,
        Option(help="Also write a CSV table of the edges of an edge target, with their SFR."),
    ] = None,
    report: Annotated[
        Path | None, Option(help="Also write a report on an edge target (HTML or PDF).")
    ] = None,
    pixel_pitch_um: Annotated[
        float | None,
        Option(
            help="Pixel pitch of the sensor, for lp/mm; by default as the session's bench file or "
            "EXIF states.",
            parser=terminal.quantity("pixel_pitch_um"),
            callback=terminal.checked_pitch,
            metavar="UM",
        ),
    ] = None,
    lens: Annotated[str | None, Option(help=_NAMED.format("lens"), metavar="TEXT")] = None,
    camera: Annotated[str | None, Option(help=_NAMED.format("camera"), metavar="TEXT")] = None,
    chart: Annotated[
        str | None, Option(help=_NAMED.format("target with the edges"), metavar="TEXT")
    ] = None,
    customer: Annotated[str | None, Option(help=_NAMED.format("customer"), metavar="TEXT")] = None,
    bench: Annotated[
        Path | None,
        Option(help="Bench file (TOML) that states these and the pixel pitch: [labels], [optics]."),
    ] = None,
    limits: Annotated[
        Path | None, Option(help="Limits for pass and fail (TOML); the exit status stays 0.")
    ] = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Measure the sharpness of a lens and camera: PSF, MTF and SFR of straight edges, at any angle.

    Photographs in colour also show lateral chromatic aberration. --report writes a lens report.
    """
    terminal.check_options(context, _RULES)
    terminal.refuse_overwriting(
        [out, csv, report], [*(images or []), noise, correct, limits, bench], force=force
    )
    terminal.refuse_suffix(out, "--out", {".json"})
    terminal.refuse_suffix(csv, "--csv", {".csv"})
    terminal.refuse_suffix(report, "--report", terminal.REPORTS)
    found_in = _region(region)
    labels = {"lens": lens, "camera": camera, "target": chart, "customer": customer}
    library.require_writable([out, csv, report])
    psf = library.calibrate_psf(
        (images or ()) if session is None else library.Session(session),
        method=method,
        zoom=zoom,
        region=found_in,
        target=target,
        channel=channel,
        bayer=bayer,
        noise=noise,
        correct=correct,
        pixel_pitch_um=pixel_pitch_um,
        limits=limits,
        labels={name: text for name, text in labels.items() if text is not None},
        bench=bench,
        report=report,
        reading=terminal.reading_options(encoding, page, mean, srgb),
        progress=terminal.ShownProgress(),
    )
    library.write_psf(out, psf)
    if csv is not None:
        library.write_edge_table(csv, psf)
    terminal.note_once(psf.notes)
    if json:
        terminal.print_json(psf)
        return
    terminal.print_psf(psf)
    if method in ("all-angles", "paper"):
        terminal.print_edges(psf)
    if psf.verdict is not None:
        terminal.print_verdict(psf.verdict)
    terminal.say(f"wrote {', '.join(str(path) for path in (out, csv, report) if path is not None)}")


def _region(text: str | None) -> Region | Literal["centre"] | None:
    if text is None:
        return None
    if text == "centre":
        return "centre"
    from calibration.edges import Region

    return terminal.parsed_region(text, "centre or X,Y,W,H in px", Region)
