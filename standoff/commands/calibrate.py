"""``standoff calibrate``: the PSF from photographs of edges."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

from acquisition.session import Session
from calibration.covariance_fit import Estimate
from calibration.edge_captures import edge_images, edge_records
from calibration.errors import CalibrationError
from calibration.files import psf_document, write_psf
from calibration.linearise import Channel, luma_plane, srgb_to_linear
from calibration.psf_calibration import EdgeImage, PsfCalibration, Region, calibrate_psf
from standoff.image_files import ImageFile, read_image
from standoff.options import Json, refuse_overwriting
from standoff.output import note, print_json, print_table, progress_bar, say
from standoff.reports import write_calibration_report

__all__ = ["calibrate"]


Method = Literal["all-angles"]

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
    method: Annotated[Method, typer.Option(help="How to measure.")] = "all-angles",
    region: Annotated[
        str | None, typer.Option(help="Part of the image to use: centre, or X,Y,W,H in px.")
    ] = None,
    srgb: Annotated[
        bool, typer.Option("--srgb/--linear", help="Undo the sRGB curve, or take as linear.")
    ] = False,
    channel: Annotated[Channel, typer.Option(help="Plane of colour photographs.")] = "luma",
    report: Annotated[Path | None, typer.Option(help="Also write an HTML report.")] = None,
    json: Json = False,
) -> None:
    """Measure the camera's PSF from photographs of straight edges, at any angle."""
    refuse_overwriting([out, report], images or [])
    chosen = _region_rule(region)
    if (session is None) == (not images):
        raise typer.BadParameter("give either photographs or --session DIR", param_hint="IMAGE...")
    if session is not None:
        opened = Session.open(session)
        records = {record.file: record for record in edge_records(opened)}
        count = len(records)
        sources = edge_images(opened)

        def load_image(name: str) -> NDArray[np.floating[Any]]:
            return opened.load(records[name]).mean_dn

    else:
        paths = images or []
        count = len(paths)
        sources = _photographs(paths, srgb=srgb, channel=channel)

        def load_image(name: str) -> NDArray[np.floating[Any]]:
            return _edge_image(read_image(Path(name)), srgb=srgb, channel=channel).image_dn

    with progress_bar("measuring edges", count) as bar:
        try:
            calibration = calibrate_psf(sources, region=chosen, progress=bar.advance_to)
        except ValueError as error:
            raise CalibrationError(str(error)) from error
    write_psf(out, calibration)
    _print_remarks(calibration)
    if report is not None:
        write_calibration_report(report, calibration, load_image)
    if json:
        print_json(psf_document(calibration))
        return
    used = calibration.edges_used
    say(f"{len(used)} of {len(calibration.edges)} edges used")
    print_table(
        "PSF",
        ["", "total", "95 % interval", "optical", "95 % interval"],
        [
            [name, *_cells(total), *_cells(optical)]
            for name, total, optical in (
                ("sigma_x / px", calibration.sigma_x_px, calibration.optical_sigma_x_px),
                ("sigma_y / px", calibration.sigma_y_px, calibration.optical_sigma_y_px),
                ("rho", calibration.rho, calibration.optical_rho),
            )
        ],
    )
    say(f"wrote {out}" + (f" and {report}" if report else ""))


def _cells(estimate: Estimate | None) -> list[str]:
    if estimate is None:
        return ["not determined", ""]
    return [f"{estimate.value:.4f}", f"{estimate.low:.4f} to {estimate.high:.4f}"]


def _photographs(paths: list[Path], *, srgb: bool, channel: Channel) -> Iterator[EdgeImage]:
    for path in paths:
        file = read_image(path)
        if channel == "luma" and file.is_colour:
            note(f"{path}: colour read as Rec. 601 luma; --channel picks one colour")
        yield _edge_image(file, srgb=srgb, channel=channel)


def _edge_image(file: ImageFile, *, srgb: bool, channel: Channel) -> EdgeImage:
    pixels = srgb_to_linear(file.pixels, file.full_scale_dn or 1.0) if srgb else file.pixels
    try:
        plane = luma_plane(pixels, channel)
    except ValueError as error:
        raise CalibrationError(f"{file.path}: {error}") from error
    return EdgeImage(
        name=str(file.path),
        image_dn=plane,
        saturation_dn=file.saturation_dn,
        is_jpeg=file.is_jpeg,
    )


def _region_rule(text: str | None) -> Callable[[EdgeImage], Region | None]:
    if text is None:
        return lambda _: None
    if text == "centre":
        return lambda source: Region.centre(*source.image_dn.shape)
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
