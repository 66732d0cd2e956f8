"""A pose refined at one resolution: the coarser photograph against what it sees in the finer one.

A damped Gauss-Newton descent moves the pose. Slow changes of light and a tone curve are fitted at
the same time, changes are outliers (Tukey's biweight), and residuals count by the scatter of their
own block of the frame, so that a region that does not fit does not outvote the others.

References
----------
D. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", 1963; P. Huber
and E. Ronchetti, "Robust statistics", 2009, section 4.8, for the biweight.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from calibration.registration.dense.level_pair import LevelPair
from calibration.registration.dense.motions import PoseMotions
from calibration.registration.distorted_pose import DistortedPose
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray
from simulation.pose import DISTORTION_MAX

_CONVERGED_PX = 2e-3
_CONVERGED_COST = 1e-5
"""Relative decrease of the cost below which a step changes nothing that counts."""

_FREE_STEPS = 5
"""Steps after which pixels can only drop out: a row that comes and goes prevents convergence."""

_LEAST_SAMPLES = 200
_BIWEIGHT = 4.685
"""Tuning constant at which the biweight has 95 % of the efficiency of least squares."""

_SHARED_PIXELS = 30.0
"""Weight of the whole frame's scatter in a block's, in pixels."""

_DAMPING = 1e-3
_DAMPING_MAX = 1e4


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Residuals:
    """The photographs at one pose: the light fitted, what is left and what it weighs.

    Parameters
    ----------
    pose
        Target to source.
    inside
        Samples that the source shows, shape (n,).
    light, light_columns
        Coefficients and columns of ``LevelPair.light_columns``.
    residual, scale, weight
        Target less prediction, 0 outside; its scatter by blocks; robust weight over variance.
    cost
        Mean of the biweight's loss, between 0 and 1.
    """

    pose: DistortedPose
    inside: BoolArray = field(repr=False)
    light: FloatArray = field(repr=False)
    light_columns: FloatArray = field(repr=False)
    residual: FloatArray = field(repr=False)
    scale: FloatArray = field(repr=False)
    weight: FloatArray = field(repr=False)
    cost: float

    @property
    def relative(self) -> FloatArray:
        """Residuals in units of the biweight's cut-off."""
        return self.residual / (_BIWEIGHT * self.scale)


class PoseDescent:
    """Descent of a pose at one resolution.

    Parameters
    ----------
    pair
        The photographs.
    motions
        The pose's degrees of freedom.
    """

    def __init__(self, pair: LevelPair, motions: PoseMotions) -> None:
        self._pair = pair
        self._motions = motions
        self._rises = self._rises_along(*motions.projective)

    def _rises_along(self, along_x: FloatArray, along_y: FloatArray) -> FloatArray:
        """Change of the samples' levels by displacements of shape (n, k), shape (k, n).

        By the target's slopes, not the prediction's: the noise of a slope and of the residual at a
        pixel are uncorrelated there.
        """
        return self._pair.slope_x * along_x.T + self._pair.slope_y * along_y.T

    def refined(self, start: DistortedPose, steps: int) -> Residuals | None:
        """The photographs at the pose of least cost; None where they have too little in common."""
        state = self.at(start)
        if state is None:
            return None
        damping = _DAMPING
        for number in range(steps):
            step = self._step(state, damping)
            allowed = state.inside if number >= _FREE_STEPS else None
            trial = self._state(self._motions.moved(state.pose, step), state, allowed)
            is_small = float(np.abs(step[:8]).max()) < _CONVERGED_PX * self._pair.factor
            if trial is None or trial.cost > state.cost:
                damping *= 10
                if is_small or damping > _DAMPING_MAX:
                    break
                continue
            is_done = is_small or trial.cost > state.cost * (1 - _CONVERGED_COST)
            state, damping = self._rescaled(trial), max(damping / 10, 1e-6)
            if is_done:
                break
        return state

    def at(self, pose: DistortedPose) -> Residuals | None:
        """The photographs at a pose; None where they have too little in common."""
        return self._state(pose, None, None)

    def _state(
        self, pose: DistortedPose, last: Residuals | None, allowed: BoolArray | None
    ) -> Residuals | None:
        if not abs(pose.k1) <= DISTORTION_MAX:
            return None
        levels, inside = self._pair.seen(pose)
        if allowed is not None:
            inside &= allowed
        if np.count_nonzero(inside) < _LEAST_SAMPLES:
            return None
        state = Residuals(
            pose=pose,
            inside=inside,
            light=np.zeros(0),
            light_columns=self._pair.light_columns(levels, inside),
            residual=np.zeros(len(inside)),
            scale=np.ones(len(inside)) if last is None else last.scale,
            weight=np.ones(len(inside)) if last is None else last.weight,
            cost=1.0,
        )
        if last is not None:
            return _weighted(self._lit(state))
        for _ in range(3):
            state = self._rescaled(self._lit(state))
        return state

    def _lit(self, state: Residuals) -> Residuals:
        """The same with the light fitted to the target, by the weights there are."""
        columns, measured = state.light_columns.T, self._pair.measured
        root = np.where(state.inside, np.sqrt(state.weight), 0.0)
        weighted = columns * root
        normal = weighted @ weighted.T
        diagonal = np.diag_indices_from(normal)
        normal[diagonal] += 1e-6 * normal[diagonal] + 1e-9 * normal.max()
        light = np.linalg.solve(normal, weighted @ (root * measured))
        residual = np.where(state.inside, measured - light @ columns, 0.0)
        return replace(state, light=np.asarray(light), residual=residual)

    def _rescaled(self, state: Residuals) -> Residuals:
        """The same with the scatter of every block measured anew."""
        residual, block = state.residual[state.inside], self._pair.block
        scattered = state.residual[state.inside & self._pair.scatters]
        overall = max(robust_sigma(scattered if len(scattered) else residual), 1e-9)
        clipped = np.minimum(residual**2, (3 * overall) ** 2)
        own = block[state.inside]
        count = int(block.max()) + 1
        total = np.bincount(own, clipped, minlength=count) + _SHARED_PIXELS * overall**2
        variance = total / (np.bincount(own, minlength=count) + _SHARED_PIXELS)
        return _weighted(replace(state, scale=np.sqrt(variance)[block]))

    def _step(self, state: Residuals, damping: float) -> FloatArray:
        # Outside, weights and residuals are 0.
        root = np.sqrt(state.weight)
        parts = [self._rises, state.light_columns.T]
        if self._motions.fits_distortion:
            parts.insert(1, self._rises_along(*self._motions.distortion_flow(state.pose)))
        weighted = np.concatenate([part * root for part in parts])
        normal, right = weighted @ weighted.T, weighted @ (root * state.residual)
        count = len(weighted) - len(parts[-1])
        prior = self._motions.prior(state.pose)
        normal[:count, :count] += prior.normal
        right[:count] += prior.right
        diagonal = np.diag(normal)
        damped = np.where(np.arange(len(normal)) < count, damping, 1e-6) * diagonal
        normal = normal + np.diag(damped + 1e-12 * diagonal.max())
        return np.asarray(np.linalg.solve(normal, right)[:count])


def _weighted(state: Residuals) -> Residuals:
    rest = np.maximum(1 - np.square(state.relative), 0.0)
    kept = (rest * rest * rest)[state.inside]
    return replace(
        state,
        weight=np.where(state.inside, np.square(rest / state.scale), 0.0),
        cost=float(np.mean(1 - kept)),
    )
