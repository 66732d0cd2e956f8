"""A pose refined on all pixels, from coarse to fine: the coarser photograph against the finer one.

Both are smoothed to one resolution, so that neither has to be the sharper one; a damped
Gauss-Newton descent moves the pose. Slow changes of light and a tone curve are fitted at the same
time, changes are outliers (Tukey's biweight), and residuals count by the scatter of their own block
of the frame, so that a region that does not fit does not outvote the others.

References
----------
D. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", 1963;
J. W. Tukey's biweight: P. Huber and E. Ronchetti, "Robust statistics", 2009, section 4.8.
"""

from dataclasses import dataclass, field
from math import sqrt

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from calibration.registration.distorted_pose import DistortedPose
from calibration.registration.motions import flows_at, moved_matrix
from calibration.registration.photograph import AlignedPhotograph, blur_variance_px2
from calibration.robust import robust_sigma
from simulation import GaussianPsf
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray
from simulation.pose import DISTORTION_MAX

ASSUMED_SIGMA_PX = 0.65
"""Total PSF if none is given: a wrong width blurs every detail symmetrically and moves nothing."""

_SMOOTHING_PX = 1.0
"""Of both photographs, in pixels of the coarser one: it suppresses what the coarser one aliases."""

_SAMPLES = 100_000
"""Pixels compared: with the smoothing, neighbours tell hardly anything new (4 pi px a sample)."""

_STEPS = 25
_CONVERGED_PX = 2e-3
_FREE_STEPS = 5
"""Steps after which pixels can only drop out: a row that comes and goes prevents convergence."""

_BORDER_PX = 3.0
_BIWEIGHT = 4.685
"""Tuning constant at which the biweight has 95 % of the efficiency of least squares."""

_BLOCK_PX = 24
"""Side of the blocks between which, but not within which, residuals count as independent."""

_SHARED_PIXELS = 30.0
"""Weight of the whole frame's scatter in a block's, in pixels."""

_K1_PRIOR = 0.05
"""Standard deviation of the distortion of real lenses; it decides at zooms near 1."""

_K1_STEP = 1e-4
_DAMPING = 1e-3
_DAMPING_MAX = 1e4


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LevelFit:
    """A pose refined at one resolution.

    Parameters
    ----------
    pose
        From the coarser photograph (as the follow-up) to the finer one (as the reference).
    place_err_px, k1_err
        Standard errors: of a place in the finer photograph, rms over the overlap; of ``pose.k1``.
    correlation, residual_rms_dn
        Of the two at this resolution, after fitting the light.
    overlap
        Share of the coarser photograph's usable pixels that the finer one shows.
    """

    pose: DistortedPose
    place_err_px: float
    k1_err: float
    correlation: float
    residual_rms: float
    overlap: float
    has_settled: bool


class LevelPair:
    """Two photographs brought to one resolution near a pose.

    Parameters
    ----------
    source, target
        The finer and the coarser photograph.
    pose
        Approximate, target to source.
    psf
        Total PSF of the camera.
    factor
        Pixels of the target that are averaged along each axis.
    """

    def __init__(
        self,
        source: AlignedPhotograph,
        target: AlignedPhotograph,
        pose: DistortedPose,
        psf: GaussianPsf | None,
        factor: int,
    ) -> None:
        self.factor = factor
        zoom = max(pose.zoom, 1.0)
        self.source_factor = factor * 2 ** int(np.log2(zoom + 1e-9))
        far = target.reduced(factor).smoothed(_SMOOTHING_PX, _SMOOTHING_PX)
        near = source.reduced(self.source_factor)
        near = near.smoothed(*_missing_blur_px(pose, psf, factor, self.source_factor))
        self._coefficients = spline_filter(near.levels, order=3, output=np.float32, mode="reflect")
        self._near_usable = near.usable
        self.y, self.x = _samples(far, _SAMPLES)
        self.measured = far.levels[self.y, self.x].astype(np.float64)
        slopes = [_slopes(far.levels, axis)[self.y, self.x] for axis in (0, 1)]
        self.y_px, self.x_px = ((at + 0.5) * factor - 0.5 for at in (self.y, self.x))
        self.flows = flows_at(self.y_px, self.x_px, target.shape)
        self.slope_y, self.slope_x = (slope / factor for slope in slopes)
        u, v = self.flows[2][0], self.flows[5][1]
        self.shades = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
        cols = far.shape[1] // _BLOCK_PX + 1
        self.block: IntArray = (self.y // _BLOCK_PX) * cols + self.x // _BLOCK_PX

    def seen(self, pose: DistortedPose) -> tuple[FloatArray, BoolArray]:
        """The source's levels at the samples by a pose, and which samples it shows."""
        return self._seen_at(*pose.to_reference_px(self.y_px, self.x_px))

    def _seen_at(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, BoolArray]:
        y, x = ((at + 0.5) / self.source_factor - 0.5 for at in (y_px, x_px))
        rows, cols = self._coefficients.shape
        inside = (
            (y >= _BORDER_PX)
            & (y <= rows - 1 - _BORDER_PX)
            & (x >= _BORDER_PX)
            & (x <= cols - 1 - _BORDER_PX)
        )
        if self._near_usable is not None:
            nearest = (np.rint(y[inside]).astype(int), np.rint(x[inside]).astype(int))
            inside[inside] = self._near_usable[nearest]
        levels = np.zeros(len(y))
        levels[inside] = map_coordinates(
            self._coefficients, [y[inside], x[inside]], order=3, mode="reflect", prefilter=False
        )
        return levels, inside

    def seen_slopes(self, pose: DistortedPose) -> tuple[FloatArray, FloatArray]:
        """Slopes of the source's levels along y and x of the target, per target px."""
        half = self.factor / 2
        made = []
        for dy, dx in ((half, 0.0), (0.0, half)):
            ahead, _ = self._seen_at(*pose.to_reference_px(self.y_px + dy, self.x_px + dx))
            behind, _ = self._seen_at(*pose.to_reference_px(self.y_px - dy, self.x_px - dx))
            made.append((ahead - behind) / self.factor)
        return made[0], made[1]


def _samples(far: AlignedPhotograph, most: int) -> tuple[IntArray, IntArray]:
    """Rows and columns of usable pixels, evenly over the frame."""
    rows, cols = far.shape
    stride = max(rows * cols / most, 1.0)
    # Every so many pixels in reading order; a stride that is no divisor of the width spreads them.
    chosen = np.floor(np.arange(int(rows * cols / stride)) * stride).astype(np.int64)
    y, x = np.divmod(chosen, cols)
    kept = (y >= 2) & (y < rows - 2) & (x >= 2) & (x < cols - 2)
    if far.usable is not None:
        kept &= far.usable[y, x]
    return y[kept], x[kept]


def _slopes(levels: Float32Array, axis: int) -> Float32Array:
    kernel = np.array([[-0.5, 0.0, 0.5]], dtype=np.float32)
    return np.asarray(
        cv2.filter2D(levels, cv2.CV_32F, kernel if axis == 1 else kernel.T), dtype=np.float32
    )


def _missing_blur_px(
    pose: DistortedPose, psf: GaussianPsf | None, factor: int, source_factor: int
) -> tuple[float, float]:
    """Blur along x and y that gives the reduced source the smoothed target's resolution."""
    sigmas = (ASSUMED_SIGMA_PX,) * 2 if psf is None else (psf.sigma_x_px, psf.sigma_y_px)
    far = np.diag([blur_variance_px2(one, factor) + _SMOOTHING_PX**2 for one in sigmas])
    own = np.array([blur_variance_px2(one, source_factor) for one in sigmas])
    rows, cols = pose.followup_shape
    y, x = np.array([rows - 1.0, rows, rows - 1.0]) / 2, np.array([cols - 1.0, cols - 1.0, cols]) / 2
    to_y, to_x = pose.to_reference_px(y, x)
    slopes = 2 * np.array([[to_x[2] - to_x[0], to_x[1] - to_x[0]], [to_y[2] - to_y[0], to_y[1] - to_y[0]]])
    slopes *= factor / source_factor
    missing = np.diag(slopes @ far @ slopes.T) - own
    sigma_x, sigma_y = np.sqrt(np.maximum(missing, 0.0)).tolist()
    return sigma_x, sigma_y


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _State:
    """Everything at one pose: the light fitted, the residuals and their weights."""

    pose: DistortedPose
    inside: BoolArray = field(repr=False)
    light: FloatArray = field(repr=False)
    light_columns: FloatArray = field(repr=False)
    residual: FloatArray = field(repr=False)
    scale: FloatArray = field(repr=False)
    weight: FloatArray = field(repr=False)
    cost: float


class PoseDescent:
    """Descent of a pose at one resolution; ``fits_distortion`` for whole frames of one camera."""

    def __init__(self, pair: LevelPair, fits_distortion: bool) -> None:
        self._pair = pair
        self._fits_distortion = fits_distortion
        self._motion = np.stack(
            [pair.slope_x * fx + pair.slope_y * fy for fx, fy in pair.flows], axis=1
        )

    def refined(self, start: DistortedPose) -> LevelFit | None:
        """The pose of least robust cost; None where nothing is in common."""
        state = self._state(start, None, None)
        if state is None:
            return None
        damping, has_settled = _DAMPING, False
        for number in range(_STEPS):
            step = self._step(state, damping)
            moved = self._moved(state.pose, step)
            allowed = state.inside if number >= _FREE_STEPS else None
            trial = self._state(moved, state, allowed)
            largest = float(np.abs(step[:8]).max()) / self._pair.factor
            if trial is None or trial.cost > state.cost * (1 + 1e-9):
                damping *= 10
                if damping > _DAMPING_MAX or largest < _CONVERGED_PX:
                    has_settled = largest < _CONVERGED_PX
                    break
                continue
            state, damping = trial, max(damping / 10, 1e-6)
            if largest < _CONVERGED_PX:
                has_settled = True
                break
            state = self._rescaled(state)
        return self._fit(state, has_settled)

    def _state(
        self, pose: DistortedPose, last: _State | None, allowed: BoolArray | None
    ) -> _State | None:
        pair = self._pair
        if abs(pose.k1) > DISTORTION_MAX:
            return None
        levels, inside = pair.seen(pose)
        if allowed is not None:
            inside &= allowed
        if np.count_nonzero(inside) < 200:
            return None
        seen = levels[inside]
        centred = (levels - seen.mean()) / (seen.std() + 1e-12)
        light_columns = np.concatenate(
            [
                pair.shades * centred[:, None],
                pair.shades,
                np.stack([centred**2, centred**3], axis=1),
            ],
            axis=1,
        )
        used = light_columns[inside]
        measured = pair.measured[inside]
        if last is None:
            weight = np.ones(len(used))
            scale = np.full(len(pair.y), 1.0)
        else:
            weight, scale = last.weight[inside], last.scale
        light = _solved(used, weight, measured)
        residual = np.zeros(len(inside))
        residual[inside] = measured - used @ light
        state = _State(
            pose=pose,
            inside=inside,
            light=light,
            light_columns=light_columns,
            residual=residual,
            scale=scale,
            weight=np.zeros(len(inside)),
            cost=0.0,
        )
        if last is None:
            for _ in range(3):
                state = self._rescaled(state)
                light = _solved(used, state.weight[inside], measured)
                residual = np.zeros(len(inside))
                residual[inside] = measured - used @ light
                state = _with(state, light=light, residual=residual)
            return self._rescaled(state)
        return self._weighted(state)

    def _rescaled(self, state: _State) -> _State:
        """The same with the scatter of every block measured anew."""
        inside, residual = state.inside, state.residual
        overall = max(robust_sigma(residual[inside]), 1e-9)
        clipped = np.minimum(residual[inside] ** 2, (3 * overall) ** 2)
        block = self._pair.block
        count = block.max() + 1
        number = np.bincount(block[inside], minlength=count)
        total = np.bincount(block[inside], clipped, minlength=count)
        variance = (total + _SHARED_PIXELS * overall**2) / (number + _SHARED_PIXELS)
        return self._weighted(_with(state, scale=np.sqrt(variance)[block]))

    def _weighted(self, state: _State) -> _State:
        relative = state.residual / (_BIWEIGHT * state.scale)
        rest = np.maximum(1 - relative**2, 0.0)
        weight = np.where(state.inside, rest**2 / state.scale**2, 0.0)
        cost = float(np.mean(1 - rest[state.inside] ** 3))
        return _with(state, weight=weight, cost=cost)

    def _columns(self, state: _State) -> FloatArray:
        """Design: the motions (and the distortion), then the light."""
        parts = [self._motion]
        if self._fits_distortion:
            fx, fy = self._k1_flow(state.pose)
            parts.append((self._pair.slope_x * fx + self._pair.slope_y * fy)[:, None])
        return np.concatenate([*parts, state.light_columns], axis=1)

    def _step(self, state: _State, damping: float) -> FloatArray:
        inside = state.inside
        design = self._columns(state)[inside]
        weight = state.weight[inside]
        weighted = design * weight[:, None]
        normal = weighted.T @ design
        right = weighted.T @ state.residual[inside]
        motions = 9 if self._fits_distortion else 8
        if self._fits_distortion:
            prior = 1 / _K1_PRIOR**2
            normal[8, 8] += prior
            right[8] -= prior * state.pose.k1
        diagonal = np.diag(normal).copy()
        diagonal[motions:] *= 1e-6
        diagonal[:motions] *= damping
        normal[np.diag_indices_from(normal)] += diagonal + 1e-12 * diagonal.max()
        return np.asarray(np.linalg.solve(normal, right)[:motions])

    def _moved(self, pose: DistortedPose, step: FloatArray) -> DistortedPose:
        matrix = moved_matrix(pose.matrix, step[:8], pose.followup_shape)
        return pose.with_(matrix, pose.k1 + float(step[8]) if len(step) > 8 else pose.k1)

    def _k1_flow(self, pose: DistortedPose) -> tuple[FloatArray, FloatArray]:
        """Displacement of the samples per unit of distortion, in target px, along x and y."""
        y, x = self._pair.y_px, self._pair.x_px
        above, below = (
            pose.with_(pose.matrix, pose.k1 + sign * _K1_STEP).to_reference_px(y, x)
            for sign in (1, -1)
        )
        moved_y, moved_x = ((a - b) / (2 * _K1_STEP) for a, b in zip(above, below, strict=True))
        (a, b), (c, d) = np.linalg.inv(pose.matrix[:2, :2]).tolist()
        return a * moved_x + b * moved_y, c * moved_x + d * moved_y

    def _fit(self, state: _State, has_settled: bool) -> LevelFit:
        inside = state.inside
        covariance = self._covariance(state)
        explained = self._pair.measured[inside] - state.residual[inside]
        relative = state.residual[inside] / (_BIWEIGHT * state.scale[inside])
        kept = np.abs(relative) < 1
        measured = self._pair.measured[inside]
        offset = state.light_columns[inside, 6:12] @ state.light[6:12]
        return LevelFit(
            pose=state.pose,
            place_err_px=self._place_err_px(state, covariance),
            k1_err=sqrt(covariance[8, 8]) if self._fits_distortion else 0.0,
            correlation=float(np.corrcoef(explained - offset, measured - offset)[0, 1]),
            residual_rms=float(np.sqrt(np.mean(state.residual[inside][kept] ** 2))),
            overlap=float(np.mean(inside)),
            has_settled=has_settled,
        )

    def _covariance(self, state: _State) -> FloatArray:
        """Covariance of the motions, by the sandwich formula with sums over blocks.

        The two photographs' noise is independent: the derivative of the scores is the product of
        the one's slopes with the other's, into which no noise enters.

        References
        ----------
        H. White, "A heteroskedasticity-consistent covariance matrix estimator and a direct test
        for heteroskedasticity", 1980; with blocks as clusters.
        """
        inside, motions = state.inside, 9 if self._fits_distortion else 8
        design = self._columns(state)
        seen_y, seen_x = self._pair.seen_slopes(state.pose)
        gain = state.light[0]
        levels, _ = self._pair.seen(state.pose)
        gain /= levels[inside].std() + 1e-12
        flows = list(self._pair.flows)
        if self._fits_distortion:
            flows.append(self._k1_flow(state.pose))
        other = design.copy()
        other[:, :motions] = np.stack(
            [gain * (seen_x * fx + seen_y * fy) for fx, fy in flows], axis=1
        )
        square = (state.residual / (_BIWEIGHT * state.scale)) ** 2
        rising = np.where(
            inside & (square < 1), (1 - square) * (1 - 5 * square) / state.scale**2, 0.0
        )
        slope = (design * rising[:, None]).T @ other
        slope = (slope + slope.T) / 2
        if self._fits_distortion:
            slope[8, 8] += 1 / _K1_PRIOR**2
        scores = design * (state.weight * state.residual)[:, None]
        count = self._pair.block.max() + 1
        sums = np.stack(
            [np.bincount(self._pair.block, one, minlength=count) for one in scores.T], axis=1
        )
        used = max(int(np.count_nonzero(np.bincount(self._pair.block[inside]))), 2)
        inverse = np.linalg.pinv(slope, hermitian=True)
        made = inverse @ (sums.T @ sums) @ inverse * (used / (used - 1))
        return np.asarray(made[:motions, :motions])

    def _place_err_px(self, state: _State, covariance: FloatArray) -> float:
        """Standard error of a place in the source, rms over the samples it shows."""
        flows = list(self._pair.flows)
        if self._fits_distortion:
            flows.append(self._k1_flow(state.pose))
        chosen = np.flatnonzero(state.inside)[:: max(np.count_nonzero(state.inside) // 5000, 1)]
        along_x, along_y = (np.stack([flow[axis][chosen] for flow in flows], axis=1) for axis in (0, 1))
        variance = sum(
            float(np.mean(np.einsum("ni,ij,nj->n", along, covariance, along)))
            for along in (along_x, along_y)
        )
        return state.pose.zoom * sqrt(max(variance, 0.0))


def _with(state: _State, **changes: object) -> _State:
    from dataclasses import replace

    return replace(state, **changes)  # type: ignore[arg-type]


def _solved(columns: FloatArray, weight: FloatArray, right: FloatArray) -> FloatArray:
    weighted = columns * weight[:, None]
    normal = weighted.T @ columns
    normal[np.diag_indices_from(normal)] *= 1 + 1e-6
    normal[np.diag_indices_from(normal)] += 1e-9 * normal.max()
    return np.asarray(np.linalg.solve(normal, weighted.T @ right))
