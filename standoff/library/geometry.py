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
        With a board, chart or texture at two or more heights.
    board
        The ChArUco board, or ``COLSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY]``.
    scale_px_per_mm
        At the lowest height, measured by other means.
    focal_length_px
        Instead of the bench file's.
    report
        Also write a report, HTML or PDF.
    progress
        Who watches.

    Returns
    -------
    GeometryCalibration
        With standard errors; ``notes`` and ``excluded`` say what to know of it, and
        ``write_geometry`` writes it.

    Raises
    ------
    ArgumentError
        If the board is not understood, or a number not positive.
    GeometryError
        If the captures do not determine it.

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
