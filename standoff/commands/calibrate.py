"""``standoff calibrate``: the PSF from photographs of edges."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from calibration.choices import CalibrationMethod, Channel, Pattern, TargetChoice
from standoff.terminal import (
    EncodingName,
    Force,
    Json,
    Mean,
    Option,
    Page,
    ShortEncoding,
    ShownProgress,
    check_options,
    checked_pitch,
    checked_zoom,
    exactly_one,
    excludes,
    needs,
    note_once,
    print_json,
    quantity,
    reading_options,
    refuse_overwriting,
    refuse_suffix,
    region_corner_and_size,
    say,
)

if TYPE_CHECKING:
    from calibration.edges import Region


_WITH_AN_EDGE_TARGET = Option("method", ("all-angles", "paper"))
_LINEAR = "--noise and --correct apply to linear grey levels"

_RULES = (
    exactly_one("images", "session"),
    excludes("session", "srgb", because="captures are linear and grey"),
    needs("channel", "images", "bayer", because="captures are linear and grey"),
    excludes("bayer", Option("channel", ("luma",)), because="a mosaic has red, green and blue"),
    excludes("bayer", "srgb", because="raw mosaics are linear"),
    excludes("noise", "bayer", "srgb", because=_LINEAR),
    excludes("correct", "bayer", "srgb", because=_LINEAR),
    needs("zoom", Option("method", ("two-distance",))),
    *(
        needs(option, _WITH_AN_EDGE_TARGET)
        for option in ("report", "bayer", "csv", "limits", "pixel_pitch_um", "target")
    ),
)


def _spelt(region: str | None) -> str | None:
    return "centre" if region == "center" else region


def calibrate(
    context: typer.Context,
    images: Annotated[
        list[Path] | None, typer.Argument(help="Photographs of edges.", show_default=False)
    ] = None,
    *,
    out: Annotated[Path, typer.Option(help="Where to write psf.json.")],
    session: Annotated[
        Path | None, typer.Option(help="Capture session whose edge captures are used.")
    ] = None,
    method: Annotated[
        CalibrationMethod,
        typer.Option(
            help="Edges at any angle, or as in the paper; without an edge target, the edges of a "
            "scene, or one scene at two distances."
        ),
    ] = "all-angles",
    zoom: Annotated[
        float | None,
        typer.Option(
            help="Distance ratio (two-distance); found from image features by default.",
            callback=checked_zoom,
        ),
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(
            help="Part of the image to use: centre, or X,Y,W,H in px; all of it by default.",
            callback=_spelt,
        ),
    ] = None,
    target: Annotated[
        TargetChoice,
        typer.Option(
            help="Whether edges of the scene beside an edge target are left out (auto), or all "
            "edges count."
        ),
    ] = "auto",
    encoding: EncodingName = "auto",
    srgb: ShortEncoding = None,
    page: Page = None,
    mean: Mean = False,
    channel: Annotated[
        Channel | None,
        typer.Option(help="Channel of colour photographs; luma by default, green with --bayer."),
    ] = None,
    bayer: Annotated[
        Pattern | None,
        typer.Option(help="Bayer pattern of raw mosaics; each colour is measured separately."),
    ] = None,
    noise: Annotated[
        Path | None,
        typer.Option(help="noise.json of the camera, for photographs of unknown variance."),
    ] = None,
    correct: Annotated[
        Path | None,
        typer.Option(help="noise.json whose dark, flat and defect maps are applied first."),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(help="Also write a CSV table of the edges of an edge target, with their SFR."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Also write a report on an edge target (HTML or PDF).")
    ] = None,
    pixel_pitch_um: Annotated[
        float | None,
        typer.Option(
            help="Pixel pitch of the sensor, for lp/mm; by default as the session's bench file or "
            "EXIF states.",
            parser=quantity("pixel_pitch_um"),
            callback=checked_pitch,
            metavar="UM",
        ),
    ] = None,
    limits: Annotated[
        Path | None,
        typer.Option(help="Limits for pass and fail (TOML); the exit status stays 0."),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure the camera's PSF from photographs of straight edges, at any angle."""
    check_options(context, _RULES)
    refuse_overwriting([out, csv, report], [*(images or []), noise, correct, limits], force=force)
    refuse_suffix(report, "--report", {".html", ".htm", ".pdf"})
    found_in = _region(region)
    from calibration.documents import json_object
    from standoff.library import (
        Session,
        calibrate_psf,
        require_writable,
        write_edge_table,
        write_psf,
    )
    from standoff.terminal import print_edges, print_psf, print_verdict

    require_writable([out, csv, report])
    psf = calibrate_psf(
        (images or ()) if session is None else Session(session),
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
        report=report,
        reading=reading_options(encoding, page, mean, srgb),
        progress=ShownProgress(),
    )
    write_psf(out, psf)
    if csv is not None:
        write_edge_table(csv, psf)
    note_once(psf.notes)
    if json:
        print_json(json_object(psf))
        return
    print_psf(psf)
    if method in ("all-angles", "paper"):
        print_edges(psf)
    if psf.verdict is not None:
        print_verdict(psf.verdict)
    say(f"wrote {', '.join(str(path) for path in (out, csv, report) if path is not None)}")


def _region(text: str | None) -> Region | Literal["centre"] | None:
    if text is None:
        return None
    if text == "centre":
        return "centre"
    from calibration.edges import Region

    x, y, width, height = region_corner_and_size(text, "centre or X,Y,W,H in px")
    return Region(x_px=x, y_px=y, width_px=width, height_px=height)
