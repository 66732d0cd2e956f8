"""``standoff calibrate``: the PSF from photographs of edges."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from acquisition.session import Session
from calibration.edges import EdgeImage, Pattern, Region
from calibration.errors import CalibrationError
from calibration.files import json_object, read_correction, read_noise, write_psf
from calibration.noise import level_noise
from calibration.psf import (
    CalibrationMethod,
    Channel,
    PsfCalibration,
    calibrate_mosaic,
    calibrate_psf,
    share_of_correlation,
)
from standoff.terminal import (
    Json,
    checked_zoom,
    edge_csv,
    note,
    print_json,
    print_psf,
    progress_bar,
    refuse_overwriting,
    refuse_suffix,
    say,
)
from standoff.workflows import (
    Reading,
    calibrate_scenes,
    from_files,
    from_session,
    require_writable,
    write_calibration_report,
    write_file,
)

__all__ = ["calibrate"]


_USUAL_RHO = 0.1
_WORTH_SAYING = 0.002
"""Of a width: what a correlation of that size may hide."""

_REMARKS = {
    "sharpened": "overshoot on both sides of {n} of {total} edges: the camera sharpens, "
    "and sigma comes out too small; switch sharpening off",
    "jpeg": "{n} of {total} edges are from JPEG files, whose compression adds to the error",
    "non_gaussian": "{n} of {total} edges do not fit a Gaussian PSF: read sigma as an equivalent",
}


def calibrate(
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
            help="All edges at any angle, or as in the paper; without an edge target: the edges "
            "of one scene, or one scene at two distances."
        ),
    ] = "all-angles",
    zoom: Annotated[
        float | None,
        typer.Option(
            help="two-distance: ratio of the distances; else features tell.", callback=checked_zoom
        ),
    ] = None,
    region: Annotated[
        str | None, typer.Option(help="Part of the image to use: centre, or X,Y,W,H in px.")
    ] = None,
    srgb: Annotated[
        bool, typer.Option("--srgb/--linear", help="Undo the sRGB curve, or take as linear.")
    ] = False,
    channel: Annotated[
        Channel | None,
        typer.Option(help="Plane of colour photographs; luma, or green with --bayer."),
    ] = None,
    bayer: Annotated[
        Pattern | None,
        typer.Option(help="Raw mosaics of this pattern: each colour on its own plane."),
    ] = None,
    noise: Annotated[
        Path | None,
        typer.Option(help="noise.json of the camera, for photographs without a variance."),
    ] = None,
    correct: Annotated[
        Path | None,
        typer.Option(help="noise.json whose dark, flat and defect maps are taken off."),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(help="Also write a table of all edges of an edge target, with their SFR."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Also write a report of an edge target: HTML or PDF.")
    ] = None,
    json: Json = False,
) -> None:
    """Measure the camera's PSF from photographs of straight edges, at any angle."""
    refuse_overwriting([out, csv, report], [*(images or []), noise, correct])
    refuse_suffix(report, "--report", {".html", ".htm", ".pdf"})
    rule = _region_rule(region)
    if (session is None) == (not images):
        raise typer.BadParameter("give either photographs or --session DIR", param_hint="IMAGE...")
    if session is not None and (srgb or (channel is not None and bayer is None)):
        raise typer.BadParameter("captures are linear and grey; --bayer is for raw mosaics")
    if zoom is not None and (method != "two-distance" or len(images or []) != 2):
        raise typer.BadParameter(
            "it is the ratio of two photographs' distances", param_hint="--zoom"
        )
    if method == "two-distance" and session is None and len(images or []) < 2:
        raise typer.BadParameter("two-distance needs two photographs, the nearest first")
    if bayer is not None and channel == "luma":
        raise typer.BadParameter("a mosaic has red, green and blue", param_hint="--channel")
    if bayer is not None and srgb:
        raise typer.BadParameter("raw mosaics are linear", param_hint="--srgb")
    if (bayer is not None or srgb) and (noise is not None or correct is not None):
        raise typer.BadParameter("--noise and --correct are for linear, grey levels")
    require_writable([out, csv, report])
    reading = Reading(
        is_srgb=srgb,
        channel=channel or ("luma" if bayer is None else "green"),
        pattern=bayer,
        correction=None if correct is None else read_correction(correct),
        frame_noise=None if noise is None else level_noise(read_noise(noise).capture_noise),
    )
    if method == "single-image" or method == "two-distance":
        if report is not None or bayer is not None or csv is not None:
            raise typer.BadParameter(f"--report, --bayer and --csv do not go with method {method}")
        calibration, origin = calibrate_scenes(images or [], session, reading, method, rule, zoom)
        calibration = calibration.with_origin(replace(origin, region=region))
        write_psf(out, calibration)
        if json:
            print_json(json_object(calibration))
            return
        print_psf(calibration)
        say(f"wrote {out}")
        return
    sources = (
        from_files(images or [], reading)
        if session is None
        else from_session(Session(session), reading)
    )
    with progress_bar("measuring edges", sources.count) as bar:
        try:
            if bayer is None:
                calibration = calibrate_psf(
                    sources.images, method=method, region=rule, progress=bar.advance_to
                )
            else:
                calibration = calibrate_mosaic(
                    sources.images,
                    bayer,
                    reading.channel,
                    method=method,
                    region=rule,
                    progress=bar.advance_to,
                )
        except ValueError as error:
            raise CalibrationError(str(error)) from error
    calibration = calibration.with_origin(replace(sources.origin, region=region))
    write_psf(out, calibration)
    if csv is not None:
        write_file(csv, edge_csv(calibration).encode("utf-8"))
    _print_remarks(calibration)
    if report is not None:
        write_calibration_report(report, calibration, sources.load, sources.session)
    if json:
        print_json(json_object(calibration))
        return
    print_psf(calibration)
    written = ", ".join(str(path) for path in (out, csv, report) if path is not None)
    say(f"wrote {written}")


def _region_rule(text: str | None) -> Callable[[EdgeImage], Region | None]:
    if text is None:
        return lambda _: None
    if text == "centre":
        return lambda source: Region.centre(*source.frame)
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(
            f"expected centre or X,Y,W,H in px, got {text}", param_hint="--region"
        ) from error
    fixed = Region(x_px=x, y_px=y, width_px=width, height_px=height)
    return lambda _: fixed


def _print_remarks(calibration: PsfCalibration) -> None:
    used = calibration.edges_used
    for flag, text in _REMARKS.items():
        count = sum(flag in edge.flags for edge in used)
        if count:
            note(text.format(n=count, total=len(used)))
    if calibration.rho is None and used:
        share = share_of_correlation(np.array([edge.angle_deg for edge in used]))
        if share * _USUAL_RHO > _WORTH_SAYING:
            note(
                f"no diagonal edges tell the correlation rho: were it {_USUAL_RHO:g}, a width "
                f"would be off by {100 * share * _USUAL_RHO:.1f} %, beyond its interval; add "
                "diagonal edges"
            )
    trend = calibration.height_trend
    if trend is not None and trend.is_drift:
        note(
            f"the width changes by {100 * trend.change:.1f} % over the heights: the focus drifts, "
            "or the target is too rough for the nearest one; calibrate at one height or refocus"
        )
