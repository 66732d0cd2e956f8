"""A chosen pose refined from coarse to fine, with as many degrees of freedom as it needs.

A smooth displacement for scenes that are not quite planar, fitted to blocks of the frame. Within a
block the displacement hardly varies, so that a block's slopes and residuals shrink to a 2 x 2
matrix and a vector, and a fit costs next to nothing.

A homography as a rule; with the lens's distortion where whole frames of one camera determine it;
with a smooth displacement where that predicts parts of the frame to which it was not fitted.
"""

from dataclasses import dataclass, field, replace
from math import hypot, sqrt

import numpy as np
from scipy.interpolate import BSpline

from calibration.registration._agreement import AlignedPhotograph, comparison_factor, correlation_at
from calibration.registration._descent import LevelPair, PoseDescent, PoseMotions, Residuals
from calibration.registration._distorted_pose import (
    DistortedPose,
    FeatureMatches,
    SmoothDisplacement,
)
from simulation import GaussianPsf
from simulation.arrays import BoolArray, FloatArray

_SPANS = 6
"""Pieces of the displacement along the longer side."""

_BEND_PRIOR = 0.01
_CURL_PRIOR = 0.002
"""Standard deviations of the displacement and of its second difference from knot to knot, relative
to the longer side: 10 and 2 px in a photograph of 1000."""

_CORRELATED_PIXELS = 12.0
"""Pixels that tell as much as one, as both photographs are smoothed by 1 px: 4 pi."""

_SIGNIFICANT = 4.0
_GAIN_MIN = 0.03
"""Standard errors, and share of the cost, by which a displacement must predict other blocks."""

_LEAST_BLOCKS = 12


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Bend:
    """Smooth displacement of a target's blocks from what its residuals say.

    By blocks: the displacement's basis functions at their centres, shape (blocks, knots), the
    information on each displacement ``(y, x)`` in px^-2, its score in px^-1, and the weighted
    squares of the residuals. ``is_odd`` are half of the blocks, like the black squares of a
    chessboard.
    """

    basis: FloatArray = field(repr=False)
    curvature: FloatArray = field(repr=False)
    pull: FloatArray = field(repr=False)
    cost: FloatArray = field(repr=False)
    is_odd: BoolArray = field(repr=False)
    shape: tuple[int, int]

    def is_significant(self) -> bool:
        """Whether what half of the blocks say predicts the residuals of the other half."""
        if len(self.cost) < _LEAST_BLOCKS or self.is_odd.all() or not self.is_odd.any():
            return False
        gains = np.zeros(len(self.cost))
        start = np.zeros((2, *_knot_counts(self.shape)))
        for half in (self.is_odd, ~self.is_odd):
            step = self.step(start, half)
            moved = self.basis[~half] @ step.reshape(2, -1).T
            reached = np.einsum("ni,nij,nj->n", moved, self.curvature[~half], moved)
            gains[~half] = 2 * np.sum(moved * self.pull[~half], axis=1) - reached
        error = float(gains.std()) / sqrt(len(gains)) + 1e-12
        is_large = gains.sum() > _GAIN_MIN * self.cost.sum()
        return bool(is_large and gains.mean() > _SIGNIFICANT * error)

    def step(self, knots_px: FloatArray, counted: BoolArray | None = None) -> FloatArray:
        """Change of the knots, shape (2, n, m), that the blocks ask for, given the smoothness."""
        normal, right = self._equations(counted)
        prior = _smoothness(self.shape)
        for axis, own in enumerate(knots_px):
            part = slice(axis * own.size, (axis + 1) * own.size)
            right[part] -= prior @ own.ravel()
        step = np.linalg.solve(normal + np.kron(np.eye(2), prior), right)
        return np.asarray(step.reshape(knots_px.shape))

    def place_err_px(self) -> float:
        """Standard error of the displacement in target px, rms over the blocks."""
        normal, _ = self._equations(None)
        covariance = np.linalg.inv(normal + np.kron(np.eye(2), _smoothness(self.shape)))
        count = self.basis.shape[1]
        variance = 0.0
        for axis in (0, 1):
            part = slice(axis * count, (axis + 1) * count)
            variance += float(
                np.mean(np.sum((self.basis @ covariance[part, part]) * self.basis, axis=1))
            )
        return sqrt(variance)

    def _equations(self, counted: BoolArray | None) -> tuple[FloatArray, FloatArray]:
        chosen = np.ones(len(self.cost), dtype=np.bool_) if counted is None else counted
        basis = self.basis[chosen]
        curvature = self.curvature[chosen] / _CORRELATED_PIXELS
        count = basis.shape[1]
        normal, right = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
        for row in (0, 1):
            own = slice(row * count, (row + 1) * count)
            right[own] = basis.T @ self.pull[chosen, row] / _CORRELATED_PIXELS
            for col in (0, 1):
                other = slice(col * count, (col + 1) * count)
                normal[own, other] = basis.T @ (basis * curvature[:, row, col, None])
        return normal, right


def _bend_of(level: LevelPair, found: Residuals) -> _Bend:
    """What a level's residuals say of a displacement of its blocks."""
    inside = found.inside
    _, block = np.unique(level.block[inside], return_inverse=True)
    weight, residual = found.weight[inside], found.residual[inside]
    slopes = level.slope_y[inside], level.slope_x[inside]
    number = np.bincount(block)
    y_px, x_px = (np.bincount(block, at[inside]) / number for at in (level.y_px, level.x_px))
    curvature = np.empty((len(number), 2, 2))
    pull = np.empty((len(number), 2))
    for row, slope in enumerate(slopes):
        pull[:, row] = np.bincount(block, weight * slope * residual)
        for col, other in enumerate(slopes):
            curvature[:, row, col] = np.bincount(block, weight * slope * other)
    return _Bend(
        basis=_basis(y_px, x_px, level.target_shape),
        curvature=curvature,
        pull=pull,
        cost=np.bincount(block, weight * residual**2).astype(np.float64),
        is_odd=np.bincount(block, level.is_odd_block[inside]) > number / 2,
        shape=level.target_shape,
    )


def _bent(pose: DistortedPose, bend: _Bend) -> DistortedPose:
    """Return the pose with its displacement changed as the blocks ask for."""
    old = pose.displacement
    knots = np.zeros((2, *_knot_counts(bend.shape))) if old is None else old.knots_px
    displacement = SmoothDisplacement(
        knots_px=knots + bend.step(knots), shape=bend.shape, photograph="followup"
    )
    return pose.with_(pose.matrix, pose.k1, displacement)


def _knot_counts(shape: tuple[int, int]) -> tuple[int, int]:
    """Coefficients of the displacement along y and x: 3 more than pieces."""
    rows, cols = (max(round(_SPANS * n / max(shape)), 2) + 3 for n in shape)
    return rows, cols


def _basis(y_px: FloatArray, x_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Values of the displacement's basis functions at positions, shape (n, knots)."""
    along = []
    for at, size, count in zip((y_px, x_px), shape, _knot_counts(shape), strict=True):
        position = np.clip((at + 0.5) / size, 0.0, 1.0) * (count - 3)
        knots = np.arange(-3.0, count + 1.0)
        along.append(BSpline.design_matrix(position, knots, 3, extrapolate=True).toarray())
    return np.asarray((along[0][:, :, None] * along[1][:, None, :]).reshape(len(y_px), -1))


def _smoothness(shape: tuple[int, int]) -> FloatArray:
    """Precision of the coefficients along one axis, as a field over the frame."""
    rows, cols = _knot_counts(shape)
    bend_y, bend_x = (np.diff(np.eye(n), 2, axis=0) for n in (rows, cols))
    curl = np.kron(bend_y.T @ bend_y, np.eye(cols)) + np.kron(np.eye(rows), bend_x.T @ bend_x)
    side_px = max(shape)
    level = np.eye(rows * cols) / (_BEND_PRIOR * side_px) ** 2
    return np.asarray(level + curl / (_CURL_PRIOR * side_px) ** 2)


_SHOWN_SAMPLES = 4000
_LEAST_SLOPE = 0.3
"""Of the scores, relative to the normal equations': less is scatter, not an absence of detail."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _PlaceErrors:
    """Standard errors: of a position in the source, rms over the overlap, and of the distortion."""

    place_err_px: float
    k1_err: float


def _place_errors(pair: LevelPair, motions: PoseMotions, found: Residuals) -> _PlaceErrors:
    """Standard errors of a pose of least cost."""
    chosen = np.flatnonzero(found.inside)
    chosen = chosen[:: max(len(chosen) // _SHOWN_SAMPLES, 1)]
    flows = motions.flows(found.pose)
    covariance = _covariance(pair, motions, found)
    variance = sum(
        float(np.mean(np.sum((along[chosen] @ covariance) * along[chosen], axis=1)))
        for along in flows
    )
    return _PlaceErrors(
        place_err_px=found.pose.zoom * sqrt(max(variance, 0.0)),
        k1_err=sqrt(max(covariance[-1, -1], 0.0)) if motions.fits_distortion else 0.0,
    )


def _covariance(pair: LevelPair, motions: PoseMotions, found: Residuals) -> FloatArray:
    """Covariance of the parameters, by the sandwich formula with sums over blocks.

    The two photographs' noise is independent: the derivative of the scores is the product of the
    one's slopes with the other's, into which no noise enters.

    References
    ----------
    H. White, "A heteroskedasticity-consistent covariance matrix estimator and a direct test for
    heteroskedasticity", 1980; with blocks as clusters.
    """
    inside = found.inside
    along_x, along_y = (along[inside].T for along in motions.flows(found.pose))
    count = len(along_x)
    light = found.light_columns[inside].T
    seen_x, seen_y = (slope[inside] for slope in pair.predicted_slopes(found.pose, found.light[0]))
    own_x, own_y = pair.slope_x[inside], pair.slope_y[inside]
    own = np.concatenate([own_x * along_x + own_y * along_y, light])
    other = np.concatenate([seen_x * along_x + seen_y * along_y, light])
    square = np.minimum(found.relative[inside] ** 2, 1.0)
    rising = (1 - square) * (1 - 5 * square) / found.scale[inside] ** 2
    slope = (own * rising) @ other.T
    slope = (slope + slope.T) / 2
    weight, block = found.weight[inside], pair.block[inside]
    weighted = own * np.sqrt(weight)
    normal = weighted @ weighted.T
    for one in (slope, normal):
        one[:count, :count] += motions.prior(found.pose).normal
    scores = own * (weight * found.residual[inside])
    sums = np.stack([np.bincount(block, one) for one in scores])
    used = max(int(np.count_nonzero(np.bincount(block))), 2)
    inverse = _bounded_inverse(slope, normal)
    made = inverse @ (sums @ sums.T) @ inverse * (used / (used - 1))
    return np.asarray(made[:count, :count])


def _bounded_inverse(slope: FloatArray, normal: FloatArray) -> FloatArray:
    """Inverse of ``slope``, in no direction more than some times that of ``normal``."""
    known = np.diag(normal)
    # What no detail tells, such as a shift along stripes, is uncertain beyond any use.
    scale = 1 / np.sqrt(np.maximum(known, 1e-20 * known.max() + 1e-300))
    root = np.linalg.cholesky(normal * np.outer(scale, scale) + 1e-9 * np.eye(len(normal)))
    whiten = np.linalg.inv(root) * scale
    values, vectors = np.linalg.eigh(whiten @ slope @ whiten.T)
    half = (vectors / np.sqrt(np.maximum(values, _LEAST_SLOPE))).T @ whiten
    return np.asarray(half.T @ half)


_SAMPLES = 60_000
"""Pixels compared: with the smoothing of 1 px, neighbours tell hardly anything new."""

_K1_SIGNIFICANT = 1.4
"""Standard errors from which a distortion is kept: from sqrt(2) on it predicts better than 0 does
(H. Akaike, "A new look at the statistical model identification", 1974)."""

_JUDGED_PX = 300_000
_CORRELATION_LOSS = 0.02
"""Of the locally normalised photographs: a descent that loses more went astray."""

_STILL = 0.2
"""Pixels that no descent loses so much by: both photographs are smoothed by 1 px, so that the
correlation falls by the square of the distance over 4."""

_GRID = 9
_AROUND = 0.1
"""Points along each axis at which poses are compared, also so much of the frame outside it."""

_TRUSTED_MATCHES = 20
_STRAY = 1.3
_STRAY_PX = 0.1
"""So many features or more scatter about the true pose by at most 1.3 times what they scatter about
their own, and 0.1 px of the coarser photograph more; a descent that leaves them further behind was
drawn away by what is not in their plane. In nine simulated pairs 1.02 times at most, in a real one
that went astray 2 to 5 times."""

_NOISY = 1.1
"""Ratio of errors from which a finer resolution is left out."""

_UNMOVED_PX = 3.0
"""Largest motion of a follow-up in two levels that may be no motion: an edge of such a drawing lies
at a whole pixel, and all of an edge lies off together."""

_STEPS = 15
_BEND_ROUNDS = 3
_BEND_STEPS = 2
_STEPS_BETWEEN = 4
"""Of the homography, between changes of the displacement."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RefinedPose:
    """A pose from the coarser photograph to the finer one, with its errors, light fitted."""

    pose: DistortedPose
    errors: _PlaceErrors
    correlation: float
    residual_rms: float


def refined_at(
    level: LevelPair,
    pose: DistortedPose,
    *,
    fits_distortion: bool = False,
    steps: int = _STEPS,
) -> tuple[PoseMotions, Residuals | None]:
    """Refine a pose at one resolution; None where nothing is in common."""
    motions = PoseMotions(
        level.y_px, level.x_px, level.target_shape, fits_distortion=fits_distortion
    )
    return motions, PoseDescent(level, motions).refined(pose, steps)


def refined_pose(
    photographs: tuple[AlignedPhotograph, AlignedPhotograph],
    start: DistortedPose,
    psf: GaussianPsf | None,
    matches: FeatureMatches | None = None,
    *,
    is_one_camera: bool,
) -> RefinedPose | None:
    """Refine a pose that is right at a coarse resolution; None where nothing is in common.

    Of the photographs the finer one is the source, the coarser one the target; the start and its
    ``matches`` map target to source. The distortion may be fitted where both are whole frames of
    one camera.
    """
    factor = 2 * comparison_factor(start)
    best: RefinedPose | None = None
    pose = start
    while factor > 1:
        factor //= 2
        level = LevelPair(photographs, pose, psf, factor, _SAMPLES)
        found = _best_fit(level, pose, is_one_camera=is_one_camera)
        if found is None or strays(found.pose, start, matches):
            continue
        if not found.pose.zoom * factor < min(photographs[0].shape):
            continue  # went astray: one pixel of the target covers the source; or no number
        if _is_worse(photographs, found.pose, pose, factor):
            continue
        # Noise alone makes a finer resolution tell less; a scene that is not planar need not
        # scatter less there.
        most = _NOISY * best.errors.place_err_px if best is not None else np.inf
        if found.errors.place_err_px < most or found.pose.displacement is not None:
            best = found
        pose = best.pose if best is not None else pose
    if best is not None and is_one_camera and _may_be_unmoved(photographs, best.pose, psf):
        return replace(best, pose=_unmoved(best.pose))
    return best


def _unmoved(pose: DistortedPose) -> DistortedPose:
    return pose.with_(np.eye(3), 0.0)


def _may_be_unmoved(
    photographs: tuple[AlignedPhotograph, AlignedPhotograph],
    pose: DistortedPose,
    psf: GaussianPsf | None,
) -> bool:
    """Whether drawings agree no better than unmoved: fitted to two quarters, judged by others."""
    source, target = photographs
    if not target.is_drawing:
        return False
    rows, cols = target.shape
    corners = np.array([0.0, 0.0, rows - 1, rows - 1]), np.array([0.0, cols - 1, 0.0, cols - 1])
    moved_px = np.hypot(
        *(a - b for a, b in zip(pose.to_reference_px(*corners), corners, strict=True))
    )
    if not moved_px.max() <= _UNMOVED_PX:
        return False
    y, x = np.mgrid[:rows, :cols]
    start = _unmoved(pose)
    quarters = (y < rows / 2) == (x < cols / 2)
    gained = 0.0
    for part in (quarters, ~quarters):
        fitted, judged = (target.where(one) for one in (part, ~part))
        found = start
        for factor in (2, 1):
            _, fit = refined_at(LevelPair((source, fitted), found, psf, factor, _SAMPLES), found)
            found = found if fit is None else fit.pose
        after, before = (correlation_at(source, judged, one, 1) for one in (found, start))
        gained += after - before
    return gained <= 0


def strays(found: DistortedPose, start: DistortedPose, matches: FeatureMatches | None) -> bool:
    """Whether a descent has left behind the matched features from which it started."""
    if matches is None or len(matches.followup_px) < _TRUSTED_MATCHES:
        return False
    after, before = (float(np.median(pose.distances_px(matches))) for pose in (found, start))
    return after > _STRAY * before + _STRAY_PX * start.zoom


def _is_worse(
    photographs: tuple[AlignedPhotograph, AlignedPhotograph],
    found: DistortedPose,
    start: DistortedPose,
    factor: int,
) -> bool:
    """Whether the photographs agree less, in finer detail, than where refinement started."""
    rows, cols = photographs[1].shape
    seen_at = max(factor // 2, 1)
    seen_at *= max(round(sqrt(rows * cols / seen_at**2 / _JUDGED_PX)), 1)
    if _moved_px(found, start) < _STILL * seen_at * start.zoom:
        return False
    after, before = (correlation_at(*photographs, pose, seen_at) for pose in (found, start))
    return after < before - _CORRELATION_LOSS


def _moved_px(found: DistortedPose, start: DistortedPose) -> float:
    """Largest distance in px of the source between two poses, over what it shows."""
    rows, cols = start.followup_shape
    y, x = (
        at.ravel()
        for at in np.meshgrid(
            np.linspace(0.0, rows - 1.0, _GRID), np.linspace(0.0, cols - 1.0, _GRID), indexing="ij"
        )
    )
    places = start.to_reference_px(y, x)
    apart = np.hypot(*(a - b for a, b in zip(found.to_reference_px(y, x), places, strict=True)))
    shown = apart[start.shows(*places, margin=_AROUND)]
    return float(shown.max()) if len(shown) else np.inf


def _best_fit(level: LevelPair, pose: DistortedPose, *, is_one_camera: bool) -> RefinedPose | None:
    """Fit with a displacement or with the lens's distortion where the photographs tell of it."""
    if pose.displacement is not None:
        return _bent_fit(level, pose)
    fit = _unbent_fit(level, pose, is_one_camera=is_one_camera)
    if fit is None:
        return None
    made, found = fit
    return _bent_fit(level, made.pose) if _bend_of(level, found).is_significant() else made


def _unbent_fit(
    level: LevelPair, pose: DistortedPose, *, is_one_camera: bool
) -> tuple[RefinedPose, Residuals] | None:
    if is_one_camera and pose.k1 != 0:
        lens = _distorted_fit(level, pose)
        if lens is not None:
            return lens
    straight = _fit(level, pose.with_(pose.matrix, 0.0), fits_distortion=False)
    if straight is None or not is_one_camera or pose.k1 != 0:
        return straight
    # What was fitted without a distortion is a nearer start, as it makes up for none.
    return _distorted_fit(level, straight[0].pose) or straight


def _distorted_fit(level: LevelPair, pose: DistortedPose) -> tuple[RefinedPose, Residuals] | None:
    """Fit with the lens's distortion; None where it does not stand out."""
    lens = _fit(level, pose, fits_distortion=True)
    if lens is None or not abs(lens[0].pose.k1) > _K1_SIGNIFICANT * lens[0].errors.k1_err:
        return None
    return lens


def _fit(
    level: LevelPair, pose: DistortedPose, *, fits_distortion: bool
) -> tuple[RefinedPose, Residuals] | None:
    motions, found = refined_at(level, pose, fits_distortion=fits_distortion)
    return None if found is None else (_with_errors(level, motions, found), found)


def _bent_fit(level: LevelPair, pose: DistortedPose) -> RefinedPose | None:
    """Fit the displacement and the homography in turns."""
    best: tuple[PoseMotions, Residuals] | None = None
    for _ in range(_BEND_ROUNDS):
        motions, found = refined_at(level, pose, steps=_STEPS_BETWEEN)
        if found is None or (best is not None and found.cost > best[1].cost):
            break
        best = motions, found
        pose = found.pose
        for _ in range(_BEND_STEPS):
            state = PoseDescent(level, motions).at(pose)
            if state is None:
                break
            pose = _bent(pose, _bend_of(level, state))
    if best is None:
        return None
    made = _with_errors(level, *best)
    own_px = _bend_of(level, best[1]).place_err_px() * made.pose.zoom
    errors = replace(made.errors, place_err_px=hypot(made.errors.place_err_px, own_px))
    return replace(made, errors=errors)


def _with_errors(level: LevelPair, motions: PoseMotions, found: Residuals) -> RefinedPose:
    kept = found.inside & (np.abs(found.relative) < 1)
    measured, residual = level.measured[kept], found.residual[kept]
    offset = found.light_columns[kept, 6:12] @ found.light[6:12]
    return RefinedPose(
        pose=found.pose,
        errors=_place_errors(level, motions, found),
        correlation=float(np.corrcoef(measured - residual - offset, measured - offset)[0, 1]),
        residual_rms=float(np.sqrt(np.mean(residual**2))),
    )
