"""Scenes with depth: whether parallax explains what a plane leaves between two photographs."""

from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from analysis.changes._comparison import Comparison, compare
from analysis.changes._document import SceneHeights, SceneParallax
from analysis.changes._ends import is_of_two_levels
from analysis.changes._photograph_pair import ChangeOptions
from analysis.errors import AnalysisError
from calibration.parallax import (
    FrameCamera,
    Parallax,
    SeenParallax,
    Viewpoint,
    find_parallax,
    likely_viewpoint,
)
from calibration.registration import DistortedPose
from simulation import Psf, PsfField
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray
from simulation.by_value import ByValue
from simulation.pose import ideal_points, lens_of

_BEYOND_SD: Final = 5.0
_LEAST_SHARE: Final = 0.005
"""Share of the pixels that differ by so many standard deviations, from which on a plane may not be
all: of a flat scene without changes it is 6e-7."""

_TRIMMED_SD: Final = 6.0
_LEAST_ERR_PX: Final = 0.15
"""Registration error from which on it may not be, either: it hides what differs."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParallaxMap(ByValue):
    """Parallax on the follow-up's pixels, shape ``(rows, cols)`` each.

    ``parallax_px, error_px``: in follow-up pixels, towards the epipole, and its standard error; NaN
    where it is not known, the error also where it was interpolated. ``is_hidden``: pixels within
    both frames that only one photograph shows, or whose depth is not known.
    """

    parallax_px: Float32Array
    error_px: Float32Array
    is_hidden: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthComparison:
    """A comparison in which every pixel is at its depth; ``figures``: of the parallax."""

    pose: DistortedPose
    compared: Comparison
    parallax: ParallaxMap
    figures: SceneParallax


def _followup_parallax(found: Parallax) -> ParallaxMap:
    """Bring a parallax to the follow-up's pixels."""
    pose = found.pose
    depth, seen = pose.parallax, pose.followup_seen()
    assert depth is not None, "a pose with parallax"
    assert seen is not None, "a pose with parallax"
    parallax, error = found.parallax_px, found.parallax_err_px
    places = pose.followup_places_px()
    y, x = (at.astype(np.float32) for at in places)
    if depth.photograph == "reference":
        parallax = _displaced_px(pose, places, np.array(_followup_epipole(found)))
        # Of a reference's pixel, the follow-up's is 1 / zoom as large.
        error = cv2.remap(
            found.parallax_err_px, x, y, cv2.INTER_NEAREST, borderValue=(np.nan,) * 4
        ) / np.float32(pose.plane.zoom)
    rows, cols = pose.reference_shape
    inside = (y >= 0) & (y <= rows - 1) & (x >= 0) & (x <= cols - 1)
    unknown = np.float32(np.nan)
    return ParallaxMap(
        parallax_px=np.where(seen, parallax, unknown),
        error_px=np.where(seen, error, unknown),
        is_hidden=inside & ~seen,
    )


def _displaced_px(
    pose: DistortedPose, places: tuple[FloatArray, FloatArray], epipole: FloatArray
) -> Float32Array:
    """How far towards the epipole the plane has what the follow-up's pixels see.

    ``places``: of all of these in the reference.
    """
    back_y, back_x = pose.plane.to_followup_px(*places)
    y, x = np.indices(pose.followup_shape)
    moved_y, moved_x = back_y - y, back_x - x
    towards = moved_x * (epipole[0] - epipole[2] * x) + moved_y * (epipole[1] - epipole[2] * y)
    return np.asarray(np.copysign(np.hypot(moved_y, moved_x), towards), dtype=np.float32)


def _figures(found: Parallax, seen: ParallaxMap) -> SceneParallax:
    """Figures of a parallax, of which something is known."""
    pose, epipole = found.pose, _followup_epipole(found)
    viewpoint = None
    if pose.reference_shape == pose.followup_shape:
        viewpoint = likely_viewpoint(pose.matrix, np.array(epipole), pose.followup_shape)
    low, median, high = np.nanpercentile(seen.parallax_px, [1, 50, 99]).tolist()
    known = seen.error_px[np.isfinite(seen.error_px)]
    return SceneParallax(
        low_px=low,
        median_px=median,
        high_px=high,
        err_px=float(np.median(known)) if known.size else 0.0,
        epipole=epipole,
        features=found.matches,
        agreeing=found.agreeing,
        hidden_px=int(np.count_nonzero(seen.is_hidden)),
        held_out_gain=found.held_out_gain,
        larger_is=None if viewpoint is None else _larger_is(viewpoint, np.array(epipole)),
    )


def _larger_is(viewpoint: Viewpoint, epipole: FloatArray) -> Literal["nearer", "farther"]:
    return "nearer" if viewpoint.nearer_sign(epipole) > 0 else "farther"


def _followup_epipole(found: Parallax) -> tuple[float, float, float]:
    """The reference's camera as the follow-up sees it; a plane takes one epipole to the other."""
    depth = found.pose.parallax
    epipole = np.array(found.epipole_px)
    if depth is not None and depth.photograph == "reference":
        epipole = np.linalg.solve(found.pose.matrix, epipole)
    x, y, w = (epipole / np.linalg.norm(epipole)).tolist()
    return x, y, w


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthMap(ByValue):
    """Depth of what the follow-up's pixels see, shape ``(rows, cols)`` each, NaN where not known.

    ``depth_mm, error_mm``: distance along its optical axis, and the standard error. ``height_mm,
    height_error_mm``: above the plane of the pose, positive towards the camera, and its standard
    error. ``figures``: of the parallax, with those of the heights.
    """

    depth_mm: Float32Array
    error_mm: Float32Array
    height_mm: Float32Array
    height_error_mm: Float32Array
    figures: SceneParallax


def depth_in_mm(
    pose: DistortedPose,
    parallax: tuple[ParallaxMap, SceneParallax],
    camera: FrameCamera,
    reference_mm: float,
) -> DepthMap | None:
    """Depth by the geometry of the camera; None where the cameras' places do not follow.

    ``pose``: with that parallax. ``camera``: of both photographs. ``reference_mm``: distance of the
    reference's camera from the plane.
    """
    seen, figures = parallax
    epipole = np.array(figures.epipole)
    viewpoint = Viewpoint.of(pose.matrix, epipole, camera)
    if viewpoint is None or viewpoint.distance_ratio <= 0:
        return None
    rows, cols = pose.followup_shape
    y, x = (at.astype(np.float64) for at in np.indices((rows, cols)))
    if not viewpoint.sees_plane_at(x, y):
        return None
    if pose.k1 != 0:
        lens = lens_of(pose.k1, pose.reference_shape, pose.followup_shape)
        x, y = ideal_points(lens, np.column_stack([x.ravel(), y.ravel()])).T.reshape(2, rows, cols)
    found = viewpoint.heights(
        SeenParallax(
            epipole=epipole,
            x_px=x,
            y_px=y,
            parallax_px=seen.parallax_px.astype(np.float64),
            error_px=seen.error_px.astype(np.float64),
        )
    )
    distance_mm = reference_mm / viewpoint.distance_ratio
    height, error = ((distance_mm * one).astype(np.float32) for one in (found.height, found.error))
    low, median, high = np.nanpercentile(height, [1, 50, 99]).tolist()
    known = error[np.isfinite(error)]
    figured = SceneHeights(
        low_mm=low,
        median_mm=median,
        high_mm=high,
        err_mm=float(np.median(known)) if known.size else 0.0,
        distance_mm=distance_mm,
        baseline_mm=distance_mm * float(np.linalg.norm(viewpoint.centre)),
    )
    update = {"heights": figured, "larger_is": _larger_is(viewpoint, epipole)}
    along_axis = viewpoint.depth_of_plane(x, y).astype(np.float32)
    return DepthMap(
        depth_mm=(np.float32(distance_mm) - height) * along_axis,
        error_mm=error * along_axis,
        height_mm=height,
        height_error_mm=error,
        figures=figures.model_copy(update=update),
    )


def with_depth(
    photographs: tuple[AnyArray, AnyArray],
    psf: Psf | PsfField | None,
    pose: DistortedPose,
    options: ChangeOptions,
    compared: Comparison,
) -> DepthComparison | None:
    """Compare again with the parallax of the scene; None where a plane explains as much.

    ``photographs``: reference and follow-up, grey. ``pose, compared``: of the plane.
    """
    if options.flat or not _leaves_much(compared):
        return None
    if any(is_of_two_levels(photograph) for photograph in photographs):
        return None
    reference, followup = photographs
    found = find_parallax(reference, followup, pose)
    if found is None:
        return None
    parallax = _followup_parallax(found)
    try:
        again = compare(reference, followup, psf, found.pose, options)
    except AnalysisError:  # so little is seen in both that nothing can be compared
        return None
    if not (np.isfinite(parallax.parallax_px).any() and _explains_more(again, compared)):
        return None
    return DepthComparison(
        pose=found.pose, compared=again, parallax=parallax, figures=_figures(found, parallax)
    )


def _leaves_much(compared: Comparison) -> bool:
    beyond = np.abs(compared.significance[compared.valid]) > _BEYOND_SD
    return bool(compared.registration_err_px > _LEAST_ERR_PX or np.mean(beyond) > _LEAST_SHARE)


def _explains_more(again: Comparison, compared: Comparison) -> bool:
    """Whether less is left where both compare: of the levels, or beyond what is expected.

    Where a plane hides what differs in its registration error, the first tells; in noise, the
    second.
    """
    if again.is_on_followup != compared.is_on_followup:
        return True
    both = again.valid & compared.valid
    if not both.any():
        return False
    (levels, beyond), (levels_before, beyond_before) = (
        _left(one, both) for one in (again, compared)
    )
    return levels < levels_before or beyond < beyond_before


def _left(compared: Comparison, both: BoolArray) -> tuple[float, float]:
    """Mean difference, and mean square in standard deviations, at most so many a pixel."""
    difference = np.abs(compared.difference_dn[both])
    beyond = np.minimum(np.abs(compared.significance[both]), np.float32(_TRIMMED_SD))
    return float(np.mean(difference, dtype=np.float64)), float(
        np.mean(np.square(beyond, dtype=np.float64))
    )
