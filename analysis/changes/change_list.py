"""The list of changes: connected pixels beyond the threshold, each with place and amplitude."""

import numpy as np
from scipy.spatial import cKDTree

from analysis.changes.comparison import Comparison
from analysis.changes.document import Change
from analysis.changes.false_discovery import q_values
from analysis.changes.peaks import ConnectedPeaks, connected_peaks
from analysis.changes.spot_fit import NEIGHBOUR_REACH, FittedSpot, fit_spot, level_at
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray

_MOST_FITTED = 300
"""Changes whose shape is fitted; a frame with more is another scene, and the rest get levels."""


def list_changes(
    compared: Comparison, pose: DistortedPose, threshold_sd: float
) -> tuple[Change, ...]:
    """List the connected changes of one sign, the most significant first.

    Parameters
    ----------
    compared
        The smoothed difference with its standard deviation.
    pose
        Of the follow-up in the reference: gives the places in the photograph that is not the grid.
    threshold_sd
        Standard deviations beyond which a pixel counts as changed.
    """
    peaks = connected_peaks(compared.significance, threshold_sd)
    if not len(peaks):
        return ()
    spots = _fitted(compared, peaks)
    y, x = np.array([(spot.y_px, spot.x_px) for spot in spots]).T
    if compared.is_on_followup:
        followup, reference = (y, x), pose.to_reference_px(y, x)
        scale = np.ones(len(peaks))
    else:
        followup, reference = pose.to_followup_px(y, x), (y, x)
        scale = _followup_px_by_pixel(pose, y, x)
    q_value = q_values(peaks.significance, int(compared.valid.sum()), compared.smoothing_px)
    columns = np.stack([
        followup[1], followup[0], reference[1], reference[0],
        peaks.area_px * scale, peaks.significance, q_value,
    ], axis=1)  # fmt: skip
    return tuple(
        Change(
            x_px=row[0],
            y_px=row[1],
            reference_x_px=row[2],
            reference_y_px=row[3],
            area_px=row[4],
            amplitude_dn=spot.amplitude_dn,
            amplitude_err_dn=spot.amplitude_err_dn,
            significance=row[5],
            q_value=row[6],
        )
        for row, spot in zip(columns.tolist(), spots, strict=True)
    )


def _fitted(compared: Comparison, peaks: ConnectedPeaks) -> list[FittedSpot]:
    at = np.stack([peaks.row, peaks.col], axis=1)
    reach = NEIGHBOUR_REACH * compared.smoothing_px
    tree = cKDTree(at)
    near = tree.query_ball_tree(tree, reach)
    spots = []
    for index, peak in enumerate(at):
        if index >= _MOST_FITTED:
            spots.append(level_at(compared, (int(peak[0]), int(peak[1]))))
            continue
        others = np.array([other for other in near[index] if other != index], dtype=np.int64)
        distance = np.linalg.norm(at[others] - peak, axis=1)
        nearest = at[others[np.argsort(distance, kind="stable")]]
        spots.append(fit_spot(compared, (int(peak[0]), int(peak[1])), nearest))
    return spots


def _followup_px_by_pixel(pose: DistortedPose, y: FloatArray, x: FloatArray) -> FloatArray:
    """Follow-up pixels that one pixel of the reference covers."""
    down = np.subtract(pose.to_followup_px(y + 0.5, x), pose.to_followup_px(y - 0.5, x))
    right = np.subtract(pose.to_followup_px(y, x + 0.5), pose.to_followup_px(y, x - 0.5))
    return np.asarray(np.abs(down[0] * right[1] - down[1] * right[0]))
