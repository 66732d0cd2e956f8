"""What is said of where a follow-up was taken from."""

from math import atan2, degrees, hypot

import numpy as np

from calibration.registration import DistortedPose

_SAME = 0.005  # relative; a zoom of half a per cent is not worth a word


def describe_pose(pose: DistortedPose) -> str:
    """Say where a follow-up was taken from, against its reference, in an operator's words."""
    rows, cols = pose.followup_shape
    middle_y, middle_x = (rows - 1) / 2, (cols - 1) / 2
    y, x = pose.to_reference_px(
        np.array([middle_y, middle_y]), np.array([middle_x - 0.5, middle_x + 0.5])
    )
    reference_rows, reference_cols = pose.reference_shape
    aside_px = hypot(
        float(x.mean()) - (reference_cols - 1) / 2, float(y.mean()) - (reference_rows - 1) / 2
    )
    turn_deg = degrees(atan2(float(y[1] - y[0]), float(x[1] - x[0])))
    return (
        f"{_distance_text(pose.zoom)}, turned by {turn_deg:.1f} degrees, aside by "
        f"{aside_px:.0f} px ({100 * aside_px / reference_cols:.0f} % of the frame)"
    )


def _distance_text(zoom: float) -> str:
    if abs(zoom - 1) < _SAME:
        return f"the same distance (zoom {zoom:.3f})"
    return f"{'further away' if zoom > 1 else 'nearer'} (zoom {zoom:.3f})"
