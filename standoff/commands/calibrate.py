"""``standoff calibrate``: the PSF from photographs of edges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquisition.printable import on_one_line
from calibration.choices import CalibrationMethod, Channel, Pattern, TargetChoice
from standoff.terminal import (
    EncodingName,
    Force,
    Json,
    Mean,
    Option,
    Page,
    ShortEncoding,
    check_options,
    checked_pitch,
    checked_zoom,
    command_line,
    exactly_one,
    excludes,
    needs,
    photograph_inputs,
    print_json,
    quantity,
    refuse_overwriting,
    refuse_suffix,
    region_corner_and_size,
    remarks_so_far,
    say,
)

if TYPE_CHECKING:
    from calibration.edges import EdgeImage, Region
    from calibration.psf import PsfCalibration
    from standoff.workflows import Reading


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
    rule = _region_rule(region)
    _refuse_wrong_count(images or [], session, method, zoom)
    from calibration.files import write_psf
    from calibration.sharpness import read_limits
    from standoff.terminal import edge_csv, print_psf_remarks
    from standoff.workflows import (
        CalibrationRequest,
        calibrate_camera,
        require_writable,
        write_file,
    )

    require_writable([out, csv, report])
    bounds = None if limits is None else read_limits(limits)
    inputs = photograph_inputs(encoding, page, mean, srgb, files=(noise, correct, limits))
    found = calibrate_camera(
        CalibrationRequest(
            images=tuple(images or ()),
            session=session,
            reading=_reading(channel, bayer, correct, noise, pixel_pitch_um),
            inputs=inputs,
            method=method,
            region=rule,
            zoom=zoom,
            target=target,
        )
    )
    made = inputs.provenance(command_line())
    calibration = found.calibration.with_origin(
        replace(found.origin, region=region, provenance=made)
    )
    if bounds is not None:
        calibration = calibration.judged(bounds, on_one_line(limits))
    write_psf(out, calibration)
    if csv is not None:
        write_file(csv, edge_csv(calibration).encode("utf-8"))
    if found.edges is not None:
        print_psf_remarks(calibration)
        if report is not None:
            from standoff.workflows import write_calibration_report  # loads what plots

            write_calibration_report(report, calibration, found.edges, remarks_so_far())
    _print_results(calibration, [out, csv, report], has_target=found.edges is not None, json=json)


def _refuse_wrong_count(
    images: list[Path], session: Path | None, method: CalibrationMethod, zoom: float | None
) -> None:
    if zoom is not None and len(images) != 2:
        raise typer.BadParameter(
            "the distance ratio needs exactly two photographs", param_hint="--zoom"
        )
    if method == "two-distance" and session is None and len(images) < 2:
        raise typer.BadParameter("two-distance needs at least two photographs, the nearest first")


def _reading(
    channel: Channel | None,
    bayer: Pattern | None,
    correct: Path | None,
    noise: Path | None,
    pixel_pitch_um: float | None,
) -> Reading:
    from calibration.files import read_correction, read_noise
    from calibration.noise import level_noise
    from standoff.workflows import Reading

    return Reading(
        channel=channel or ("luma" if bayer is None else "green"),
        pattern=bayer,
        correction=None if correct is None else read_correction(correct),
        frame_noise=None if noise is None else level_noise(read_noise(noise).capture_noise),
        pixel_pitch_um=pixel_pitch_um,
    )


def _print_results(
    calibration: PsfCalibration, written: list[Path | None], *, has_target: bool, json: bool
) -> None:
    from calibration.documents import json_object
    from standoff.terminal import print_edges, print_psf, print_verdict

    if json:
        print_json(json_object(calibration))
        return
    print_psf(calibration)
    if has_target:
        print_edges(calibration)
    if calibration.verdict is not None:
        print_verdict(calibration.verdict)
    say(f"wrote {', '.join(str(path) for path in written if path is not None)}")


def _region_rule(text: str | None) -> Callable[[EdgeImage], Region | None]:
    if text is None:
        return lambda _: None
    from calibration.edges import Region

    if text == "centre":
        return lambda source: Region.centre(*source.frame)
    x, y, width, height = region_corner_and_size(text, "centre or X,Y,W,H in px")
    fixed = Region(x_px=x, y_px=y, width_px=width, height_px=height)
    return lambda _: fixed
