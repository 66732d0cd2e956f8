"""A pose refined at one resolution: the coarser photograph against what it sees in the finer one.

Two photographs at one resolution near a pose: samples of the coarser one and what it sees. Both are
smoothed to one resolution, so that neither has to be the sharper one.

A damped Gauss-Newton descent moves the pose. Slow changes of light and a tone curve are fitted at
the same time, changes are outliers (Tukey's biweight), and residuals count by the scatter of their
own block of the frame, so that a region that does not fit does not outvote the others.

References
----------
D. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", 1963; P. Huber
and E. Ronchetti, "Robust statistics", 2009, section 4.8, for the biweight.
"""

from dataclasses import dataclass, field, replace
from math import sqrt

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from calibration.registration._agreement import AlignedPhotograph, blur_variance_px2
from calibration.registration._distorted_pose import DistortedPose
from calibration.robust import robust_sigma
from simulation import GaussianPsf
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray
from simulation.pose import DISTORTION_MAX, projection_slopes

ASSUMED_SIGMA_PX = 0.65
"""Total PSF if none is given: a wrong width blurs every detail symmetrically and moves nothing."""

BLOCK_PX = 24
"""Side of the blocks between which, but not within which, residuals count as independent."""

_SMOOTHING_PX = 1.0
"""Of both photographs, in pixels of the coarser one: it suppresses what the coarser one aliases."""

_BORDER_PX = 3.0
_STRIDE_PX = 6.0
"""Pixels to a sample, beyond which a small overlap is sampled more closely: correlated noise leaves
about 4 pi smoothing^2 pixels to one that is independent, and detail more."""

_FLAT = 1e-3
"""Of the rms slope, below which samples of a drawing are flat: 9 of 10 of all agree to the bit, and
say nothing of the scatter of the others."""

_AROUND = 0.25
"""Of the source's size: how far outside it samples may lie, as the pose is approximate."""


class LevelPair:
    """Two photographs, the finer source and the coarser target, at one resolution near a pose.

    The pose maps target to source, approximately; ``factor`` pixels of the target are averaged
    along each axis. Of the ``samples`` at most are compared: with the smoothing, neighbours tell
    hardly anything new. ``scatters`` are those whose residuals tell how large residuals are.
    """

    def __init__(
        self,
        photographs: tuple[AlignedPhotograph, AlignedPhotograph],
        pose: DistortedPose,
        psf: GaussianPsf | None,
        factor: int,
        samples: int,
    ) -> None:
        source, target = photographs
        self.factor = factor
        self.target_shape = target.shape
        self._source_factor = factor * 2 ** int(np.log2(max(pose.zoom, 1.0) + 1e-9))
        far = target.reduced(factor).smoothed(_SMOOTHING_PX, _SMOOTHING_PX)
        near = source.reduced(self._source_factor)
        near = near.smoothed(*_missing_blur_px(pose, psf, factor, self._source_factor))
        self._coefficients = spline_filter(near.levels, order=3, output=np.float32, mode="reflect")
        self._near_usable = near.usable
        y, x = _samples(far, samples, pose.overlap)
        places = ((at.astype(np.float64) + 0.5) * factor - 0.5 for at in (y, x))
        near_source = pose.shows(*pose.to_reference_px(*places), margin=_AROUND)
        y, x = y[near_source], x[near_source]
        self.measured = far.levels[y, x].astype(np.float64)
        self.slope_y, self.slope_x = (_slopes(far.levels, axis)[y, x] / factor for axis in (0, 1))
        square = self.slope_y**2 + self.slope_x**2
        self.scatters: BoolArray = np.ones(len(square), dtype=np.bool_)
        if target.is_drawing and len(square):
            self.scatters = square > _FLAT**2 * square.mean()
        self.y_px, self.x_px = ((at.astype(np.float64) + 0.5) * factor - 0.5 for at in (y, x))
        v, u = (
            (at - (n - 1) / 2) / (max(target.shape) / 2)
            for at, n in zip((self.y_px, self.x_px), target.shape, strict=True)
        )
        self._shades = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v])
        self.block: IntArray = (y // BLOCK_PX) * (far.shape[1] // BLOCK_PX + 1) + x // BLOCK_PX
        self.is_odd_block: BoolArray = (y // BLOCK_PX + x // BLOCK_PX) % 2 == 1

    def seen(self, pose: DistortedPose) -> tuple[FloatArray, BoolArray]:
        """The source's levels at the samples by a pose, and which samples it shows."""
        return self._seen_at(*pose.to_reference_px(self.y_px, self.x_px))

    def _seen_at(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, BoolArray]:
        y, x = ((at + 0.5) / self._source_factor - 0.5 for at in (y_px, x_px))
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

    def predicted_slopes(self, pose: DistortedPose, gain: float) -> tuple[FloatArray, FloatArray]:
        """Slopes of the prediction along x and y, per target px, shape (n,) each.

        ``gain`` is the first coefficient of ``light_columns``.
        """
        levels, inside = self.seen(pose)
        gain /= float(levels[inside].std()) + 1e-12
        half = self.factor / 2
        made = []
        for dy, dx in ((0.0, half), (half, 0.0)):
            ahead, _ = self._seen_at(*pose.to_reference_px(self.y_px + dy, self.x_px + dx))
            behind, _ = self._seen_at(*pose.to_reference_px(self.y_px - dy, self.x_px - dx))
            made.append(gain * (ahead - behind) / self.factor)
        return made[0], made[1]

    def light_columns(self, levels: FloatArray, inside: BoolArray) -> FloatArray:
        """What the source's levels become in the target's light, shape (n, 14), contiguous columns.

        Gain and offset as quadratics over the frame, gain first, and a cubic tone curve.
        """
        seen = levels[inside]
        centred = (levels - seen.mean()) / (seen.std() + 1e-12)
        count = len(self._shades)
        columns = np.empty((2 * count + 2, len(levels)))
        np.multiply(self._shades, centred, out=columns[:count])
        columns[count:-2] = self._shades
        np.square(centred, out=columns[-2])
        # numpy's third power takes twenty times as long.
        np.multiply(columns[-2], centred, out=columns[-1])
        return columns.T


def _samples(far: AlignedPhotograph, most: int, overlap: float) -> tuple[IntArray, IntArray]:
    """Rows and columns of usable pixels, evenly over the frame; more where less is in common."""
    rows, cols = far.shape
    stride = max(rows * cols / most, 1.0)
    stride = max(stride * overlap, min(stride, _STRIDE_PX))
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
    y, x = (
        np.array([rows - 1.0, rows, rows - 1.0]) / 2,
        np.array([cols - 1.0, cols - 1.0, cols]) / 2,
    )
    to_y, to_x = pose.to_reference_px(y, x)
    slopes = 2 * np.array(
        [[to_x[2] - to_x[0], to_x[1] - to_x[0]], [to_y[2] - to_y[0], to_y[1] - to_y[0]]]
    )
    slopes *= factor / source_factor
    missing = np.diag(slopes @ far @ slopes.T) - own
    sigma_x, sigma_y = np.sqrt(np.maximum(missing, 0.0)).tolist()
    return sigma_x, sigma_y


_MOTIONS = ((0, 2), (1, 2), (0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1))
"""Elements of each motion in the 3 x 3 matrix that is added to the identity, in coordinates (u, v)
in [-1, 1] about the centre; shifts along x and y come first."""

_K1_PRIOR = 0.05
"""Standard deviation of the distortion of real lenses; it decides at zooms near 1."""

_K1_STEP = 1e-4


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Prior:
    """Normal equations of what is known of the parameters beforehand."""

    normal: FloatArray
    right: FloatArray


class PoseMotions:
    """The parameters of a pose but its displacement, and how each of them moves samples.

    The lens's distortion is the last where it is fitted; samples are pixels of the target.
    """

    def __init__(
        self,
        y_px: FloatArray,
        x_px: FloatArray,
        shape: tuple[int, int],
        *,
        fits_distortion: bool,
    ) -> None:
        self._y_px, self._x_px, self._shape = y_px, x_px, shape
        self.fits_distortion = fits_distortion
        self.projective = _projective_flows(y_px, x_px, shape)

    def flows(self, pose: DistortedPose) -> tuple[FloatArray, FloatArray]:
        """Displacement along x and y per unit of each parameter, in target px, (n, parameters)."""
        if not self.fits_distortion:
            return self.projective
        along_x, along_y = (
            np.concatenate([straight, bent], axis=1)
            for straight, bent in zip(self.projective, self.distortion_flow(pose), strict=True)
        )
        return along_x, along_y

    def moved(self, pose: DistortedPose, step: FloatArray) -> DistortedPose:
        """Return the pose after a step of all parameters."""
        count = len(_MOTIONS)
        matrix = _moved_matrix(pose.matrix, step[:count], self._shape)
        k1 = pose.k1 + float(step[count]) if self.fits_distortion else pose.k1
        return pose.with_(matrix, k1, pose.displacement)

    def prior(self, pose: DistortedPose) -> _Prior:
        """What is known of distortions."""
        size = len(_MOTIONS) + self.fits_distortion
        normal, right = np.zeros((size, size)), np.zeros(size)
        if self.fits_distortion:
            normal[-1, -1] = 1 / _K1_PRIOR**2
            right[-1] = -pose.k1 / _K1_PRIOR**2
        return _Prior(normal=normal, right=right)

    def distortion_flow(self, pose: DistortedPose) -> tuple[FloatArray, FloatArray]:
        """Displacement along x and y per unit of distortion, in target px, shape (n, 1) each."""
        above, below = (
            pose.with_(pose.matrix, pose.k1 + sign * _K1_STEP, pose.displacement).to_reference_px(
                self._y_px, self._x_px
            )
            for sign in (1, -1)
        )
        moved_y, moved_x = ((a - b) / (2 * _K1_STEP) for a, b in zip(above, below, strict=True))
        (a, b), (c, d) = np.linalg.inv(pose.matrix[:2, :2]).tolist()
        return (a * moved_x + b * moved_y)[:, None], (c * moved_x + d * moved_y)[:, None]


def _projective_flows(
    y_px: FloatArray, x_px: FloatArray, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Displacement by one pixel of each of 8 projective motions, along x and y, shape (n, 8)."""
    half_px = _half_size_px(shape)
    u, v = (x_px - (shape[1] - 1) / 2) / half_px, (y_px - (shape[0] - 1) / 2) / half_px
    unit, nothing = (u, v, np.ones_like(u)), np.zeros_like(u)
    along_x, along_y = [], []
    for row, col in _MOTIONS:
        along_x.append(unit[col] if row == 0 else -unit[col] * u if row == 2 else nothing)
        along_y.append(unit[col] if row == 1 else -unit[col] * v if row == 2 else nothing)
    return np.stack(along_x, axis=1), np.stack(along_y, axis=1)


def _moved_matrix(matrix: FloatArray, step_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Pose after a step of pixels along each projective motion; its last element is 1."""
    half_px = _half_size_px(shape)
    to_unit = np.diag([1 / half_px, 1 / half_px, 1.0])
    to_unit[:2, 2] = [-(shape[1] - 1) / 2 / half_px, -(shape[0] - 1) / 2 / half_px]
    motion = np.eye(3)
    for element, amount in zip(_MOTIONS, step_px, strict=True):
        motion[element] += amount / half_px
    moved = matrix @ np.linalg.inv(to_unit) @ motion @ to_unit
    return np.asarray(moved / moved[2, 2])


def zoom_at_centre(matrix: FloatArray, shape: tuple[int, int]) -> float:
    """Square root of the homography's area ratio at the image centre."""
    a, b, c, d = projection_slopes(matrix, (shape[1] - 1) / 2, (shape[0] - 1) / 2)
    return sqrt(abs(a * d - b * c))


def _half_size_px(shape: tuple[int, int]) -> float:
    """Unit of the motions' coordinates: half the longer side of the follow-up."""
    return max(shape) / 2


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

    The source shows the samples ``inside``; residuals are target less prediction, 0 outside, scales
    their scatter by blocks, weights robust ones over the variance. The cost is the mean of the
    biweight's loss, between 0 and 1.
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
    """Descent of a pose at one resolution, in the pose's degrees of freedom."""

    def __init__(self, pair: LevelPair, motions: PoseMotions) -> None:
        self._pair = pair
        self._motions = motions
        self._rises = self._rises_along(*motions.projective)

    def _rises_along(self, along_x: FloatArray, along_y: FloatArray) -> FloatArray:
        """Change of the samples' levels by displacements of shape (n, k), shape (k, n).

        By the target's slopes: their noise and that of the residuals are uncorrelated.
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
