"""Captures of several targets, matched within each target and adjusted together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.errors import GeometryError, RegistrationError
from calibration.geometry.board import BoardCorners, CharucoBoard, find_board
from calibration.geometry.bundle_adjustment import (
    Adjustment,
    LensPrior,
    PlaneMatches,
    SeriesLayout,
    adjust_series,
)
from calibration.geometry.camera import CapturePose, PlaneLens
from calibration.geometry.dense_matches import DenseView, match_blocks
from calibration.geometry.matching import match_series, pose_of_homography

__all__ = ["GeometryCapture", "SeriesAdjustment", "adjust_captures"]

FloatArray = NDArray[np.float64]

_STRIDES = (1, 2, 3, 5, 8, 13)
"""Every capture is matched with those so many places nearer, and with the nearest of all."""
_MATCHES_MIN = 12
_RETAKE_TEXTURE = (
    "photograph a flat target with detail all over the frame, in focus, or a ChArUco board"
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GeometryCapture:
    """One capture of a board or of a textured target.

    ``image`` is grey and linear, shape ``(rows, cols)``; ``height_mm`` was read back. Captures of
    one kind, target and orientation show the same thing, which was not touched in between.
    """

    name: str
    kind: str
    target: str
    orientation_deg: float
    height_mm: float
    image: NDArray[np.floating[Any]]
    index: int | None = None

    @property
    def placement(self) -> tuple[str, str, float]:
        """What the captures of one series have in common."""
        return self.kind, self.target, self.orientation_deg


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SeriesAdjustment:
    """An adjustment and what it was made of.

    ``members`` are the captures' places in the list that was given, in the adjustment's order;
    ``boards`` the series whose lengths are mm, ``prior`` what was known of the lens.
    """

    members: tuple[int, ...]
    boards: frozenset[int]
    matches: tuple[PlaneMatches, ...]
    adjustment: Adjustment
    prior: LensPrior

    def without(self, left_out: Sequence[int]) -> Self:
        """Adjust again without some captures, named by their places in the given list.

        Raises
        ------
        GeometryError
            If nothing is left to adjust.
        """
        gone = {place for place, member in enumerate(self.members) if member in left_out}
        layout = self.adjustment.layout
        for number in range(layout.series_count):
            own = [p for p, s in enumerate(layout.series) if s == number and p not in gone]
            if number not in self.boards and len(own) < 2:
                gone.update(own)
        kept = [place for place in range(len(self.members)) if place not in gone]
        if not kept:
            raise GeometryError("no two captures are left that belong together; retake the series")
        renumbered = {place: number for number, place in enumerate(kept)}
        numbers = sorted({layout.series[place] for place in kept})
        series = tuple(numbers.index(layout.series[place]) for place in kept)
        boards = frozenset(numbers.index(b) for b in self.boards if b in numbers)
        matches = tuple(
            replace(
                part,
                capture=renumbered[part.capture],
                other=None if part.other is None else renumbered[part.other],
            )
            for part in self.matches
            if part.capture in renumbered and (part.other is None or part.other in renumbered)
        )
        adjustment = adjust_series(
            self.adjustment.lenses[numbers[0]],
            [self.adjustment.poses[place] for place in kept],
            matches,
            _layout(series, boards),
            self.prior,
        )
        return replace(
            self,
            members=tuple(self.members[place] for place in kept),
            boards=boards,
            matches=matches,
            adjustment=adjustment,
        )

    def with_focal_length(self, focal_length_px: float) -> Self:
        """Adjust again with another focal length."""
        lens = self.adjustment.lenses[0]
        ratio = focal_length_px / lens.focal_length_px
        poses = [
            replace(pose, log_distance=pose.log_distance + float(np.log(ratio)))
            if series in self.boards
            else replace(pose, x=pose.x / ratio, y=pose.y / ratio)
            for pose, series in zip(
                self.adjustment.poses, self.adjustment.layout.series, strict=True
            )
        ]
        adjustment = adjust_series(
            replace(
                lens,
                focal_length_px=focal_length_px,
                tilt_x_rad=lens.tilt_x_rad * ratio,
                tilt_y_rad=lens.tilt_y_rad * ratio,
            ),
            poses,
            self.matches,
            self.adjustment.layout,
            self.prior,
        )
        return replace(self, adjustment=adjustment)


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """The captures of one placement that could be matched."""

    members: tuple[int, ...]
    is_board: bool
    poses: tuple[CapturePose, ...]
    matches: tuple[PlaneMatches, ...]


def adjust_captures(
    captures: Sequence[GeometryCapture],
    lens: PlaneLens,
    board: CharucoBoard,
    excluded: dict[int, str],
    progress: Callable[[int], None] = lambda _: None,
    prior: LensPrior | None = None,
) -> SeriesAdjustment:
    """Match the captures of each placement and adjust all together.

    Parameters
    ----------
    captures
        Those of a placement together, heights ascending.
    lens
        To start from: the image size and focal length are kept.
    board
        What captures of kind board show.
    excluded
        Captures that cannot be used are added, with the reason.
    progress
        Called with the number of captures that are done with.
    prior
        What is known of the lens beforehand.

    Raises
    ------
    GeometryError
        If no placement is left; the line names a capture, its fault and the remedy.
    """
    groups = []
    done = 0
    for _, run in groupby(range(len(captures)), key=lambda i: captures[i].placement):
        members = tuple(run)
        is_board = captures[members[0]].kind == "board"
        group = (
            _board_group(captures, members, lens, board, excluded)
            if is_board
            else _texture_group(captures, members, lens, excluded)
        )
        done += len(members)
        progress(done)
        if group is not None:
            groups.append(group)
    if not groups:
        place, reason = min(excluded.items())
        raise GeometryError(f"{captures[place].name}: {reason}")
    series = _joined(groups, lens, prior or LensPrior())
    series = _with_enough_matches(series, excluded)
    for is_last in (False, True):
        series = _with_dense_matches(series, captures, is_last=is_last)
        series = _with_enough_matches(series, excluded)
    return series


def _board_group(
    captures: Sequence[GeometryCapture],
    members: tuple[int, ...],
    lens: PlaneLens,
    board: CharucoBoard,
    excluded: dict[int, str],
) -> _Group | None:
    found: dict[int, BoardCorners] = {}
    for member in members:
        try:
            found[member] = find_board(captures[member].image, board)
        except RegistrationError as error:
            excluded[member] = f"{error}; show more of the board, or name it with --board"
    if not found:
        return None
    poses, matches = [], []
    for number, corners in enumerate(found.values()):
        # From pixels to mm: as a picture whose first capture had one pixel per mm.
        matrix = np.asarray(
            cv2.findHomography(corners.seen_px, corners.plane_mm)[0], dtype=np.float64
        )
        pose = pose_of_homography(matrix, lens.principal_px, 1.0)
        poses.append(
            replace(
                pose,
                log_distance=pose.log_distance + float(np.log(lens.focal_length_px)),
                x=pose.x + float(lens.principal_px[0]),
                y=pose.y + float(lens.principal_px[1]),
            )
        )
        matches.append(
            PlaneMatches(
                capture=number,
                seen_px=corners.seen_px,
                other=None,
                other_points=corners.plane_mm,
                covariance_px2=np.eye(2) * corners.err_px[:, None, None] ** 2,
            )
        )
    return _Group(tuple(found), True, tuple(poses), tuple(matches))


def _texture_group(
    captures: Sequence[GeometryCapture],
    members: tuple[int, ...],
    lens: PlaneLens,
    excluded: dict[int, str],
) -> _Group | None:
    if len(members) < 2:
        excluded[members[0]] = (
            "it is the only capture of its target: capture it at two heights or more"
        )
        return None
    points = match_series([captures[m].image for m in members], lens.focal_length_px)
    for place, reason in points.refused.items():
        excluded[members[place]] = f"{reason}; {_RETAKE_TEXTURE}"
    if len(points.kept) < 2:
        return None
    return _Group(tuple(members[p] for p in points.kept), False, points.poses, points.matches)


def _joined(groups: Sequence[_Group], lens: PlaneLens, prior: LensPrior) -> SeriesAdjustment:
    members: list[int] = []
    poses: list[CapturePose] = []
    matches: list[PlaneMatches] = []
    series: list[int] = []
    for number, group in enumerate(groups):
        start = len(members)
        matches += [
            replace(
                part,
                capture=part.capture + start,
                other=None if part.other is None else part.other + start,
            )
            for part in group.matches
        ]
        members += group.members
        poses += group.poses
        series += [number] * len(group.members)
    boards = frozenset(number for number, group in enumerate(groups) if group.is_board)
    adjustment = adjust_series(lens, poses, matches, _layout(tuple(series), boards), prior)
    return SeriesAdjustment(
        members=tuple(members),
        boards=boards,
        matches=tuple(matches),
        adjustment=adjustment,
        prior=prior,
    )


def _layout(series: tuple[int, ...], boards: frozenset[int]) -> SeriesLayout:
    anchors = tuple(series.index(number) for number in sorted(set(series)) if number not in boards)
    return SeriesLayout(series=series, anchors=anchors)


def _with_enough_matches(series: SeriesAdjustment, excluded: dict[int, str]) -> SeriesAdjustment:
    counts = series.adjustment.match_counts
    poor = [m for m, n in zip(series.members, counts, strict=True) if n < _MATCHES_MIN]
    if not poor:
        return series
    for member in poor:
        excluded[member] = f"it agrees too little with the other captures; {_RETAKE_TEXTURE}"
    return series.without(poor)


def _with_dense_matches(
    series: SeriesAdjustment, captures: Sequence[GeometryCapture], *, is_last: bool
) -> SeriesAdjustment:
    """Match the textured captures by all pixels, at the places that the adjustment gives."""
    adjustment, layout = series.adjustment, series.adjustment.layout
    matches = [part for part in series.matches if layout.series[part.capture] in series.boards]
    for number in range(layout.series_count):
        if number in series.boards:
            continue
        own = [place for place, s in enumerate(layout.series) if s == number]
        own.sort(key=lambda place: adjustment.poses[place].log_distance)
        views = [
            DenseView(
                capture=place,
                image=np.asarray(captures[series.members[place]].image, dtype=np.float64),
                lens=adjustment.lenses[number],
                pose=adjustment.poses[place],
            )
            for place in own
        ]
        for place in range(1, len(views)):
            strides = _STRIDES if is_last else _STRIDES[:1]
            nears = sorted({0, *(place - s for s in strides if s <= place)})
            matches += match_blocks([views[near] for near in nears], views[place])
    matched = tuple(part for part in matches if len(part.seen_px))
    return replace(
        series,
        matches=matched,
        adjustment=adjust_series(
            adjustment.lenses[0], adjustment.poses, matched, layout, series.prior
        ),
    )
