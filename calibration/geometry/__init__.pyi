from ._board import (
    DEFAULT_BOARD as DEFAULT_BOARD,
    CharucoBoard as CharucoBoard,
    Levelling as Levelling,
    find_board as find_board,
    level_by_board as level_by_board,
    level_by_focus as level_by_focus,
)
from ._bundle_adjustment import (
    LENS_SIZE as LENS_SIZE,
    SHARED_SIZE as SHARED_SIZE,
    GeometryCapture as GeometryCapture,
    LensPrior as LensPrior,
    PlaneLens as PlaneLens,
)
from ._calibration import (
    GeometryOptions as GeometryOptions,
    geometry_captures as geometry_captures,
    geometry_of_captures as geometry_of_captures,
    geometry_records as geometry_records,
    nominal_focal_px as nominal_focal_px,
)
from ._document import (
    CaptureGeometry as CaptureGeometry,
    ExcludedCapture as ExcludedCapture,
    GeometryCalibration as GeometryCalibration,
    HeightZoom as HeightZoom,
    captures_by_target as captures_by_target,
    draw_scale_by_height as draw_scale_by_height,
    target_colours as target_colours,
)
