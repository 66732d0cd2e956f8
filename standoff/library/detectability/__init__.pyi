from .error_sources import known_errors as known_errors
from .known_pose import JudgedHomography as JudgedHomography, judge_homography as judge_homography
from .limits import (
    AllowedMovement as AllowedMovement,
    CurveChoice as CurveChoice,
    CurveLike as CurveLike,
    DetectionTask as DetectionTask,
    d_prime_curves as d_prime_curves,
    given_curve as given_curve,
    pose_limits as pose_limits,
    read_any_curves as read_any_curves,
    write_curves as write_curves,
)
from .measured_curves import (
    MeasuredCurves as MeasuredCurves,
    curve_figure_paths as curve_figure_paths,
    curve_table_path as curve_table_path,
    curves_made_by as curves_made_by,
    measure_curves as measure_curves,
    state_of_curves as state_of_curves,
)
