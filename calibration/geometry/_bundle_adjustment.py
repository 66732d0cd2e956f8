"""Bundle adjustment of height series: one lens, one tilt per series, one pose per capture.

A camera above a plane has lens distortion, tilt, distance, rotation and position. Pixels
``(x, y)`` become *slopes*: the offset of the plane point from the foot of the perpendicular through
the entrance pupil, in units of the pupil's distance from the plane. In slopes, captures of a plane
differ only by a scale, a rotation and a shift.

Every match says that pixels in two captures, or a pixel and a known point of a board, are the same
point of the plane. All matches enter one robust least-squares fit. Standard errors come from
leaving out one region of a target at a time, so that errors common to neighbours are included.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot, sqrt
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from calibration.errors import GeometryError
from simulation.arrays import BoolArray, FloatArray
from simulation.pose import ideal_factors, seen_factors

LENS_SIZE = 4
"""Parameters of the lens: k1, k2 and the two offsets of the principal point."""

SHARED_SIZE = LENS_SIZE + 2
"""Parameters that all captures of one series share: the lens and two tilts."""

_LEAST_STEEPNESS = 0.1
"""Keeps derivatives finite at the fold of a strong barrel distortion; no real lens reaches it."""

_TILT_STEP = 1e-5


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneLens:
    """Lens and inclination: what stays the same when the stage moves.

    A wrong ``focal_length_px`` makes tilts wrong by the same factor. An ideal point at radius r
    from the principal point, 1 at the image corner, appears at ``r (1 + k1 r^2 + k2 r^4)``; the
    principal point counts from the centre of the image. The tilts make the optical axis meet the
    plane further along the image's +x, +y.
    """

    width_px: int
    height_px: int
    focal_length_px: float
    k1: float = 0.0
    k2: float = 0.0
    principal_x_px: float = 0.0
    principal_y_px: float = 0.0
    tilt_x_rad: float = 0.0
    tilt_y_rad: float = 0.0

    @property
    def principal_px(self) -> FloatArray:
        """Principal point (x, y) in the image."""
        return np.array(
            [
                (self.width_px - 1) / 2 + self.principal_x_px,
                (self.height_px - 1) / 2 + self.principal_y_px,
            ]
        )

    @property
    def corner_radius_px(self) -> float:
        """Distance of the corner pixels' centres from the centre of the image."""
        return hypot(self.width_px - 1, self.height_px - 1) / 2

    @property
    def parameters(self) -> FloatArray:
        """Shape (6,): k1, k2, principal x and y in px, tilts x and y in rad."""
        return np.array(
            [
                self.k1,
                self.k2,
                self.principal_x_px,
                self.principal_y_px,
                self.tilt_x_rad,
                self.tilt_y_rad,
            ]
        )

    def with_parameters(self, values: FloatArray) -> Self:
        """Return the same camera with other ``parameters``."""
        k1, k2, x_px, y_px, tilt_x, tilt_y = (float(value) for value in values)
        return replace(
            self,
            k1=k1,
            k2=k2,
            principal_x_px=x_px,
            principal_y_px=y_px,
            tilt_x_rad=tilt_x,
            tilt_y_rad=tilt_y,
        )

    def slopes(self, points_px: FloatArray) -> FloatArray:
        """Slopes of observed pixels, shape (n, 2)."""
        seen = (points_px - self.principal_px) / self.corner_radius_px
        plane = self._rays(seen) @ self._inclination().T
        return np.asarray(plane[:, :2] / plane[:, 2:])

    def pixels(self, slopes: FloatArray) -> FloatArray:
        """Pixels at which slopes are seen, shape (n, 2)."""
        ray = np.column_stack([slopes, np.ones(len(slopes))]) @ self._inclination()
        ideal = ray[:, :2] / ray[:, 2:] * (self.focal_length_px / self.corner_radius_px)
        # The whole frame is within this radius of the principal point.
        frame = 1 + hypot(self.principal_x_px, self.principal_y_px) / self.corner_radius_px
        factors = seen_factors(self.k1, self.k2, np.sum(ideal**2, axis=1), frame)
        return np.asarray(self.principal_px + self.corner_radius_px * ideal * factors[:, None])

    def slope_changes(self, points_px: FloatArray) -> FloatArray:
        """Derivatives of ``slopes`` by ``parameters``, shape (n, 2, 6)."""
        seen = (points_px - self.principal_px) / self.corner_radius_px
        ray = self._rays(seen)
        radius = np.hypot(seen[:, 0], seen[:, 1])
        square = np.sum(ray[:, :2] ** 2, axis=1)
        factor = ideal_factors(self.k1, self.k2, radius**2)
        steepness = np.maximum(1 + square * (3 * self.k1 + 5 * square * self.k2), _LEAST_STEEPNESS)
        turn = self._inclination()
        plane = ray @ turn.T
        slopes = plane[:, :2] / plane[:, 2:]
        # Derivatives by the ideal point, shape (n, 2, 2).
        by_point = (turn[:2, :2] - slopes[:, :, None] * turn[2, :2]) / plane[:, 2, None, None]
        outwards = np.divide(seen, radius[:, None], out=np.zeros_like(seen), where=seen != 0)
        stretch = np.eye(2) * factor[:, None, None] + (1 / steepness - factor)[:, None, None] * (
            outwards[:, :, None] * outwards[:, None, :]
        )
        by_lens = np.empty((len(points_px), 2, LENS_SIZE))
        by_lens[:, :, 0] = -ray[:, :2] * (square / steepness)[:, None]
        by_lens[:, :, 1] = -ray[:, :2] * (square**2 / steepness)[:, None]
        by_lens[:, :, 2:] = -stretch / self.corner_radius_px
        changes = np.empty((len(points_px), 2, SHARED_SIZE))
        changes[:, :, :LENS_SIZE] = by_point @ by_lens
        for number, (x, y) in enumerate(((_TILT_STEP, 0.0), (0.0, _TILT_STEP))):
            above, below = (
                replace(
                    self,
                    tilt_x_rad=self.tilt_x_rad + sign * x,
                    tilt_y_rad=self.tilt_y_rad + sign * y,
                )._inclination()
                for sign in (1, -1)
            )
            moved = ray @ (above - below).T / (2 * _TILT_STEP)
            changes[:, :, LENS_SIZE + number] = (moved[:, :2] - slopes * moved[:, 2:]) / plane[
                :, 2:
            ]
        return changes

    def _rays(self, seen: FloatArray) -> FloatArray:
        """Directions of observed points, shape (n, 3), with the corner's radius as unit length."""
        factors = ideal_factors(self.k1, self.k2, np.sum(seen**2, axis=1))
        depth = np.full(len(seen), self.focal_length_px / self.corner_radius_px)
        return np.column_stack([seen * factors[:, None], depth])

    def _inclination(self) -> FloatArray:
        """Rotation from camera axes to plane axes (Rodrigues' formula), shape (3, 3)."""
        x, y = self.tilt_x_rad, self.tilt_y_rad
        angle = sqrt(x * x + y * y)
        cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
        half = np.sinc(angle / 2 / np.pi)
        return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + half**2 / 2 * cross @ cross)


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturePose:
    """Pose of one capture: a plane point is ``place + exp(log_distance) turn(slope)``.

    Lengths are in mm, or in the first capture's distance if no size is known.
    """

    log_distance: float = 0.0
    turn_rad: float = 0.0
    x: float = 0.0
    y: float = 0.0

    @classmethod
    def of(cls, parameters: FloatArray) -> Self:
        """Pose with these ``parameters``."""
        log_distance, turn_rad, x, y = parameters.tolist()
        return cls(log_distance=log_distance, turn_rad=turn_rad, x=x, y=y)

    @property
    def parameters(self) -> FloatArray:
        """Shape (4,): log distance, rotation, x and y."""
        return np.array([self.log_distance, self.turn_rad, self.x, self.y])

    @property
    def distance(self) -> float:
        """Distance of the entrance pupil from the plane."""
        return float(np.exp(self.log_distance))

    @property
    def place(self) -> FloatArray:
        """Foot of the perpendicular through the entrance pupil, (x, y)."""
        return np.array([self.x, self.y])

    @property
    def turn(self) -> FloatArray:
        """Rotation by ``turn_rad``, shape (2, 2)."""
        c, s = np.cos(self.turn_rad), np.sin(self.turn_rad)
        return np.array([[c, -s], [s, c]])

    def plane(self, slopes: FloatArray) -> FloatArray:
        """Plane points of slopes, shape (n, 2)."""
        return np.asarray(self.place + self.distance * slopes @ self.turn.T)

    def slopes(self, plane: FloatArray) -> FloatArray:
        """Slopes of plane points, shape (n, 2)."""
        return np.asarray((plane - self.place) @ self.turn / self.distance)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GeometryCapture:
    """One capture of a board or a textured target: grey, linear, ``(rows, cols)``.

    Captures of one kind, target and orientation show a target that was not touched in between.
    """

    name: str
    kind: str
    target: str
    orientation_deg: float
    height_mm: float
    image: NDArray[np.floating[Any]] = field(repr=False)
    index: int | None = None

    @property
    def placement(self) -> tuple[str, str, float]:
        """What the captures of one series have in common."""
        return self.kind, self.target, self.orientation_deg


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Exclusion:
    """A capture that is not used, and why."""

    capture: GeometryCapture
    reason: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PosedCapture:
    """A capture, its pose, and how well its accepted matches fit."""

    capture: GeometryCapture
    pose: CapturePose
    match_count: int = 0
    rms_px: float = 0.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Series:
    """The captures of one placement of a target, and the lens, inclined as it is to it.

    Without a known size, lengths are in the first capture's distance, and its pose is fixed.
    """

    lens: PlaneLens
    captures: tuple[PosedCapture, ...]
    is_in_mm: bool

    @property
    def target(self) -> str:
        """Name of the target."""
        return self.captures[0].capture.target

    @property
    def heights_mm(self) -> tuple[float, ...]:
        """Height of each capture."""
        return tuple(one.capture.height_mm for one in self.captures)

    @property
    def nearest_distance(self) -> float:
        """Distance of the nearest capture."""
        return min(one.pose.distance for one in self.captures)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlaneMatches:
    """Pixels of one capture that show the same plane points as those of another, or of a board.

    All are x and y, shape (n, 2); ``other`` is None where the points are known ones, in mm. The
    covariance is that of the disagreement in pixels of ``capture``, shape (n, 2, 2), up to a
    factor.
    """

    capture: GeometryCapture
    seen_px: FloatArray = field(repr=False)
    other: GeometryCapture | None
    other_points: FloatArray = field(repr=False)
    covariance_px2: FloatArray = field(repr=False)

    def is_between(self, captures: Collection[GeometryCapture]) -> bool:
        """Whether the matches need no captures other than these."""
        return self.capture in captures and (self.other is None or self.other in captures)


_POSE_SIZE = 4
_TILT_SIZE = SHARED_SIZE - LENS_SIZE
_ITERATIONS = 30
_CONVERGED = 1e-3
"""Relative to a standard error: a smaller step changes nothing."""
_TUKEY_CUT = 5.0
"""Standard deviations beyond which a match does not count; it loses 1 good match in 270 000."""
_MEDIAN_OF_SQUARES = 1.3863
"""Median of chi^2 with two degrees of freedom, 2 ln 2."""
_REGIONS_ACROSS = 11.0
"""Number of regions of a target across the width that its nearest capture sees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPrior:
    """Standard deviations of the lens about zero; what is known no better is undetermined."""

    k1: float = 0.2
    k2: float = 0.05
    principal_px: float = 15.0

    @property
    def precisions(self) -> FloatArray:
        """Inverse variances in the order of the lens parameters."""
        return np.array([self.k1, self.k2, self.principal_px, self.principal_px]) ** -2.0


class _ParameterColumns:
    """Columns of lens, tilts and poses among the parameters of an adjustment."""

    def __init__(self, series: Sequence[Series]) -> None:
        captures = [one.capture for own in series for one in own.captures]
        poses = LENS_SIZE + _TILT_SIZE * len(series)
        self.size = poses + _POSE_SIZE * len(captures)
        self._starts = {c: poses + _POSE_SIZE * number for number, c in enumerate(captures)}
        self.free: BoolArray = np.ones(self.size, dtype=np.bool_)
        for own in series:
            if not own.is_in_mm:
                self.free[self.pose(own.captures[0].capture)] = False

    def shared(self, series: int) -> NDArray[np.intp]:
        """Columns of the lens and of one series' tilt; the tilt's are the last two."""
        tilt = LENS_SIZE + _TILT_SIZE * series + np.arange(_TILT_SIZE)
        return np.concatenate([np.arange(LENS_SIZE), tilt])

    def pose(self, capture: GeometryCapture) -> NDArray[np.intp]:
        """Columns of a capture's pose: log distance, turn, x, y."""
        return self._starts[capture] + np.arange(_POSE_SIZE)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Adjustment:
    """Adjusted series, whose lenses differ only in tilt, and the parameters' covariance.

    The covariance is of all parameters, by ``columns``, and zero for fixed ones.
    """

    series: tuple[Series, ...]
    matches: tuple[PlaneMatches, ...] = field(repr=False)
    prior: LensPrior
    covariance: FloatArray = field(repr=False)

    @property
    def captures(self) -> tuple[PosedCapture, ...]:
        """The captures of all series."""
        return tuple(one for own in self.series for one in own.captures)

    @property
    def columns(self) -> _ParameterColumns:
        """Columns of the parameters in ``covariance``."""
        return _ParameterColumns(self.series)

    @property
    def first_in_mm(self) -> int | None:
        """Index of the first series of known size."""
        return next((n for n, series in enumerate(self.series) if series.is_in_mm), None)

    @property
    def lens_errs(self) -> tuple[float, ...]:
        """Standard errors of k1, k2 and the principal point's x and y."""
        return tuple(np.sqrt(np.diag(self.covariance)[:LENS_SIZE]).tolist())

    def without(self, left_out: Collection[GeometryCapture]) -> Self:
        """Adjust again without some captures, and without whatever depends on them."""
        series = []
        for own in self.series:
            captures = tuple(one for one in own.captures if one.capture not in left_out)
            # A single capture of a target of unknown size determines nothing.
            if len(captures) >= (1 if own.is_in_mm else 2):
                series.append(replace(own, captures=captures))
        if not series:
            raise GeometryError(
                "no two captures of the same target are left; retake the series",
                reason="nothing_left",
            )
        left = {one.capture for own in series for one in own.captures}
        return self._adjusted(series, [part for part in self.matches if part.is_between(left)])

    def with_matches(self, matches: Sequence[PlaneMatches]) -> Self:
        """Adjust again to other matches."""
        return self._adjusted(self.series, matches)

    def with_focal_length(self, focal_length_px: float) -> Self:
        """Adjust again with another focal length."""
        return self._adjusted(
            [_with_focal_length(own, focal_length_px) for own in self.series], self.matches
        )

    def _adjusted(self, series: Sequence[Series], matches: Sequence[PlaneMatches]) -> Self:
        again = adjust(series, matches, self.prior)
        return replace(
            self, series=again.series, matches=again.matches, covariance=again.covariance
        )


def _with_focal_length(series: Series, focal_length_px: float) -> Series:
    """Start of an adjustment with another focal length."""
    lens = series.lens
    ratio = focal_length_px / lens.focal_length_px
    captures = []
    for one in series.captures:
        pose = one.pose
        if series.is_in_mm:
            pose = replace(pose, log_distance=pose.log_distance + float(np.log(ratio)))
        else:
            pose = replace(pose, x=pose.x / ratio, y=pose.y / ratio)
        captures.append(replace(one, pose=pose))
    inclined = replace(
        lens,
        focal_length_px=focal_length_px,
        tilt_x_rad=lens.tilt_x_rad * ratio,
        tilt_y_rad=lens.tilt_y_rad * ratio,
    )
    return replace(series, lens=inclined, captures=tuple(captures))


@dataclass(frozen=True, slots=True, eq=False)
class EquationRows:
    """Whitened equations of one set of matches, by parameters of ``columns``.

    ``weight`` is one for both coordinates of a match, ``region`` the target's part it lies in.
    """

    columns: NDArray[np.intp]
    design: FloatArray
    residual: FloatArray
    weight: FloatArray
    region: NDArray[np.intp]
    length_px: FloatArray


def adjust(
    series: Sequence[Series], matches: Sequence[PlaneMatches], prior: LensPrior | None = None
) -> Adjustment:
    """Adjust lens, tilts and poses to the matches.

    The starting poses are right to some pixels, and the focal length is kept. Every capture whose
    pose is not fixed needs a set of matches.

    References
    ----------
    Triggs, McLauchlan, Hartley, Fitzgibbon, "Bundle adjustment - a modern synthesis", 2000,
    sections 4 and 6. Errors: the jackknife over clusters, Bell and McCaffrey, "Bias reduction in
    standard errors for linear regression with multi-stage samples", 2002.
    """
    known = prior or LensPrior()
    columns = _ParameterColumns(series)
    precisions = np.zeros(columns.size)
    precisions[:LENS_SIZE] = known.precisions
    free = np.ix_(columns.free, columns.free)
    current = tuple(series)
    for _ in range(_ITERATIONS):
        values = _values(current, columns)
        normal, gradient = np.diag(precisions), -precisions * values
        for part in equations(current, matches, columns):
            weighted = part.design * part.weight[:, None, None]
            normal[np.ix_(part.columns, part.columns)] += np.einsum(
                "nac,nad->cd", weighted, part.design
            )
            gradient[part.columns] -= np.einsum("nac,na->c", weighted, part.residual)
        step = np.zeros(columns.size)
        step[columns.free] = np.linalg.solve(normal[free], gradient[columns.free])
        current = _unpacked(values + step, current, columns)
        # Newton's decrement: the step's length squared, in standard errors.
        if float(step @ gradient) < _CONVERGED**2:
            break
    rows = equations(current, matches, columns)
    covariance = np.zeros((columns.size, columns.size))
    covariance[free] = jackknife(rows, precisions, columns.free)
    return Adjustment(
        series=_with_fits(current, matches, rows),
        matches=tuple(matches),
        prior=known,
        covariance=covariance,
    )


def _with_fits(
    series: Sequence[Series], matches: Sequence[PlaneMatches], rows: Sequence[EquationRows]
) -> tuple[Series, ...]:
    """Series with the count and the rms of each capture's accepted matches."""
    lengths: dict[GeometryCapture, list[FloatArray]] = {}
    for part, sets in zip(rows, matches, strict=True):
        for capture in (sets.capture, sets.other):
            if capture is not None:
                lengths.setdefault(capture, []).append(part.length_px[part.weight > 0])

    def fitted(one: PosedCapture) -> PosedCapture:
        own = np.concatenate([np.empty(0), *lengths.get(one.capture, [])])
        rms_px = float(np.sqrt(np.sum(own**2) / max(2 * len(own), 1)))
        return replace(one, match_count=len(own), rms_px=rms_px)

    return tuple(replace(own, captures=tuple(map(fitted, own.captures))) for own in series)


def equations(
    series: Sequence[Series], matches: Sequence[PlaneMatches], columns: _ParameterColumns
) -> list[EquationRows]:
    """Equations of all matches at the present parameters, one part for each set of them."""
    numbers = {one.capture: n for n, own in enumerate(series) for one in own.captures}
    poses = {one.capture: one.pose for own in series for one in own.captures}
    return [
        _rows(series[numbers[sets.capture]], numbers[sets.capture], poses, sets, columns)
        for sets in matches
    ]


def _rows(
    series: Series,
    number: int,
    poses: Mapping[GeometryCapture, CapturePose],
    sets: PlaneMatches,
    columns: _ParameterColumns,
) -> EquationRows:
    lens, pose = series.lens, poses[sets.capture]
    point, shared, own = _plane_equations(lens, pose, sets.seen_px)
    used = [columns.shared(number), columns.pose(sets.capture)]
    blocks = [-shared, -own]
    if sets.other is None:
        residual = sets.other_points - point
    else:
        other, other_shared, other_own = _plane_equations(
            lens, poses[sets.other], sets.other_points
        )
        residual = other - point
        blocks = [other_shared - shared, -own, other_own]
        used.append(columns.pose(sets.other))
    to_px = lens.focal_length_px / pose.distance
    turned_px = to_px * pose.turn.T
    residual_px = residual @ turned_px.T
    design = np.einsum("ab,nbc->nac", turned_px, np.concatenate(blocks, axis=2))
    whitening = np.linalg.inv(np.linalg.cholesky(sets.covariance_px2))
    white = np.einsum("nab,nb->na", whitening, residual_px)
    square = np.sum(white**2, axis=1)
    scale = max(float(np.median(square)) / _MEDIAN_OF_SQUARES, 1e-12)
    tukey = np.maximum(1 - square / scale / _TUKEY_CUT**2, 0.0) ** 2
    side = series.nearest_distance * lens.width_px / lens.focal_length_px / _REGIONS_ACROSS
    return EquationRows(
        columns=np.concatenate(used),
        design=np.einsum("nab,nbc->nac", whitening, design),
        residual=white,
        weight=tukey / scale,
        region=_region(point, side, number),
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


def jackknife(
    rows: Sequence[EquationRows], precisions: FloatArray, is_free: BoolArray
) -> FloatArray:
    """Covariance of the free parameters from the solutions that each leave out one region."""
    size, free = len(is_free), np.flatnonzero(is_free)
    regions, region = np.unique(np.concatenate([p.region for p in rows]), return_inverse=True)
    normals = np.zeros((len(regions), size, size))
    gradients = np.zeros((len(regions), size))
    ends = np.cumsum([len(part.region) for part in rows])
    for part, where in zip(rows, np.split(region, ends[:-1]), strict=True):
        weighted = part.design * part.weight[:, None, None]
        squares = np.einsum("nac,nad->ncd", weighted, part.design)
        slopes = np.einsum("nac,na->nc", weighted, part.residual)
        grid = np.ix_(part.columns, part.columns)
        for number in np.unique(where):
            chosen = where == number
            normals[number][grid] += squares[chosen].sum(axis=0)
            gradients[number][part.columns] += slopes[chosen].sum(axis=0)
    normal = (normals.sum(axis=0) + np.diag(precisions))[np.ix_(free, free)]
    moves = np.array(
        [
            np.linalg.lstsq(normal - n[np.ix_(free, free)], g[free], rcond=None)[0]
            for n, g in zip(normals, gradients, strict=True)
        ]
    )
    count = len(regions)
    spread = moves.T @ moves * (count - 1) / count
    # The prior adds its own scatter, weighted as in the solution.
    gain = np.linalg.inv(normal)
    return np.asarray(spread + gain @ np.diag(precisions[free]) @ gain)


def _values(series: Sequence[Series], columns: _ParameterColumns) -> FloatArray:
    values = np.zeros(columns.size)
    for number, own in enumerate(series):
        values[columns.shared(number)] = own.lens.parameters
        for one in own.captures:
            values[columns.pose(one.capture)] = one.pose.parameters
    return values


def _unpacked(
    values: FloatArray, series: Sequence[Series], columns: _ParameterColumns
) -> tuple[Series, ...]:
    return tuple(
        replace(
            own,
            lens=own.lens.with_parameters(values[columns.shared(number)]),
            captures=tuple(
                replace(one, pose=CapturePose.of(values[columns.pose(one.capture)]))
                for one in own.captures
            ),
        )
        for number, own in enumerate(series)
    )
