"""Bundle adjustment of height series: one lens, one tilt a series, one pose a capture.

Every match says that two pixels of two captures, or a pixel and a known point of a board, are one
point of the plane. Robust least squares over all of them; standard errors by leaving out one
region of a target at a time, so that what neighbouring matches share is not taken for knowledge.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.camera import LENS_SIZE, SHARED_SIZE, CapturePose, PlaneLens

__all__ = ["Adjustment", "LensPrior", "PlaneMatches", "SeriesLayout", "adjust_series"]

FloatArray = NDArray[np.float64]

_POSE_SIZE = 4
_TILT_SIZE = SHARED_SIZE - LENS_SIZE
_ITERATIONS = 30
_CONVERGED = 1e-3
"""Of a standard error: a step below it changes nothing."""
_TUKEY_CUT = 5.0
"""Standard deviations beyond which a match does not count; of a good one in 270 000 it is none."""
_MEDIAN_OF_SQUARES = 1.3863
"""Median of chi^2 with two degrees of freedom, 2 ln 2."""
_REGIONS_ACROSS = 11.0
"""Regions of a target across the width that its nearest capture sees."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlaneMatches:
    """Pixels of one capture that show the same plane points as those of another, or of a board.

    Parameters
    ----------
    capture
        Number of the capture.
    seen_px
        Its pixels (x, y), shape (n, 2).
    other
        Number of the other capture; None where ``other_points`` are known plane points in mm.
    other_points
        Pixels of the other capture, or plane points, shape (n, 2).
    covariance_px2
        Of the disagreement, in pixels of ``capture``, shape (n, 2, 2); right up to a factor.
    """

    capture: int
    seen_px: FloatArray
    other: int | None
    other_points: FloatArray
    covariance_px2: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPrior:
    """What is known of every lens beforehand: standard deviations about none of it.

    A real lens lies well within; where the matches say less than this, its value is not determined.
    """

    k1: float = 0.2
    k2: float = 0.05
    principal_px: float = 15.0

    @property
    def precisions(self) -> FloatArray:
        """Inverse variances in the order of the lens parameters."""
        return np.array([self.k1, self.k2, self.principal_px, self.principal_px]) ** -2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesLayout:
    """Which capture belongs to which series.

    ``series`` has one number a capture; ``anchors`` are captures whose pose is the unit of their
    series, because nothing in it has a known size.
    """

    series: tuple[int, ...]
    anchors: tuple[int, ...]

    @property
    def series_count(self) -> int:
        """How many series there are."""
        return max(self.series) + 1

    @property
    def size(self) -> int:
        """Number of parameters, fixed ones included."""
        return LENS_SIZE + _TILT_SIZE * self.series_count + _POSE_SIZE * len(self.series)

    def shared_columns(self, series: int) -> NDArray[np.intp]:
        """Places of the lens and of one series' tilt among the parameters."""
        tilt = LENS_SIZE + _TILT_SIZE * series + np.arange(_TILT_SIZE)
        return np.concatenate([np.arange(LENS_SIZE), tilt])

    def pose_columns(self, capture: int) -> NDArray[np.intp]:
        """Places of a capture's pose (log distance, turn, x, y) among the parameters."""
        start = LENS_SIZE + _TILT_SIZE * self.series_count + _POSE_SIZE * capture
        return start + np.arange(_POSE_SIZE)

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which parameters are not fixed."""
        free = np.ones(self.size, dtype=np.bool_)
        for anchor in self.anchors:
            free[self.pose_columns(anchor)] = False
        return free


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Adjustment:
    """The adjusted lens, tilts and poses, and how far they can be trusted.

    Parameters
    ----------
    lenses
        One a series; they differ by their tilt alone.
    poses
        One a capture.
    layout
        Where everything stands in ``covariance``.
    covariance
        Of all parameters, fixed ones with zero variance.
    rms_px
        Rms of the accepted matches of each capture, in its pixels.
    match_counts
        Accepted matches of each capture.
    """

    lenses: tuple[PlaneLens, ...]
    poses: tuple[CapturePose, ...]
    layout: SeriesLayout
    covariance: FloatArray
    rms_px: tuple[float, ...]
    match_counts: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Whitened equations of one set of matches."""

    columns: NDArray[np.intp]
    design: FloatArray
    residual: FloatArray
    weight: FloatArray
    region: NDArray[np.intp]
    length_px: FloatArray


def adjust_series(
    lens: PlaneLens,
    poses: Sequence[CapturePose],
    matches: Sequence[PlaneMatches],
    layout: SeriesLayout,
    prior: LensPrior | None = None,
) -> Adjustment:
    """Adjust lens, tilts and poses to the matches.

    Parameters
    ----------
    lens
        To start from; its focal length is kept.
    poses
        To start from, right to some pixels; those of the layout's anchors are kept.
    matches
        At least one set for each capture that is no anchor.
    layout
        Which capture belongs to which series.
    prior
        What is known of the lens beforehand.

    References
    ----------
    Triggs, McLauchlan, Hartley, Fitzgibbon, "Bundle adjustment - a modern synthesis", 2000,
    sections 4 and 6. Errors: the jackknife over clusters, Bell and McCaffrey, "Bias reduction in
    standard errors for linear regression with multi-stage samples", 2002.
    """
    lenses = [lens] * layout.series_count
    current = list(poses)
    precisions = np.zeros(layout.size)
    precisions[:LENS_SIZE] = (prior or LensPrior()).precisions
    free = layout.free
    for _ in range(_ITERATIONS):
        rows = [_rows(lenses, current, layout, sets) for sets in matches]
        normal, gradient = np.diag(precisions), -precisions * _values(lenses, current, layout)
        for part in rows:
            weighted = part.design * part.weight[:, None, None]
            normal[np.ix_(part.columns, part.columns)] += np.einsum(
                "nac,nad->cd", weighted, part.design
            )
            gradient[part.columns] -= np.einsum("nac,na->c", weighted, part.residual)
        step = np.zeros(layout.size)
        inside = np.ix_(free, free)
        step[free] = np.linalg.solve(normal[inside], gradient[free])
        values = _values(lenses, current, layout) + step
        lenses, current = _unpacked(values, lenses[0], layout)
        # Newton's decrement: the step's length squared, in standard errors.
        if float(step @ gradient) < _CONVERGED**2:
            break
    rows = [_rows(lenses, current, layout, sets) for sets in matches]
    covariance = np.zeros((layout.size, layout.size))
    covariance[inside] = _jackknife(rows, precisions, layout)[inside]
    squares, counts = np.zeros(len(current)), np.zeros(len(current))
    for part, sets in zip(rows, matches, strict=True):
        accepted = part.weight > 0
        squares[sets.capture] += np.sum(part.length_px[accepted] ** 2)
        counts[sets.capture] += np.count_nonzero(accepted)
        if sets.other is not None:
            squares[sets.other] += np.sum(part.length_px[accepted] ** 2)
            counts[sets.other] += np.count_nonzero(accepted)
    return Adjustment(
        lenses=tuple(lenses),
        poses=tuple(current),
        layout=layout,
        covariance=covariance,
        rms_px=tuple(
            float(np.sqrt(s / max(2 * n, 1))) for s, n in zip(squares, counts, strict=True)
        ),
        match_counts=tuple(int(n) for n in counts),
    )


def _rows(
    lenses: Sequence[PlaneLens],
    poses: Sequence[CapturePose],
    layout: SeriesLayout,
    sets: PlaneMatches,
) -> _Rows:
    series = layout.series[sets.capture]
    lens, pose = lenses[series], poses[sets.capture]
    point, shared, own = _plane_equations(lens, pose, sets.seen_px)
    columns = [layout.shared_columns(series), layout.pose_columns(sets.capture)]
    blocks = [-shared, -own]
    if sets.other is None:
        residual = sets.other_points - point
    else:
        other, other_shared, other_own = _plane_equations(
            lens, poses[sets.other], sets.other_points
        )
        residual = other - point
        blocks = [other_shared - shared, -own, other_own]
        columns.append(layout.pose_columns(sets.other))
    to_px = lens.focal_length_px / pose.distance
    turned_px = to_px * pose.turn.T
    residual_px = residual @ turned_px.T
    design = np.einsum("ab,nbc->nac", turned_px, np.concatenate(blocks, axis=2))
    whitening = np.linalg.inv(np.linalg.cholesky(sets.covariance_px2))
    white = np.einsum("nab,nb->na", whitening, residual_px)
    square = np.sum(white**2, axis=1)
    scale = max(float(np.median(square)) / _MEDIAN_OF_SQUARES, 1e-12)
    tukey = np.maximum(1 - square / scale / _TUKEY_CUT**2, 0.0) ** 2
    nearest = min(
        (p for p, s in zip(poses, layout.series, strict=True) if s == series),
        key=lambda p: p.log_distance,
    )
    side = nearest.distance * lens.width_px / lens.focal_length_px / _REGIONS_ACROSS
    return _Rows(
        columns=np.concatenate(columns),
        design=np.einsum("nab,nbc->nac", whitening, design),
        residual=white,
        weight=tukey / scale,
        region=_region(point, side, series),
        length_px=np.hypot(residual_px[:, 0], residual_px[:, 1]),
    )


def _region(plane: FloatArray, side: float, series: int) -> NDArray[np.intp]:
    cell = np.floor(plane / side + 0.5).astype(np.intp) + 2**14
    return np.asarray((cell[:, 0] * 2**15 + cell[:, 1]) * 2**10 + series)


def _plane_equations(
    lens: PlaneLens, pose: CapturePose, points_px: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Plane points, and their derivatives by shared parameters and pose."""
    slopes = lens.slopes(points_px)
    point = pose.plane(slopes)
    scaled_turn = pose.distance * pose.turn
    shared = np.einsum("ab,nbc->nac", scaled_turn, lens.slope_changes(points_px))
    offset = point - pose.place
    own = np.zeros((len(points_px), 2, _POSE_SIZE))
    own[:, :, 0] = offset
    own[:, 0, 1], own[:, 1, 1] = -offset[:, 1], offset[:, 0]
    own[:, 0, 2] = own[:, 1, 3] = 1.0
    return point, shared, own


def _jackknife(rows: Sequence[_Rows], precisions: FloatArray, layout: SeriesLayout) -> FloatArray:
    """Covariance from the scatter of the solutions that leave out one region each."""
    free = np.flatnonzero(layout.free)
    regions, place = np.unique(np.concatenate([p.region for p in rows]), return_inverse=True)
    normals = np.zeros((len(regions), layout.size, layout.size))
    gradients = np.zeros((len(regions), layout.size))
    for part, where in _with_places(rows, place):
        weighted = part.design * part.weight[:, None, None]
        squares = np.einsum("nac,nad->ncd", weighted, part.design)
        slopes = np.einsum("nac,na->nc", weighted, part.residual)
        grid = np.ix_(part.columns, part.columns)
        for region in np.unique(where):
            chosen = where == region
            normals[region][grid] += squares[chosen].sum(axis=0)
            gradients[region][part.columns] += slopes[chosen].sum(axis=0)
    normal = (normals.sum(axis=0) + np.diag(precisions))[np.ix_(free, free)]
    moves = np.array(
        [
            np.linalg.lstsq(normal - n[np.ix_(free, free)], g[free], rcond=None)[0]
            for n, g in zip(normals, gradients, strict=True)
        ]
    )
    count = len(regions)
    covariance = np.zeros((layout.size, layout.size))
    spread = moves.T @ moves * (count - 1) / count
    # What the prior adds: its own scatter, weighted as the solution weights it.
    gain = np.linalg.inv(normal)
    spread += gain @ np.diag(precisions[free]) @ gain
    covariance[np.ix_(free, free)] = spread
    return covariance


def _with_places(
    rows: Sequence[_Rows], place: NDArray[np.intp]
) -> Iterator[tuple[_Rows, NDArray[np.intp]]]:
    start = 0
    for part in rows:
        yield part, place[start : start + len(part.region)]
        start += len(part.region)


def _values(
    lenses: Sequence[PlaneLens], poses: Sequence[CapturePose], layout: SeriesLayout
) -> FloatArray:
    values = np.zeros(layout.size)
    for series, lens in enumerate(lenses):
        values[layout.shared_columns(series)] = lens.parameters
    for capture, pose in enumerate(poses):
        values[layout.pose_columns(capture)] = (pose.log_distance, pose.turn_rad, pose.x, pose.y)
    return values


def _unpacked(
    values: FloatArray, lens: PlaneLens, layout: SeriesLayout
) -> tuple[list[PlaneLens], list[CapturePose]]:
    lenses = [
        lens.with_parameters(values[layout.shared_columns(series)])
        for series in range(layout.series_count)
    ]
    poses = []
    for capture in range(len(layout.series)):
        log_distance, turn_rad, x, y = (float(v) for v in values[layout.pose_columns(capture)])
        poses.append(CapturePose(log_distance=log_distance, turn_rad=turn_rad, x=x, y=y))
    return lenses, poses
