"""Captures matched within each target, and all of them adjusted together.

Textured captures are matched by their features with the next capture in height, and with the one
after it if that fails; the largest connected group is kept. Then all their pixels are matched. The
corners of a board have known positions.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from math import atan2, log

import cv2
import numpy as np

from calibration.errors import GeometryError, RegistrationError
from calibration.geometry.board import BoardCorners, CharucoBoard, find_board
from calibration.geometry.bundle_adjustment import Adjustment, LensPrior, adjust
from calibration.geometry.camera import CapturePose, PlaneLens
from calibration.geometry.dense_matches import match_blocks
from calibration.geometry.series import (
    Exclusion,
    GeometryCapture,
    PlaneMatches,
    PosedCapture,
    Series,
)
from calibration.registration import ImageFeatures, find_features, homography_pose
from simulation.arrays import FloatArray
from simulation.pose import project, projection_slopes

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
class MatchedCaptures:
    """Captures that were matched and adjusted together, and those that could not be."""

    adjustment: Adjustment
    exclusions: tuple[Exclusion, ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MatchedSeries:
    """The connected captures of one placement, their matches, and the captures left over.

    ``series`` is None if no two are connected.
    """

    series: Series | None
    matches: tuple[PlaneMatches, ...] = ()
    exclusions: tuple[Exclusion, ...] = ()


def adjust_captures(
    captures: Sequence[GeometryCapture],
    lens: PlaneLens,
    board: CharucoBoard,
    progress: Callable[[int], None] = lambda _: None,
    prior: LensPrior | None = None,
) -> MatchedCaptures:
    """Match the captures of each placement and adjust them all together.

    Parameters
    ----------
    captures
        The captures, grouped by placement, heights ascending.
    lens
        The starting point; its image size and focal length are kept.
    board
        The board that captures of kind board show.
    progress
        Called with the number of captures done.
    prior
        Prior knowledge of the lens.

    Raises
    ------
    GeometryError
        If no placement is left; the message names a capture, its fault and the remedy.
    """
    found = []
    done = 0
    for _, run in groupby(captures, key=lambda capture: capture.placement):
        members = list(run)
        is_board = members[0].kind == "board"
        found.append(
            _match_boards(members, lens, board) if is_board else match_textures(members, lens)
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
    return MatchedCaptures(adjustment=adjustment, exclusions=tuple(exclusions))


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
            matches += match_blocks(series.lens, [rising[near] for near in nears], far)
    return [part for part in matches if len(part.seen_px)]


def _match_boards(
    captures: Sequence[GeometryCapture], lens: PlaneLens, board: CharucoBoard
) -> MatchedSeries:
    found: dict[GeometryCapture, BoardCorners] = {}
    exclusions = []
    for capture in captures:
        try:
            found[capture] = find_board(capture.image, board)
        except RegistrationError as error:
            reason = f"{error}; show more of the board, or name it with --board"
            exclusions.append(Exclusion(capture=capture, reason=reason))
    if not found:
        return MatchedSeries(series=None, exclusions=tuple(exclusions))
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
    return MatchedSeries(
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


def match_textures(captures: Sequence[GeometryCapture], lens: PlaneLens) -> MatchedSeries:
    """Match the captures of one textured target by their features.

    Parameters
    ----------
    captures
        From the nearest to the furthest.
    lens
        For the poses; a rough focal length will do.
    """
    if len(captures) < 2:
        reason = "it is the only capture of its target; capture it at two heights or more"
        alone = tuple(Exclusion(capture=one, reason=reason) for one in captures)
        return MatchedSeries(series=None, exclusions=alone)
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
        return MatchedSeries(series=None, exclusions=exclusions)
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
    return MatchedSeries(
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
