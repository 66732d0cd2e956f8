"""``standoff geometry``: scale, pupil offset, zooms, distortion and squareness of a session."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.choices import DEFAULT_BOARD_TEXT
from standoff.terminal import (
    Force,
    Json,
    ShownProgress,
    print_json,
    print_table,
    quantity,
    refuse_overwriting,
    say,
)

if TYPE_CHECKING:
    from calibration.geometry import CharucoBoard, GeometryCalibration


_SOURCES = {
    "board": "the board {board}",
    "given": "the scale that was given",
    "bench": "the focal length and pixel pitch of the bench file, taken as exact",
}


def geometry(
    *,
    session: Annotated[
        Path,
        typer.Option(help="Capture session of a board, chart or texture at two or more heights."),
    ],
    out: Annotated[Path, typer.Option(help="Where to write geometry.json.")],
    board: Annotated[
        str,
        typer.Option(
            metavar="COLSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY]", help="The ChArUco board."
        ),
    ] = DEFAULT_BOARD_TEXT,
    scale: Annotated[
        float | None,
        typer.Option(help="Scale in px/mm at the lowest height, measured by other means."),
    ] = None,
    focal_length_px: Annotated[
        float | None,
        typer.Option(
            help="Focal length in px, instead of the bench file's.",
            parser=quantity("focal_length_px"),
        ),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Also write a report (HTML).")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure px/mm, entrance pupil, true zooms, distortion and squareness from a height series."""
    refuse_overwriting([out, report], force=force)
    from calibration.documents import json_object
    from calibration.geometry import CharucoBoard
    from standoff.library import calibrate_geometry, write_geometry

    try:
        layout = CharucoBoard.from_text(board)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--board") from error
    for option, value in (("--scale", scale), ("--focal-length-px", focal_length_px)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise typer.BadParameter(f"expected a number above 0, got {value:g}", param_hint=option)
    found = calibrate_geometry(
        session,
        board=layout,
        scale_px_per_mm=scale,
        focal_length_px=focal_length_px,
        report=report,
        progress=ShownProgress(),
    )
    write_geometry(out, found)
    if json:
        print_json(json_object(found))
        return
    _print(found, layout)
    say(f"wrote {out}" + (f" and {report}" if report else ""))


def _print(found: GeometryCalibration, board: CharucoBoard) -> None:
    from calibration.sharpness import NORMAL_95

    factor = found.fit_factor
    print_table(
        "Geometry",
        ["", "value", "± at 95 %"],
        [
            ["entrance pupil above height 0 / mm",
             *_cells(found.pupil_offset_mm, found.pupil_offset_err_mm, 3, factor)],
            ["focal length / px",
             *_cells(found.focal_length_px, found.focal_length_err_px, 2, factor)],
            ["k1, at the image corner", *_cells(found.k1, found.k1_err, 5, NORMAL_95)],
            ["k2, at the image corner", *_cells(found.k2, found.k2_err, 5, NORMAL_95)],
            ["tilt of target to sensor / deg",
             *_cells(found.tilt_deg, found.tilt_err_deg, 4, NORMAL_95)],
            ["drift of the axis / (px/mm)",
             *_cells(found.axis_drift_px_per_mm, found.axis_drift_err_px_per_mm, 5, NORMAL_95)],
        ],
    )  # fmt: skip
    scales, errs = found.scale_px_per_mm, found.scale_err_px_per_mm
    if scales is not None and errs is not None and found.scale_source is not None:
        lowest = found.heights_mm[0]
        print_table(
            f"Heights (scale by {_SOURCES[found.scale_source].format(board=board)})",
            ["height / mm", "scale / (px/mm)", "± at 95 %", f"zoom from {lowest:g} mm"],
            [
                [f"{height:g}", *_cells(scale, err, 5, factor), f"{found.zoom(lowest, height):.5f}"]
                for height, scale, err in zip(found.heights_mm, scales, errs, strict=True)
            ],
        )  # fmt: skip
    for name, reason in found.undetermined.items():
        say(f"{name} is not determined: {reason}")


def _cells(value: float | None, err: float | None, digits: int, factor: float) -> list[str]:
    """A value and half its 95 % interval, ``factor`` standard errors."""
    if value is None or err is None:
        return ["not determined", ""]
    return [f"{value:.{digits}f}", f"{factor * err:.{digits}f}"]
