"""A smooth displacement for scenes that are not quite planar, fitted to blocks of the frame.

Within a block the displacement hardly varies, so that a block's slopes and residuals shrink to a
2 x 2 matrix and a vector, and a fit costs next to nothing.
"""

from dataclasses import dataclass, field
from math import sqrt

import numpy as np
from scipy.interpolate import BSpline

from calibration.registration.dense.level_pair import LevelPair
from calibration.registration.dense.refinement import Residuals
from calibration.registration.displacement import SmoothDisplacement
from calibration.registration.distorted_pose import DistortedPose
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
class Bend:
    """Smooth displacement of a target's blocks from what its residuals say.

    Parameters
    ----------
    basis
        Shape (blocks, knots): the displacement's basis functions at the blocks' centres.
    curvature
        Shape (blocks, 2, 2): information on each block's displacement ``(y, x)``, px^-2.
    pull
        Shape (blocks, 2): score of each block's displacement, px^-1.
    cost
        Shape (blocks,): weighted squares of the residuals.
    is_odd
        Half of the blocks, like the black squares of a chessboard.
    shape
        ``(rows, cols)`` of the target.
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
        start = np.zeros((2, *knot_counts(self.shape)))
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


def bend_of(level: LevelPair, found: Residuals) -> Bend:
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
    return Bend(
        basis=_basis(y_px, x_px, level.target_shape),
        curvature=curvature,
        pull=pull,
        cost=np.bincount(block, weight * residual**2).astype(np.float64),
        is_odd=np.bincount(block, level.is_odd_block[inside]) > number / 2,
        shape=level.target_shape,
    )


def bent(pose: DistortedPose, bend: Bend) -> DistortedPose:
    """Return the pose with its displacement changed as the blocks ask for."""
    old = pose.displacement
    knots = np.zeros((2, *knot_counts(bend.shape))) if old is None else old.knots_px
    displacement = SmoothDisplacement(
        knots_px=knots + bend.step(knots), shape=bend.shape, photograph="followup"
    )
    return pose.with_(pose.matrix, pose.k1, displacement)


def knot_counts(shape: tuple[int, int]) -> tuple[int, int]:
    """Coefficients of the displacement along y and x: 3 more than pieces."""
    rows, cols = (max(round(_SPANS * n / max(shape)), 2) + 3 for n in shape)
    return rows, cols


def _basis(y_px: FloatArray, x_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Values of the displacement's basis functions at positions, shape (n, knots)."""
    along = []
    for at, size, count in zip((y_px, x_px), shape, knot_counts(shape), strict=True):
        position = np.clip((at + 0.5) / size, 0.0, 1.0) * (count - 3)
        knots = np.arange(-3.0, count + 1.0)
        along.append(BSpline.design_matrix(position, knots, 3, extrapolate=True).toarray())
    return np.asarray((along[0][:, :, None] * along[1][:, None, :]).reshape(len(y_px), -1))


def _smoothness(shape: tuple[int, int]) -> FloatArray:
    """Precision of the coefficients along one axis, as a field over the frame."""
    rows, cols = knot_counts(shape)
    bend_y, bend_x = (np.diff(np.eye(n), 2, axis=0) for n in (rows, cols))
    curl = np.kron(bend_y.T @ bend_y, np.eye(cols)) + np.kron(np.eye(rows), bend_x.T @ bend_x)
    side_px = max(shape)
    level = np.eye(rows * cols) / (_BEND_PRIOR * side_px) ** 2
    return np.asarray(level + curl / (_CURL_PRIOR * side_px) ** 2)
