"""Whether the model holds: half of the heights, and half of the points, predict the rest.

A covariance knows nothing of an error of the model. What it leaves shows where data that were not
fitted are predicted: heights by every other height, places beside the travel likewise, and points
by those of other regions of the target. A fault is named where chance is out of the question and
zooms would be off by as much as matters.

References
----------
M. Stone, "Cross-validatory choice and assessment of statistical predictions", J. R. Stat. Soc. B 36
(1974), 111-147.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, fdtrc

from calibration.geometry._bundle_adjustment import (
    LENS_SIZE,
    Adjustment,
    CapturePose,
    EquationRows,
    PlaneLens,
    PlaneMatches,
    equations,
    jackknife,
)
from calibration.geometry._document import CrossValidation, HeldOut, PlaneSag
from calibration.geometry._pupil import HEIGHT_FLOOR_MM, PupilFit, SeriesDistances
from simulation.arrays import BoolArray, FloatArray, IntArray

_SURE_P = 1e-3
_MATTERS = 0.005
"""Of the distance, and so of a zoom; one of 0.02 moves d' by 5 % between zoom 1.25 and 1.5."""

_PLACE_FLOOR = 1e-5
"""Of the distance: no image places a camera more exactly to the side."""

_BENDS = 3
_BEND_STEP = 1e-5


def cross_validation(adjustment: Adjustment, pupil: PupilFit) -> CrossValidation:
    """Validate captures that agree, with the pupil that was fitted to all of them."""
    heights = _held_out_heights(adjustment, pupil)
    travel = _held_out_travel(adjustment)
    points = _sag(adjustment)
    faults = []
    if heights is not None and _matters(heights.p_value, heights.worst):
        faults.append(
            f"the heights wander: half of them predict the distance at "
            f"{heights.worst_height_mm:g} mm only to {100 * heights.worst:.1f} %; check that the "
            "stage does not slip, and that the lens was not refocused"
        )
    if travel is not None and _matters(travel.p_value, travel.worst):
        faults.append(
            f"the camera does not travel straight: at {travel.worst_height_mm:g} mm it is "
            f"{100 * travel.worst:.1f} % of its distance off the line through the other "
            "heights; check the rail, or whether the target was moved"
        )
    if points is not None and _matters(points.p_value, points.sag):
        faults.append(
            f"the target is not flat: towards the corner of the nearest capture it bends by "
            f"{100 * points.sag:.1f} % of the distance; lay it flat, or glue it to a plate"
        )
    return CrossValidation(heights=heights, travel=travel, points=points, faults=tuple(faults))


def _matters(p_value: float, size: float) -> bool:
    return p_value < _SURE_P and size > _MATTERS


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Line:
    """A linear model of values at heights, with the covariance of the values."""

    values: FloatArray
    covariance: FloatArray
    design: FloatArray

    def prediction(self, known: BoolArray) -> "_Prediction | None":
        """Predict the values that are not known; None if the others do not determine them."""
        design = self.design[known]
        used = np.any(design != 0, axis=0)
        wanted = ~known & ~np.any(self.design[:, ~used] != 0, axis=1)
        design = design[:, used]
        if not wanted.any() or np.linalg.matrix_rank(design) < design.shape[1]:
            return None
        weights = np.linalg.inv(self.covariance[np.ix_(known, known)])
        estimate = np.linalg.solve(design.T @ weights @ design, design.T @ weights)
        gain = np.zeros((int(wanted.sum()), len(self.values)))
        gain[:, wanted] = np.eye(len(gain))
        gain[:, known] = -self.design[np.ix_(wanted, used)] @ estimate
        return _Prediction(
            of=np.flatnonzero(wanted),
            errors=gain @ self.values,
            covariance=gain @ self.covariance @ gain.T,
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Prediction:
    """Which values were predicted, and how far off they are."""

    of: IntArray
    errors: FloatArray
    covariance: FloatArray


def _held_out(
    lines: list[_Line], halves: list[BoolArray], sizes: FloatArray, heights_mm: FloatArray
) -> HeldOut | None:
    """Chi-squared of predictions of either half by the other.

    The lines are independent measurements of the same captures, such as two coordinates.
    """
    squares, freedom, worst, p_least = 0.0, 0, (0.0, 0.0), 1.0
    for known in halves:
        square, count = 0.0, 0
        errors = np.zeros(len(sizes))
        for line in lines:
            found = line.prediction(known)
            if found is None:
                continue
            square += float(found.errors @ np.linalg.solve(found.covariance, found.errors))
            count += len(found.of)
            relative = found.errors * sizes[found.of]
            errors[found.of] = np.hypot(errors[found.of], relative)
        if count == 0:
            continue
        squares, freedom = squares + square, freedom + count
        p_least = min(p_least, 2 * float(chdtrc(count, square)))
        at = int(np.argmax(errors))
        worst = max(worst, (float(errors[at]), float(heights_mm[at])))
    if freedom == 0:
        return None
    return HeldOut(
        chi2_reduced=squares / freedom,
        degrees_of_freedom=freedom,
        p_value=p_least,
        worst=worst[0],
        worst_height_mm=worst[1],
    )


def _halves(heights_mm: FloatArray) -> list[BoolArray]:
    """Captures at every other height; those at one height alone determine nothing."""
    order = np.unique(heights_mm, return_inverse=True)[1]
    halves = [order % 2 == parity for parity in (0, 1)]
    return [half for half in halves if len(set(heights_mm[half])) > 1]


def _held_out_heights(adjustment: Adjustment, pupil: PupilFit) -> HeldOut | None:
    distances = SeriesDistances.of(adjustment)
    heights_mm = distances.heights_mm
    distance_mm = heights_mm + pupil.pupil_offset_mm
    members = np.eye(int(distances.series.max()) + 1)[distances.series]
    line = _Line(
        values=distances.log_distances - np.log(distance_mm) - members @ pupil.log_units,
        covariance=distances.covariance + np.diag((HEIGHT_FLOOR_MM / distance_mm) ** 2),
        design=np.column_stack([1 / distance_mm, members]),
    )
    halves = _halves(heights_mm)
    return _held_out([line], halves, np.ones(len(heights_mm)), heights_mm)


def _held_out_travel(adjustment: Adjustment) -> HeldOut | None:
    """Of the series with the most captures: two coordinates over the distance."""
    series = max(adjustment.series, key=lambda own: len(own.captures))
    poses = np.array([one.pose.parameters for one in series.captures])
    distance = np.exp(poses[:, 0])
    heights_mm = np.array(series.heights_mm)
    columns = np.array([adjustment.columns.pose(one.capture) for one in series.captures])
    halves = _halves(heights_mm)
    lines = [
        _Line(
            values=poses[:, axis],
            covariance=adjustment.covariance[np.ix_(columns[:, axis], columns[:, axis])]
            + np.diag((_PLACE_FLOOR * distance) ** 2),
            design=np.column_stack([np.ones(len(distance)), distance]),
        )
        for axis in (2, 3)
    ]
    return _held_out(lines, halves, 1 / distance, heights_mm)


def _sag(adjustment: Adjustment) -> PlaneSag | None:
    """Fit a quadratic surface to all points, beside all that was adjusted."""
    size = adjustment.columns.size
    plain = equations(adjustment.series, adjustment.matches, adjustment.columns)
    rows = [
        _with_bends(adjustment, part, sets, size)
        for part, sets in zip(plain, adjustment.matches, strict=True)
    ]
    free = np.append(adjustment.columns.free, np.ones(_BENDS, dtype=np.bool_))
    precisions = np.zeros(size + _BENDS)
    precisions[:LENS_SIZE] = adjustment.prior.precisions
    regions = len(np.unique(np.concatenate([part.region for part in rows])))
    freedom = regions - _BENDS
    if freedom < 2 * _BENDS:
        return None
    bends = slice(-_BENDS, None)
    solution = _solution(rows, precisions, free)[bends]
    covariance = jackknife(rows, precisions, free)[bends, bends]
    if not np.linalg.cond(covariance) < 1e12:
        return None
    square = float(solution @ np.linalg.solve(covariance, solution)) / _BENDS
    return PlaneSag(
        sag=_corner_height(solution),
        sag_err=float(np.sqrt(np.trace(covariance) / _BENDS)),
        p_value=float(fdtrc(_BENDS, freedom, square)),
        chi2_reduced=_held_out_points(rows, precisions, free),
    )


def _with_bends(
    adjustment: Adjustment, part: EquationRows, sets: PlaneMatches, size: int
) -> EquationRows:
    """Add columns for the elements xx, xy and yy of a bend, in distances at the corner."""
    columns = []
    for element in range(_BENDS):
        bent = _bent(adjustment, sets, element)
        (moved,) = equations(adjustment.series, [bent], adjustment.columns)
        columns.append((moved.residual - part.residual) / _BEND_STEP)
    return replace(
        part,
        columns=np.append(part.columns, size + np.arange(_BENDS)),
        design=np.concatenate([part.design, np.stack(columns, axis=-1)], axis=2),
    )


def _bent(adjustment: Adjustment, sets: PlaneMatches, element: int) -> PlaneMatches:
    """Matches as a flat target would show them if this one were bent by a small step."""
    series = next(
        own for own in adjustment.series if sets.capture in [one.capture for one in own.captures]
    )
    poses = {one.capture: one.pose for one in series.captures}
    lens, pose, nearest = series.lens, poses[sets.capture], series.nearest_distance
    point, ray = _point_and_ray(lens, pose, sets.seen_px)
    place = np.mean([one.place for one in poses.values()], axis=0)
    x, y = ((point - place) * lens.focal_length_px / (nearest * lens.corner_radius_px)).T
    height = _BEND_STEP * nearest * (x * x, 2 * x * y, y * y)[element]
    if sets.other is None:
        return replace(sets, other_points=sets.other_points + ray * height[:, None])
    far = poses[sets.other]
    own, other_ray = _point_and_ray(lens, far, sets.other_points)
    moved = own + (ray - other_ray) * height[:, None]
    # The difference alone, so that pixels that no lens shows stay as they are.
    change = lens.pixels(far.slopes(moved)) - lens.pixels(far.slopes(own))
    return replace(sets, other_points=sets.other_points + change)


def _point_and_ray(
    lens: PlaneLens, pose: CapturePose, points_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Plane points of pixels, and how far along the plane their rays go for a unit of height."""
    point = pose.plane(lens.slopes(points_px))
    return point, (point - pose.place) / pose.distance


def _solution(rows: list[EquationRows], precisions: FloatArray, free: BoolArray) -> FloatArray:
    """Change of all parameters that the weighted equations ask for."""
    normal, gradient = np.diag(precisions), np.zeros(len(precisions))
    for part in rows:
        weighted = part.design * part.weight[:, None, None]
        normal[np.ix_(part.columns, part.columns)] += np.einsum(
            "nac,nad->cd", weighted, part.design
        )
        gradient[part.columns] -= np.einsum("nac,na->c", weighted, part.residual)
    step = np.zeros(len(precisions))
    chosen = np.ix_(free, free)
    step[free] = np.linalg.lstsq(normal[chosen], gradient[free], rcond=None)[0]
    return step


def _held_out_points(rows: list[EquationRows], precisions: FloatArray, free: BoolArray) -> float:
    """Mean square of regions that the others predict, over that of those; a flat target."""
    flat = free.copy()
    flat[-_BENDS:] = False
    predicted = fitted = 0.0
    for parity in (0, 1):
        known = [_some(part, _is_of(part, parity)) for part in rows]
        rest = [_some(part, ~_is_of(part, parity)) for part in rows]
        step = _solution(known, precisions, flat)
        predicted += _mean_square(rest, step)
        fitted += _mean_square(known, step)
    return predicted / max(fitted, 1e-300)


def _is_of(part: EquationRows, parity: int) -> BoolArray:
    """Regions of one colour of a chessboard; a region's number has its column and row in it."""
    cell = part.region // 2**10
    return np.asarray((cell // 2**15 + cell % 2**15) % 2 == parity)


def _some(part: EquationRows, chosen: BoolArray) -> EquationRows:
    return replace(part, weight=np.where(chosen, part.weight, 0.0))


def _mean_square(rows: list[EquationRows], step: FloatArray) -> float:
    square = count = 0.0
    for part in rows:
        left = part.residual + part.design @ step[part.columns]
        square += float(np.sum(part.weight[:, None] * left**2))
        count += 2 * float(np.count_nonzero(part.weight))
    return square / max(count, 1.0)


def _corner_height(bend: FloatArray) -> float:
    """Largest height at the radius of the corner, whatever the direction."""
    xx, xy, yy = bend.tolist()
    return float(np.abs(np.linalg.eigvalsh([[xx, xy], [xy, yy]])).max())
