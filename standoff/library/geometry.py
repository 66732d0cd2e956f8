"""Scale, entrance pupil, zooms, distortion and squareness of a height series."""

from acquisition.files import PAGES, write_page
from acquisition.session import Session
from analysis.reports import geometry_report
from calibration.choices import DEFAULT_BOARD_TEXT
from calibration.geometry import (
    CharucoBoard,
    GeometryCalibration,
    GeometryOptions,
    geometry_captures,
    geometry_of_captures,
    geometry_records,
    nominal_focal_px,
)
from simulation.arguments import checked
from standoff.errors import ArgumentError
from standoff.library.call import Call, FilePath, Progress, opened_session, output_path


@checked
def calibrate_geometry(
    session: Session | FilePath,
    *,
    board: CharucoBoard | str = DEFAULT_BOARD_TEXT,
    scale_px_per_mm: float | None = None,
    focal_length_px: float | None = None,
    report: FilePath | None = None,
    progress: Progress | None = None,
) -> GeometryCalibration:
    """Measure px/mm, entrance pupil, true zooms, distortion and squareness from a height series.

    Parameters
    ----------
    session
        A session, or its folder, with a board, chart or texture at two or more heights.
    board
        The ChArUco board, as an object or as a text
        ``COLSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY]``.
    scale_px_per_mm
        Scale at the lowest height, if it was measured by other means.
    focal_length_px
        Focal length in px; by default that of the bench file.
    report
        Path of a report to write as well, HTML or PDF.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    GeometryCalibration
        The geometry with standard errors. ``excluded`` lists captures that were not used,
        ``notes`` anything unusual; ``write_geometry`` writes it to a file.

    Raises
    ------
    ArgumentError
        If the board is not understood, or a number not positive.
    GeometryError
        If the captures do not determine the geometry.

    Examples
    --------
    >>> geometry = standoff.calibrate_geometry("board")
    >>> round(geometry.zoom(160, 300), 3)
    1.812
    """
    page = None if report is None else output_path(report, "report", PAGES)
    try:
        layout = board if isinstance(board, CharucoBoard) else CharucoBoard.from_text(board)
    except ValueError as error:
        raise ArgumentError(str(error), argument="board") from error
    call = Call("calibrate_geometry", progress)
    opened = opened_session(session)
    options = GeometryOptions(
        nominal_focal_px=focal_length_px or nominal_focal_px(opened),
        scale_px_per_mm=scale_px_per_mm,
        board=layout,
    )
    with call.bar("matching captures", len(geometry_records(opened))) as advance_to:
        found = geometry_of_captures(list(geometry_captures(opened)), options, advance_to)
    found = found.model_copy(update={"provenance": call.provenance_of(opened)})
    for one in found.excluded:
        call.note(f"{one.image} is left out: {one.reason}")
    for text in found.notes:
        call.note(text)
    if found.scale_source == "board":
        call.note(f"the scale comes from the board {layout}; --board names another")
    if page is not None:
        write_page(page, geometry_report(found, str(opened.path)).html())
    return found
