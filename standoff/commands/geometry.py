"""``standoff geometry``: scale, pupil offset, zooms, distortion and squareness of a session."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import BadParameter, Option

from standoff import library, terminal

if TYPE_CHECKING:
    from calibration.geometry import CharucoBoard, GeometryCalibration

_SOURCES = {
    "board": "the board {board}",
    "given": "the scale that was given",
    "bench": "the focal length and pixel pitch of the bench file, taken as exact",
}


@terminal.command()
def geometry(
    *,
    session: Path,
    out: Annotated[Path, terminal.Result(".json")],
    board: terminal.Board,
    scale_px_per_mm: Annotated[float | None, Option("--scale")] = None,
    focal_length_px: Annotated[
        float | None, Option(parser=terminal.quantity("focal_length_px"))
    ] = None,
    report: Annotated[Path | None, terminal.REPORT] = None,
) -> None:
    """Measure px/mm, entrance pupil, true zooms, distortion and squareness from a height series.

    Options
    -------
    session: Capture session of a board, chart or texture at two or more heights.
    out: Where to write geometry.json.
    scale_px_per_mm: Scale in px/mm at the lowest height, measured by other means.
    focal_length_px: Focal length in px, instead of the bench file's.
    report: Also write a report (HTML).
    """
    for option, value in (("--scale", scale_px_per_mm), ("--focal-length-px", focal_length_px)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise BadParameter(f"expected a number above 0, got {value:g}", param_hint=option)
    found = library.calibrate_geometry(session, **terminal.keywords_of(library.calibrate_geometry))
    library.write_geometry(out, found)
    wrote = f"wrote {out}" + (f" and {report}" if report else "")
    terminal.answer(found, lambda: _print(found, board, wrote))


def _print(found: GeometryCalibration, board: CharucoBoard, wrote: str) -> None:
    cells, factor = terminal.value_cells, found.fit_factor
    pupil_mm, pupil_err_mm = found.pupil_offset_mm, found.pupil_offset_err_mm
    drift, drift_err = found.axis_drift_px_per_mm, found.axis_drift_err_px_per_mm
    focal_px, focal_err_px = found.focal_length_px, found.focal_length_err_px
    terminal.print_table(
        "Geometry",
        ["", "value", "± at 95 %"],
        [
            ["entrance pupil above height 0 / mm", *cells(pupil_mm, pupil_err_mm, 3, factor)],
            ["focal length / px", *cells(focal_px, focal_err_px, 2, factor)],
            ["k1, at the image corner", *cells(found.k1, found.k1_err, 5)],
            ["k2, at the image corner", *cells(found.k2, found.k2_err, 5)],
            ["tilt of target to sensor / deg", *cells(found.tilt_deg, found.tilt_err_deg, 4)],
            ["drift of the axis / (px/mm)", *cells(drift, drift_err, 5)],
        ],
    )
    scales, errs = found.scale_px_per_mm, found.scale_err_px_per_mm
    if scales is not None and errs is not None and found.scale_source is not None:
        lowest = found.heights_mm[0]
        terminal.print_table(
            f"Heights (scale by {_SOURCES[found.scale_source].format(board=board)})",
            ["height / mm", "scale / (px/mm)", "± at 95 %", f"zoom from {lowest:g} mm"],
            [
                [f"{height:g}", *cells(scale, err, 5, factor), f"{found.zoom(lowest, height):.5f}"]
                for height, scale, err in zip(found.heights_mm, scales, errs, strict=True)
            ],
        )
    terminal.say(
        *(f"{name} is not determined: {why}" for name, why in found.undetermined.items()), wrote
    )
