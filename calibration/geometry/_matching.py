"""Captures matched within each target, and all of them adjusted together.

Textured captures are matched by their features with the next capture in height, and with the one
after it if that fails; the largest connected group is kept. Then all their pixels are matched. The
corners of a board have known positions.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from math import atan2, log, sqrt
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, gaussian_filter, map_coordinates

from calibration.errors import GeometryError, RegistrationError
from calibration.geometry._board import BoardCorners, CharucoBoard, find_board
from calibration.geometry._bundle_adjustment import (
    Adjustment,
    CapturePose,
    Exclusion,
    GeometryCapture,
    LensPrior,
    PlaneLens,
    PlaneMatches,
    PosedCapture,
    Series,
    adjust,
)
from calibration.registration import ImageFeatures, find_features, homography_pose
from simulation.arrays import BoolArray, FloatArray
from simulation.pose import project, projection_slopes

_Value = TypeVar("_Value", bound=np.generic)

BLOCK_PX = 32
"""Side of a block: some tens of texture grains, and still hundreds of blocks per capture."""

_BLUR_PX = 0.65
"""Total PSF assumed for blurring the nearer capture to the further one's sharpness.

A wrong width blurs every detail symmetrically, and so moves nothing.
"""
_BORDER_PX = 3.0
_CORRELATION_MIN = 0.8
_SHIFT_MAX_PX = 1.0
_ERROR_MAX_PX = 0.3
_CONDITION_MAX = 1e12
_UNKNOWNS = 6
_RAMPS = tuple(
    ramp.ravel() for ramp in np.meshgrid(*[np.linspace(-1.0, 1.0, BLOCK_PX)] * 2, indexing="xy")
)
_SLOPE_WEIGHTS = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12
_ERROR_FLOOR_PX = 0.01
"""Approximate error of a block's shift by aliasing; it keeps single blocks from dominating."""


def _match_blocks(
    lens: PlaneLens, nears: Sequence[PosedCapture], far: PosedCapture
) -> list[PlaneMatches]:
    """Find each block of the furthest capture in nearer ones.

    The nearer capture is blurred to the further one's sharpness and sampled at the positions given
    by the two poses; the remaining shift of every block is found by least squares, with its gain,
    the slopes of the gain (vignetting) and its offset free. The poses are right to a fraction of a
    pixel, the lens is inclined as it is to the target.

    References
    ----------
    A. Gruen, "Adaptive least squares correlation: a powerful image matching technique", South
    African Journal of Photogrammetry, Remote Sensing and Cartography 14 (3), 1985.
    """
    image = np.asarray(far.capture.image, dtype=np.float64)
    rows, cols = (size // BLOCK_PX * BLOCK_PX for size in image.shape)
    top, left = (image.shape[0] - rows) // 2, (image.shape[1] - cols) // 2
    y, x = np.mgrid[top : top + rows, left : left + cols].astype(np.float64)
    plane = far.pose.plane(lens.slopes(np.column_stack([x.ravel(), y.ravel()])))
    blocks = _Blocks(
        measured=image[top : top + rows, left : left + cols],
        plane=plane.reshape(rows, cols, 2),
        x_px=x[0],
        y_px=y[:, 0],
    )
    return [_match(lens, near, far, blocks) for near in nears]


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """The whole blocks of a capture: levels, plane points and pixel coordinates."""

    measured: FloatArray
    plane: FloatArray
    x_px: FloatArray
    y_px: FloatArray


def _match(lens: PlaneLens, near: PosedCapture, far: PosedCapture, blocks: _Blocks) -> PlaneMatches:
    simulated, whole = _simulated(lens, near, far, blocks.plane)
    slope_y, slope_x = (_slope(simulated, axis) for axis in (0, 1))
    levels = _flat(simulated, whole)
    design = np.stack(
        [
            _flat(slope_x, whole),
            _flat(slope_y, whole),
            levels,
            np.ones_like(levels),
            *(levels * ramp for ramp in _RAMPS),
        ],
        axis=2,
    )
    target = _flat(blocks.measured, whole)
    # Centred levels keep the equations well conditioned.
    for column in (2, 4, 5):
        design[:, :, column] -= design[:, :, column].mean(axis=1, keepdims=True)
    target = target - target.mean(axis=1, keepdims=True)
    transposed = design.swapaxes(1, 2)
    normal = transposed @ design
    good = np.linalg.cond(normal) < _CONDITION_MAX
    inverse = np.linalg.inv(np.where(good[:, None, None], normal, np.eye(_UNKNOWNS)))
    solution = (inverse @ (transposed @ target[:, :, None]))[:, :, 0]
    residual = target - (design @ solution[:, :, None])[:, :, 0]
    left_over = np.sum(residual**2, axis=1)
    gain = np.where(solution[:, 2] > 0, solution[:, 2], np.inf)
    shift = solution[:, :2] / gain[:, None]
    variance = left_over / (design.shape[1] - _UNKNOWNS) / gain**2
    covariance = inverse[:, :2, :2] * variance[:, None, None]
    good &= np.isfinite(gain)
    good &= left_over < (1 - _CORRELATION_MIN**2) * np.sum(target**2, axis=1)
    good &= np.hypot(shift[:, 0], shift[:, 1]) < _SHIFT_MAX_PX
    good &= np.trace(covariance, axis1=1, axis2=2) < _ERROR_MAX_PX**2
    centre_y, centre_x = np.meshgrid(
        blocks.y_px.reshape(-1, BLOCK_PX).mean(axis=1),
        blocks.x_px.reshape(-1, BLOCK_PX).mean(axis=1),
        indexing="ij",
    )
    centres = np.column_stack([centre_x.ravel(), centre_y.ravel()])[whole][good]
    moved = far.pose.plane(lens.slopes(centres + shift[good]))
    return PlaneMatches(
        capture=far.capture,
        seen_px=centres,
        other=near.capture,
        other_points=lens.pixels(near.pose.slopes(moved)),
        covariance_px2=covariance[good] + np.eye(2) * _ERROR_FLOOR_PX**2,
    )


def _simulated(
    lens: PlaneLens, near: PosedCapture, far: PosedCapture, plane: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The nearer capture on the further one's pixels, and which blocks are completely inside it."""
    rows, cols = plane.shape[:2]
    image = np.asarray(near.capture.image, dtype=np.float64)
    source = lens.pixels(near.pose.slopes(plane.reshape(-1, 2))).reshape(rows, cols, 2)
    height, width = image.shape
    inside = (
        (source[:, :, 0] > _BORDER_PX)
        & (source[:, :, 0] < width - 1 - _BORDER_PX)
        & (source[:, :, 1] > _BORDER_PX)
        & (source[:, :, 1] < height - 1 - _BORDER_PX)
    )
    zoom = far.pose.distance / near.pose.distance
    blurred = gaussian_filter(image, _BLUR_PX * sqrt(max(zoom**2 - 1, 0.0)), mode="nearest")
    simulated = np.zeros((rows, cols))
    simulated[inside] = map_coordinates(
        blurred, [source[inside, 1], source[inside, 0]], order=3, mode="nearest"
    )
    return simulated, _blocks(inside).all(axis=(2, 3)).ravel()


def _slope(image: FloatArray, axis: int) -> FloatArray:
    """Fourth-order derivative: a second-order one comes out too small for fine detail."""
    return np.asarray(correlate1d(image, _SLOPE_WEIGHTS, axis=axis, mode="nearest"))


def _blocks(image: NDArray[_Value]) -> NDArray[_Value]:
    """Blocks of an image, shape (block rows, block columns, side, side)."""
    rows, cols = image.shape
    cut = image.reshape(rows // BLOCK_PX, BLOCK_PX, cols // BLOCK_PX, BLOCK_PX)
    return cut.swapaxes(1, 2)


def _flat(image: FloatArray, chosen: BoolArray) -> FloatArray:
    """Pixels of the chosen blocks, shape (blocks, pixels)."""
    return _blocks(image).reshape(-1, BLOCK_PX * BLOCK_PX)[chosen]


_FEATURE_ERROR_PX = 0.4
_REACH = 2
"""A capture is matched with the next one and, if that fails, with the one after it."""
_STRIDES = (1, 2, 3, 5, 8, 13)
"""All pixels of a capture are matched with those this many steps nearer, and with the nearest."""
_MATCHES_MIN = 12
_RETAKE_TEXTURE = (
    "photograph a flat target with detail all over the frame, in focus, or a ChArUco board"
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _MatchedCaptures:
    """Captures that were matched and adjusted together, and those that could not be."""

    adjustment: Adjustment
    exclusions: tuple[Exclusion, ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _MatchedSeries:
    """The connected captures of one placement, if any, their matches, and those left over."""

    series: Series | None
    matches: tuple[PlaneMatches, ...] = ()
    exclusions: tuple[Exclusion, ...] = ()


def adjust_captures(
    captures: Sequence[GeometryCapture],
    lens: PlaneLens,
    board: CharucoBoard,
    progress: Callable[[int], None] = lambda _: None,
    prior: LensPrior | None = None,
) -> _MatchedCaptures:
    """Match the captures of each placement and adjust them all together.

    They are grouped by placement, heights ascending; the lens keeps size and focal length.
    """
    found = []
    done = 0
    for _, run in groupby(captures, key=lambda capture: capture.placement):
        members = list(run)
        is_board = members[0].kind == "board"
        found.append(
            _match_boards(members, lens, board) if is_board else _match_textures(members, lens)
        )
        done += len(members)
        progress(done)
    exclusions = [exclusion for one in found for exclusion in one.exclusions]
    series = [one.series for one in found if one.series is not None]
    if not series:
        first = exclusions[0]
        raise GeometryError(
            f"{first.capture.name}: {first.reason}",
            reason="not_matched",
            subject=first.capture.name,
        )
    adjustment = adjust(series, [part for one in found for part in one.matches], prior)
    adjustment, poor = _with_enough_matches(adjustment)
    exclusions += poor
    for strides in (_STRIDES[:1], _STRIDES):
        adjustment, poor = _with_enough_matches(
            adjustment.with_matches(_dense_matches(adjustment, strides))
        )
        exclusions += poor
    return _MatchedCaptures(adjustment=adjustment, exclusions=tuple(exclusions))


def _with_enough_matches(adjustment: Adjustment) -> tuple[Adjustment, list[Exclusion]]:
    poor = [one.capture for one in adjustment.captures if one.match_count < _MATCHES_MIN]
    if not poor:
        return adjustment, []
    reason = f"it does not agree well enough with the other captures; {_RETAKE_TEXTURE}"
    return adjustment.without(poor), [Exclusion(capture=one, reason=reason) for one in poor]


def _dense_matches(adjustment: Adjustment, strides: Sequence[int]) -> list[PlaneMatches]:
    """Matches of a board, and those of textured captures by all pixels at their current poses."""
    boards = [one.capture for own in adjustment.series if own.is_in_mm for one in own.captures]
    matches = [part for part in adjustment.matches if part.is_between(boards)]
    for series in adjustment.series:
        if series.is_in_mm:
            continue
        rising = sorted(series.captures, key=lambda one: one.pose.log_distance)
        for number, far in enumerate(rising[1:], start=1):
            nears = sorted({0, *(number - s for s in strides if s <= number)})
            matches += _match_blocks(series.lens, [rising[near] for near in nears], far)
    return [part for part in matches if len(part.seen_px)]


def _match_boards(
    captures: Sequence[GeometryCapture], lens: PlaneLens, board: CharucoBoard
) -> _MatchedSeries:
    found: dict[GeometryCapture, BoardCorners] = {}
    exclusions = []
    for capture in captures:
        try:
            found[capture] = find_board(capture.image, board)
        except RegistrationError as error:
            reason = f"{error}; show more of the board, or name it with --board"
            exclusions.append(Exclusion(capture=capture, reason=reason))
    if not found:
        return _MatchedSeries(series=None, exclusions=tuple(exclusions))
    posed = tuple(
        PosedCapture(capture=capture, pose=_pose_over_board(corners, lens))
        for capture, corners in found.items()
    )
    matches = tuple(
        PlaneMatches(
            capture=capture,
            seen_px=corners.seen_px,
            other=None,
            other_points=corners.plane_mm,
            covariance_px2=np.eye(2) * corners.err_px[:, None, None] ** 2,
        )
        for capture, corners in found.items()
    )
    return _MatchedSeries(
        series=Series(lens=lens, captures=posed, is_in_mm=True),
        matches=matches,
        exclusions=tuple(exclusions),
    )


def _pose_over_board(corners: BoardCorners, lens: PlaneLens) -> CapturePose:
    # From pixels to mm: as for a picture whose first capture had one pixel per mm.
    matrix = np.asarray(cv2.findHomography(corners.seen_px, corners.plane_mm)[0], dtype=np.float64)
    pose = _pose_of_homography(matrix, lens.principal_px, 1.0)
    principal_x, principal_y = lens.principal_px.tolist()
    return replace(
        pose,
        log_distance=pose.log_distance + log(lens.focal_length_px),
        x=pose.x + principal_x,
        y=pose.y + principal_y,
    )


def _match_textures(captures: Sequence[GeometryCapture], lens: PlaneLens) -> _MatchedSeries:
    """Match the captures of one textured target by their features, nearest first."""
    if len(captures) < 2:
        reason = "it is the only capture of its target; capture it at two heights or more"
        alone = tuple(Exclusion(capture=one, reason=reason) for one in captures)
        return _MatchedSeries(series=None, exclusions=alone)
    links, reasons = _links(captures)
    kept = _largest_group(captures, links)
    if len(kept) < 2:
        kept = ()
    exclusions = tuple(
        Exclusion(
            capture=one,
            reason=f"{reasons.get(one, 'it matches no other capture')}; {_RETAKE_TEXTURE}",
        )
        for one in captures
        if one not in kept
    )
    if not kept:
        return _MatchedSeries(series=None, exclusions=exclusions)
    links = [link for link in links if link.near in kept]
    to_first = _to_first(kept[0], links)
    middle_px = (np.array(captures[0].image.shape[1::-1]) - 1) / 2
    posed = tuple(
        PosedCapture(
            capture=one,
            pose=_pose_of_homography(to_first[one], middle_px, lens.focal_length_px),
        )
        for one in kept
    )
    return _MatchedSeries(
        series=Series(lens=lens, captures=posed, is_in_mm=False),
        matches=tuple(link.matches for link in links),
        exclusions=exclusions,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Link:
    """Two captures whose features match; ``matrix`` maps the further one's pixels to the other."""

    near: GeometryCapture
    far: GeometryCapture
    matrix: FloatArray
    matches: PlaneMatches


def _links(
    captures: Sequence[GeometryCapture],
) -> tuple[list[_Link], dict[GeometryCapture, str]]:
    """Matches of neighbours, and the reason for each capture that failed."""
    reasons: dict[GeometryCapture, str] = {}
    features: dict[int, ImageFeatures] = {}
    for number, capture in enumerate(captures):
        try:
            features[number] = find_features(capture.image)
        except RegistrationError as error:
            reasons[capture] = str(error)
    links = []
    for near, own in features.items():
        for far in range(near + 1, near + 1 + _REACH):
            if far not in features:
                continue
            pair = captures[near], captures[far]
            try:
                links.append(_link(*pair, own, features[far]))
            except RegistrationError as error:
                reasons = dict.fromkeys(pair, str(error)) | reasons
            else:
                break
    return links, reasons


def _link(
    near: GeometryCapture,
    far: GeometryCapture,
    near_features: ImageFeatures,
    far_features: ImageFeatures,
) -> _Link:
    found = near_features.matched_with(far_features)
    matrix, agreeing = homography_pose(found)
    count = int(np.count_nonzero(agreeing))
    matches = PlaneMatches(
        capture=far,
        seen_px=found.followup_px[agreeing],
        other=near,
        other_points=found.reference_px[agreeing],
        covariance_px2=np.tile(np.eye(2) * _FEATURE_ERROR_PX**2, (count, 1, 1)),
    )
    return _Link(near=near, far=far, matrix=matrix, matches=matches)


def _largest_group(
    captures: Sequence[GeometryCapture], links: Iterable[_Link]
) -> tuple[GeometryCapture, ...]:
    """The largest group of captures connected by links; of equal groups, the nearest."""
    groups = {one: number for number, one in enumerate(captures)}
    for link in links:
        old, new = groups[link.far], groups[link.near]
        groups = {one: new if number == old else number for one, number in groups.items()}
    numbers = list(groups.values())
    largest = max(set(numbers), key=lambda number: (numbers.count(number), -number))
    return tuple(one for one in captures if groups[one] == largest)


def _to_first(first: GeometryCapture, links: Sequence[_Link]) -> dict[GeometryCapture, FloatArray]:
    """Homographies from each capture's pixels to those of the first."""
    found: dict[GeometryCapture, FloatArray] = {first: np.eye(3)}
    waiting = list(links)
    while waiting:
        link = next(one for one in waiting if one.near in found or one.far in found)
        waiting.remove(link)
        # No capture has two links to further ones, so the links form no loop.
        if link.near in found:
            found[link.far] = found[link.near] @ link.matrix
        else:
            found[link.near] = found[link.far] @ np.linalg.inv(link.matrix)
    return found


def _pose_of_homography(
    matrix: FloatArray, middle_px: FloatArray, focal_length_px: float
) -> CapturePose:
    """Pose of a level camera whose pixels ``matrix`` maps to those of the first capture."""
    middle_x, middle_y = middle_px.tolist()
    x, y = project(matrix, middle_x, middle_y)
    a, b, c, d = projection_slopes(matrix, middle_x, middle_y)
    return CapturePose(
        log_distance=log(abs(a * d - b * c)) / 2,
        turn_rad=atan2(c - b, a + d),
        x=(x - middle_x) / focal_length_px,
        y=(y - middle_y) / focal_length_px,
    )
