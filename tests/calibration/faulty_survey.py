"""Surveys with one fault: heights that scatter, a rail that is not straight, a board that bends."""

from dataclasses import replace
from typing import Literal

import numpy as np

from calibration.geometry import GeometryCapture
from calibration.geometry._bundle_adjustment import Adjustment, PlaneMatches, adjust
from calibration.geometry._pupil import ConsistentSeries, without_outliers
from simulation.arrays import FloatArray
from tests.calibration.exact_survey import Survey
from tests.calibration.geometry_bench import (
    HEIGHTS_MM,
    PUPIL_MM,
    blank_captures,
    pinhole,
    poses_over,
    start_series,
)

Fault = Literal["heights", "travel", "sag"]
NOISE_PX = 0.03


def surveyed(
    seed: int, kind: str, fault: Fault | None = None, size: float = 0.0
) -> ConsistentSeries:
    """A survey of five heights; ``size`` is that of the fault, over the camera's distance.

    ``heights`` and ``travel`` are standard deviations of each height, and of each coordinate;
    ``sag`` the height of a ridge along y, two frames wide at the nearest capture, at its foot.
    """
    rng = np.random.default_rng(seed)
    heights = np.array(HEIGHTS_MM)
    distance_mm = heights + PUPIL_MM
    tilt = (0.0, 0.0) if fault == "sag" else (1.0, 0.5)
    poses = poses_over(heights.tolist(), tilt_deg=tilt, drift_mm_per_mm=(0.01, 0.0))
    read = heights + (size * distance_mm * rng.normal(size=5) if fault == "heights" else 0.0)
    if fault == "travel":
        aside = size * distance_mm[:, None] * rng.normal(size=(5, 2))
        poses = [
            replace(pose, offset_x_mm=pose.offset_x_mm + x, offset_y_mm=pose.offset_y_mm + y)
            for pose, (x, y) in zip(poses, aside.tolist(), strict=True)
        ]
    if fault == "sag":
        return without_outliers(_bent(seed, size))
    survey = Survey(noise_px=NOISE_PX, seed=seed)
    survey.add("target", poses, kind=kind, heights_mm=read.tolist())
    return without_outliers(survey.adjusted())


def _bent(seed: int, size: float) -> Adjustment:
    """Corners of a board whose middle is a ridge: a point at height z is seen beside its place."""
    rng, camera = np.random.default_rng(seed), pinhole()
    captures = [replace(one, kind="board") for one in blank_captures(HEIGHTS_MM)]
    poses = poses_over(HEIGHTS_MM, drift_mm_per_mm=(0.01, 0.0))
    nearest_mm = camera.distance_mm(HEIGHTS_MM[0])
    x, y = (axis.ravel() for axis in np.mgrid[-120.0:121.0:8.0, -96.0:97.0:8.0])
    # At the corner of the nearest capture, in direction x, the ridge has fallen by the size.
    reach_mm = nearest_mm * np.hypot(389, 289) / 2 / (8.0 / 16.6e-3)
    height_mm = -size * nearest_mm * (x / reach_mm) ** 2
    parts = []
    for capture, pose in zip(captures, poses, strict=True):
        beyond = height_mm / (camera.distance_mm(pose.height_mm) - height_mm)
        seen = np.column_stack(
            camera.to_pixel(
                x + (x - pose.offset_x_mm) * beyond, y + (y - pose.offset_y_mm) * beyond, pose
            )
        )
        inside = np.all((seen >= 4) & (seen <= (385, 285)), axis=1)
        noise = rng.normal(0, NOISE_PX, (int(inside.sum()), 2))
        parts.append(_points(capture, seen[inside] + noise, np.column_stack([x, y])[inside]))
    series = start_series(captures)
    start = tuple(
        replace(one, pose=replace(one.pose, log_distance=float(np.log(mm + PUPIL_MM))))
        for one, mm in zip(series.captures, HEIGHTS_MM, strict=True)
    )
    return adjust([replace(series, captures=start, is_in_mm=True)], parts)


def _points(capture: GeometryCapture, seen_px: FloatArray, plane_mm: FloatArray) -> PlaneMatches:
    return PlaneMatches(
        capture=capture,
        seen_px=seen_px,
        other=None,
        other_points=plane_mm,
        covariance_px2=np.tile(np.eye(2) * NOISE_PX**2, (len(seen_px), 1, 1)),
    )
