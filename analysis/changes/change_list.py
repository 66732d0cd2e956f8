"""The list of changes, each with its place, amplitude and size."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from analysis.changes.comparison import Comparison
from analysis.changes.detection import (
    DetectionLevel,
    LinkedRegion,
    q_values,
)
from analysis.changes.document import Change
from analysis.changes.spot_fit import NEIGHBOUR_REACH, FittedSpot, SmoothedField, fit_spot
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray

_SURE = 2.0
"""Times the height of the strongest of many values of noise, by which a peak must be higher."""

_MOST_FITTED = 300
"""Changes whose shape is fitted; a frame with more is another scene, and the rest get levels."""


def list_changes(
    regions: Sequence[LinkedRegion],
    levels: Sequence[DetectionLevel],
    compared: Comparison,
    pose: DistortedPose,
) -> tuple[Change, ...]:
    """Describe changes, in their order.

    Parameters
    ----------
    regions
        What stands out, the most significant first.
    levels
        The difference behind each width, the narrowest first.
    compared
        The difference itself.
    pose
        Of the follow-up in the reference: gives the places in the photograph that is not the grid.
    """
    if not regions:
        return ()
    spots = _fitted(regions, levels, compared)
    y, x = np.array([(spot.y_px, spot.x_px) for spot in spots]).T
    area_px = np.array([len(region.rows) for region in regions], dtype=np.float64)
    sigma_px = np.array([spot.sigma_px for spot in spots])
    followup, reference = places_in_both(compared, pose, y, x)
    if not compared.is_on_followup:
        scale = _followup_px_by_pixel(pose, y, x)
        area_px, sigma_px = area_px * scale, sigma_px * np.sqrt(scale)
    heights = np.abs([region.significance for region in regions])
    compared_px = int(np.count_nonzero(compared.valid))
    q_value = q_values(heights, compared_px, [level.filter_width for level in levels])
    columns = np.stack(
        [followup[1], followup[0], reference[1], reference[0], area_px, sigma_px, heights, q_value],
        axis=1,
    )
    return tuple(
        Change(
            x_px=row[0],
            y_px=row[1],
            reference_x_px=row[2],
            reference_y_px=row[3],
            area_px=row[4],
            spot_sigma_px=row[5],
            amplitude_dn=spot.amplitude_dn,
            amplitude_err_dn=spot.amplitude_err_dn,
            significance=row[6],
            q_value=row[7],
        )
        for row, spot in zip(columns.tolist(), spots, strict=True)
    )


def places_in_both(
    compared: Comparison, pose: DistortedPose, y: FloatArray, x: FloatArray
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Places ``(y, x)`` of the grid's pixels in the follow-up, and in the reference."""
    if compared.is_on_followup:
        return (y, x), pose.to_reference_px(y, x)
    return pose.to_followup_px(y, x), (y, x)


def _fitted(
    regions: Sequence[LinkedRegion], levels: Sequence[DetectionLevel], compared: Comparison
) -> list[FittedSpot]:
    fields = [SmoothedField.of_comparison(compared), *map(SmoothedField.of, levels)]
    at = np.array([(region.row, region.col) for region in regions])
    tree = cKDTree(at)
    spots = []
    for index, region in enumerate(regions):
        if index >= _MOST_FITTED:
            spots.append(_as_it_stands(region, fields))
            continue
        # One level narrower than the one that finds it best: there its shape is still seen.
        field = fields[region.level if region.level > 1 else 0]
        near = tree.query_ball_point(at[index], NEIGHBOUR_REACH * field.width_px)
        others = np.array([other for other in near if other != index], dtype=np.int64)
        distance = np.linalg.norm(at[others] - at[index], axis=1)
        nearest = at[others[np.argsort(distance, kind="stable")]]
        spots.append(
            fit_spot(field, (region.row, region.col), nearest) or _as_it_stands(region, fields)
        )
    return spots


def _as_it_stands(region: LinkedRegion, fields: Sequence[SmoothedField]) -> FittedSpot:
    """Take the strongest place for the peak of a change that is no spot, and its pixels for a disc.

    Of the fields that are no wider than the one that finds it best, the one that is surest of the
    peak tells: the narrower ones have the more noise, the wider ones less of what is narrow. A disc
    has the second moments of a Gaussian half as wide as its radius.
    """
    best: tuple[float, FittedSpot] | None = None
    for field in fields[: region.level + 2]:
        last = np.subtract(field.valid.shape, 1)
        rows = np.minimum(np.rint(region.rows / field.step_px).astype(np.int64), last[0])
        cols = np.minimum(np.rint(region.cols / field.step_px).astype(np.int64), last[1])
        counts = field.valid[rows, cols]
        if not counts.any():
            continue
        rows, cols = rows[counts], cols[counts]
        sd_dn = field.sd_dn[rows, cols]
        signed = field.difference_dn[rows, cols] * np.sign(region.significance)
        top = int(np.argmax(signed / sd_dn))
        independent = len(region.rows) / (4 * np.pi * field.width_px**2)
        chance = np.sqrt(2 * np.log(max(independent, math.e)))
        surely = float(signed[top] - _SURE * chance * sd_dn[top])
        if best is None or surely > best[0]:
            best = (
                surely,
                FittedSpot(
                    y_px=float(rows[top] * field.step_px),
                    x_px=float(cols[top] * field.step_px),
                    amplitude_dn=float(field.difference_dn[rows[top], cols[top]]),
                    amplitude_err_dn=float(sd_dn[top]),
                    sigma_px=float(np.sqrt(len(region.rows) / np.pi) / 2),
                ),
            )
    assert best is not None, "a region has pixels that were compared"
    return best[1]


def _followup_px_by_pixel(pose: DistortedPose, y: FloatArray, x: FloatArray) -> FloatArray:
    """Follow-up pixels that one pixel of the reference covers."""
    down = np.subtract(pose.to_followup_px(y + 0.5, x), pose.to_followup_px(y - 0.5, x))
    right = np.subtract(pose.to_followup_px(y, x + 0.5), pose.to_followup_px(y, x - 0.5))
    return np.asarray(np.abs(down[0] * right[1] - down[1] * right[0]))
