"""The kernel that makes the difference of two smoothed photographs of their mean; the tone curve.

``D(p) = sum over q of (a_q + b_q x + c_q y) M(p + q)
        + M {x^2, x y, y^2} + {1, x, y, x^2, x y, y^2}``

with x and y from -1 to 1 over the grid: a kernel that changes over the frame with the blur and
the light, and an offset. The weights are robust: changes are outliers.

Of a tone curve, medians of one photograph's levels against the other's where both are smooth give a
first guess. It is then improved together with the kernel: splines of the target's levels, made
before the smoothing because smoothing and a curve do not commute, are more columns of the same
least squares.

References
----------
C. Alard and R. H. Lupton, "A method for optimal image subtraction", 1998, with the delta functions
of D. M. Bramich, "A new algorithm for difference image analysis", 2008, for a basis.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from analysis.changes.matching._smoothed_warp import sampled, smoothed
from analysis.changes.matching.relative_blur import Smoothing
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray
from simulation.compiled import compiled, compiled_part

KERNEL_RADIUS_PX = 3
"""Kernels of 5 x 5 to 9 x 9 do as well: the photographs are of one sharpness before."""

_SIDE = 2 * KERNEL_RADIUS_PX + 1
_TAPS = _SIDE * _SIDE
CENTRE_TAP = _TAPS // 2
_LINEAR = 3 * _TAPS
_COLUMNS = _LINEAR + 9

_LIGHT = np.zeros(_COLUMNS, dtype=np.bool_)
_LIGHT[[CENTRE_TAP, _LINEAR + 3]] = True
_FIELDS = _LIGHT.copy()
_FIELDS[[CENTRE_TAP + _TAPS, CENTRE_TAP + 2 * _TAPS]] = _FIELDS[_LINEAR:] = True
_ONE_KERNEL = _FIELDS.copy()
_ONE_KERNEL[:_TAPS] = True
LADDER = (_LIGHT, _FIELDS, _ONE_KERNEL, np.ones(_COLUMNS, dtype=np.bool_))
"""Columns of models from the simplest on: gain and offset; both changing over the frame; a kernel;
one that changes over the frame."""
_RIDGE = 1e-4
"""Over the power of the source, most of which lies at frequencies that a blur leaves alone: 1e-2
holds back the change of blur over a frame that is tilted by 4 degrees, which then scatters by 1.2
times the noise of 50 frames averaged; 1e-5 lets small frames fit their noise."""

_CENTRE, _SLOPES = 0.01, 3.0
"""Ridge of the centre tap and of the taps' slopes over the frame, over that of other taps."""

_REACH = 5.0
"""Standard deviations from which on Tukey's biweight counts a pixel as nothing."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MatchingKernel:
    """A fitted kernel with its light.

    ``coefficients``: shape ``(columns,)``: taps, taps times x, taps times y, three of the gain, six
    of the offset. ``level_dn``: mean of the source, which is taken from it first.
    """

    coefficients: FloatArray
    level_dn: float

    @property
    def taps(self) -> FloatArray:
        """Kernel at the middle of the frame, shape ``(side, side)``, order (y, x)."""
        return self.coefficients[:_TAPS].reshape(_SIDE, _SIDE)

    @property
    def varying_shift_px2(self) -> float:
        """Mean square over the frame of what varies of the kernel's centroid: of a displacement."""
        one, of_x, of_y = self.coefficients[:_LINEAR].reshape(3, _SIDE, _SIDE)
        whole = 1.0 + one.sum()
        q = np.arange(_SIDE) - KERNEL_RADIUS_PX
        slopes = [[taps.sum(axis=0) @ q, taps.sum(axis=1) @ q] for taps in (of_x, of_y)]
        # x and y from -1 to 1: their mean squares are 1/3.
        return float(np.sum(np.square(slopes)) / 3 / whole**2)

    def light(self, shape: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
        """Gain, which is the sum of the kernel, and offset at every pixel."""
        sums = self.coefficients[:_LINEAR].reshape(3, _TAPS).sum(axis=1)
        gain = np.concatenate([sums, self.coefficients[_LINEAR : _LINEAR + 3]])
        return _polynomial(gain, shape), _polynomial(self.coefficients[_LINEAR + 3 :], shape)

    def of(self, source: Float32Array) -> Float32Array:
        """Apply the kernel and the light."""
        taps = self.coefficients[:_LINEAR].reshape(3, _TAPS)
        if not np.delete(taps, CENTRE_TAP, axis=1).any():
            gain, offset = self.light((source.shape[0], source.shape[1]))
            gain *= source - np.float32(self.level_dn)
            gain += offset
            return gain
        return _applied(source, self.level_dn, self.coefficients)

    def at(self, source: Float32Array, rows: IntArray, cols: IntArray) -> FloatArray:
        """The same at pixels that are the kernel's radius away from the border, shape ``(n,)``."""
        return _applied_at(source, self.level_dn, rows, cols, self.coefficients)


NO_KERNEL = MatchingKernel(coefficients=np.zeros(_COLUMNS), level_dn=0.0)


def _polynomial(coefficients: FloatArray, shape: tuple[int, int]) -> Float32Array:
    """``{1, x, y, x^2, x y, y^2}`` over the frame."""
    rows, cols = shape
    y, x = np.linspace(-1, 1, rows, dtype=np.float32), np.linspace(-1, 1, cols, dtype=np.float32)
    one, of_x, of_y, of_xx, of_xy, of_yy = coefficients.astype(np.float32)
    made = np.empty((rows, cols), dtype=np.float32)
    base, slope = of_x * x + of_xx * (x * x), of_xy * x
    # Row by row: what is computed on the way stays in the processor's cache.
    for row, at_y in enumerate(y):
        np.multiply(slope, at_y, out=made[row])
        made[row] += base
        made[row] += one + at_y * (of_y + at_y * of_yy)
    return made


@compiled(nogil=True, fastmath={"contract"})
def _applied(source: Float32Array, level_dn: float, coefficients: FloatArray) -> Float32Array:
    """Kernel and light at all pixels; mirrored at the border."""
    height, width = source.shape
    radius = KERNEL_RADIUS_PX
    weights = coefficients.astype(np.float32)
    x = np.linspace(-1, 1, width).astype(np.float32)
    x_square = x * x
    # The source's lines around a row, in turns.
    lines = np.empty((_SIDE, width + 2 * radius), dtype=np.float32)
    made = np.empty((height, width), dtype=np.float32)
    along = np.empty(width, dtype=np.float32)
    for row in range(-radius, height + radius):
        line = lines[row % _SIDE]
        level = source[_mirrored(row, height)]
        for col in range(radius):
            line[col] = level[_mirrored(col - radius, width)] - level_dn
            line[radius + width + col] = level[_mirrored(width + col, width)] - level_dn
        line[radius : radius + width] = level - np.float32(level_dn)
        middle = row - radius
        if middle < 0:
            continue
        y = np.float32(2.0 * middle / max(height - 1, 1) - 1.0)
        one, of_x, of_y, of_xx, of_xy, of_yy = weights[_LINEAR + 3 :]
        total = made[middle]
        total[:] = one + y * (of_y + y * of_yy)
        total += x * (of_x + y * of_xy) + x_square * of_xx
        along[:] = 0
        place = 0
        for dy in range(_SIDE):
            near = lines[(middle + dy - radius) % _SIDE]
            for dx in range(_SIDE):
                fixed = weights[place] + y * weights[2 * _TAPS + place]
                _add_scaled(total, along, near[dx : dx + width], fixed, weights[_TAPS + place])
                place += 1
        xx, xy, yy = weights[_LINEAR : _LINEAR + 3]
        own = lines[middle % _SIDE][radius : radius + width]
        for col in range(width):
            gain = xx * x_square[col] + y * (xy * x[col] + yy * y)
            total[col] += x[col] * along[col] + gain * own[col]
    return made


@compiled_part()
def _mirrored(at: int, size: int) -> int:
    """Index of a line beyond the border, the border's own not repeated."""
    while at < 0 or at >= size:
        at = -at if at < 0 else 2 * size - 2 - at
    return at


@compiled_part(fastmath={"contract"})
def _add_scaled(
    first: Float32Array, second: Float32Array, line: Float32Array, own: float, other: float
) -> None:
    for col in range(len(line)):
        first[col] += own * line[col]
        second[col] += other * line[col]


@compiled(nogil=True)
def _applied_at(
    source: Float32Array, level_dn: float, rows: IntArray, cols: IntArray, coefficients: FloatArray
) -> FloatArray:
    height, width = source.shape
    made = np.empty(len(rows))
    gains, offset = coefficients[_LINEAR : _LINEAR + 3], coefficients[_LINEAR + 3 :]
    for i in range(len(rows)):
        row, col = rows[i], cols[i]
        y, x = 2.0 * row / (height - 1) - 1.0, 2.0 * col / (width - 1) - 1.0
        total = offset[0] + offset[1] * x + offset[2] * y
        total += offset[3] * x * x + offset[4] * x * y + offset[5] * y * y
        level = source[row, col] - level_dn
        total += level * (gains[0] * x * x + gains[1] * x * y + gains[2] * y * y)
        place = 0
        for dy in range(-KERNEL_RADIUS_PX, KERNEL_RADIUS_PX + 1):
            for dx in range(-KERNEL_RADIUS_PX, KERNEL_RADIUS_PX + 1):
                tap = coefficients[place] + x * coefficients[place + _TAPS]
                tap += y * coefficients[place + 2 * _TAPS]
                total += tap * (source[row + dy, col + dx] - level_dn)
                place += 1
        made[i] = total
    return made


@compiled(nogil=True)
def design_matrix(
    source: Float32Array, level_dn: float, rows: IntArray, cols: IntArray
) -> FloatArray:
    """Columns of the model at pixels, shape ``(pixels, columns)``."""
    height, width = source.shape
    design = np.empty((len(rows), _COLUMNS))
    for i in range(len(rows)):
        row, col = rows[i], cols[i]
        y, x = 2.0 * row / (height - 1) - 1.0, 2.0 * col / (width - 1) - 1.0
        place = 0
        for dy in range(-KERNEL_RADIUS_PX, KERNEL_RADIUS_PX + 1):
            for dx in range(-KERNEL_RADIUS_PX, KERNEL_RADIUS_PX + 1):
                level = source[row + dy, col + dx] - level_dn
                design[i, place] = level
                design[i, place + _TAPS] = x * level
                design[i, place + 2 * _TAPS] = y * level
                place += 1
        level = source[row, col] - level_dn
        for k, term in enumerate((x * x, x * y, y * y)):
            design[i, _LINEAR + k] = term * level
        for k, term in enumerate((1.0, x, y, x * x, x * y, y * y)):
            design[i, _LINEAR + 3 + k] = term
    return design


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormalEquations:
    """Of weighted least squares with a ridge, for all columns or for some."""

    normal: FloatArray
    right: FloatArray

    @classmethod
    def of(
        cls,
        design: FloatArray,
        target_dn: FloatArray,
        weight: FloatArray,
        prior: FloatArray | None = None,
        centre: float = 0.0,
    ) -> "NormalEquations":
        """Set them up.

        ``design, target_dn, weight``: shapes ``(pixels, columns)``, ``(pixels,)`` and
        ``(pixels,)``. ``prior``: a matrix to add, for columns beyond the kernel's. ``centre``: what
        the ridge holds the centre tap to; the others it holds to 0.
        """
        root = np.sqrt(weight)[:, None]
        rooted = design * root
        normal = rooted.T @ rooted
        right = rooted.T @ (target_dn * root[:, 0])
        ridge = np.zeros(design.shape[1])
        ridge[:_TAPS], ridge[_TAPS:_LINEAR] = 1.0, _SLOPES
        ridge[[CENTRE_TAP, CENTRE_TAP + _TAPS, CENTRE_TAP + 2 * _TAPS]] *= _CENTRE
        ridge *= _RIDGE * normal[CENTRE_TAP, CENTRE_TAP]
        right[CENTRE_TAP] += centre * ridge[CENTRE_TAP]
        # The ridge leaves the gain's squares and the offset alone; a flat frame does not tell them.
        ridge += 1e-9 * np.diag(normal) + 1e-300
        normal[np.diag_indices_from(normal)] += ridge
        if prior is not None:
            normal += prior
        return cls(normal=normal, right=right)

    def solution(self, columns: BoolArray | None = None) -> FloatArray:
        """Coefficients, of these columns alone if they are given; 0 of the others."""
        if columns is None or columns.all():
            return np.asarray(np.linalg.solve(self.normal, self.right))
        some = np.flatnonzero(columns)
        made = np.zeros(len(self.right))
        made[some] = np.linalg.solve(self.normal[np.ix_(some, some)], self.right[some])
        return made


def biweight(deviations: FloatArray) -> FloatArray:
    """Tukey's weights of residuals in standard deviations."""
    return np.asarray(np.maximum(1 - (deviations / _REACH) ** 2, 0.0) ** 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class WhiteNoiseGain:
    """Variance of the difference for a white noise of variance 1 in either photograph."""

    source: float
    target: float


def white_noise_gain(
    taps: FloatArray, smoothing: Smoothing, zoom: float, target_taps: FloatArray | None = None
) -> WhiteNoiseGain:
    """What smoothing and kernels leave of white noise, in closed form.

    A Gaussian of width s leaves ``1 / (4 pi s^2)``, correlated as ``exp(-d^2 / (4 s^2))``.
    ``taps``: kernel of the source, shape ``(side, side)``. ``zoom``: source pixels per pixel of the
    grid, along a line.
    """
    passed = _passed(taps, smoothing.source_px)
    own = 1.0 if target_taps is None else _passed(target_taps, smoothing.target_px)
    return WhiteNoiseGain(
        source=passed / (4 * np.pi * (smoothing.source_px * zoom) ** 2),
        target=own / (4 * np.pi * smoothing.target_px**2),
    )


def _passed(taps: FloatArray, width_px: float) -> float:
    y, x = np.indices(taps.shape).reshape(2, -1)
    square = (y[:, None] - y) ** 2 + (x[:, None] - x) ** 2
    return float(taps.ravel() @ np.exp(-square / (4 * width_px**2)) @ taps.ravel())


_SAMPLE_PX = 25_000
_SMOOTH_SHARE = 0.4
"""Share of the pixels, those with the least gradient, at which levels are held against levels."""

_BINS, _LEAST_PX = 48, 12
_DEGREE = 3
_KNOTS = 16
_TABLE = 1024
_RARE_PERCENT, _RARE_PX = 0.5, 3000
_BEND = 2e-3
"""Standard deviation of the splines' second differences about the first curve, over its range:
levels that hardly occur follow their neighbours."""

_ROUNDS = 3
_LEAST_SLOPE = 0.02
"""Of the curve, over its mean: steeper the other way round, noise would be all that it shows."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ToneCurve:
    """Levels of the source for the levels of the target; straight beyond both ends.

    ``levels_dn``: levels of the target, evenly spaced, shape ``(n,)``. ``values_dn, variance_dn2``:
    levels of the source there, and the variance that the fit leaves them.
    """

    levels_dn: FloatArray
    values_dn: FloatArray
    variance_dn2: FloatArray

    def of(self, image: Float32Array) -> Float32Array:
        """Bring a photograph to the source's levels."""
        step = self.levels_dn[1] - self.levels_dn[0]
        slopes = (self.values_dn[[1, -1]] - self.values_dn[[0, -2]]) / step
        made = np.interp(image, self.levels_dn, self.values_dn)
        made += np.minimum(image - self.levels_dn[0], 0) * slopes[0]
        made += np.maximum(image - self.levels_dn[-1], 0) * slopes[1]
        return made.astype(np.float32)

    def slope(self, image: Float32Array) -> Float32Array:
        """Derivative at the levels of a photograph."""
        slopes = np.gradient(self.values_dn, self.levels_dn)
        return np.interp(image, self.levels_dn, slopes).astype(np.float32)

    def variance(self, image: Float32Array) -> Float32Array:
        """Variance of the curve at the levels of a photograph."""
        return np.interp(image, self.levels_dn, self.variance_dn2).astype(np.float32)


def fit_tone_curve(
    source: Float32Array, target: Float32Array, valid: BoolArray, smoothing_px: float
) -> ToneCurve | None:
    """Fit the curve and the kernel together; None where levels do not tell one."""
    first = _by_medians(source, smoothed(target, smoothing_px), target, valid)
    if first is None:
        return None
    rows, cols = _sample_with_ends(target, valid)
    level = float(source[rows, cols].mean())
    design = design_matrix(source, level, rows, cols)
    basis = _basis(first, target[rows, cols])
    splines = np.stack(
        [
            smoothed(np.interp(target, first.levels_dn, line).astype(np.float32), smoothing_px)[
                rows, cols
            ]
            for line in basis
        ],
        axis=1,
    ).astype(np.float64)
    measured = smoothed(first.of(target), smoothing_px)[rows, cols].astype(np.float64)
    joint = np.concatenate([design, -splines], axis=1)
    bends = np.zeros((_KNOTS, joint.shape[1]))
    bends[:, design.shape[1] :] = np.diff(np.eye(_KNOTS + 2), 2, axis=0)
    bends /= _BEND * (first.values_dn[-1] - first.values_dn[0])
    weight = np.ones(len(rows))
    alike = 4 * np.pi * smoothing_px**2 / np.count_nonzero(valid) * len(rows) + 1
    for _ in range(_ROUNDS):
        equations = NormalEquations.of(joint, measured, weight, bends.T @ bends, centre=1.0)
        coefficients = equations.solution()
        residual = measured - joint @ coefficients
        scale = robust_sigma(residual) + 1e-9
        weight = biweight(residual / scale) / (scale**2 * alike)
    rooted = joint * np.sqrt(weight)[:, None]
    normal = rooted.T @ rooted + bends.T @ bends
    normal[np.diag_indices_from(normal)] *= 1 + 1e-9
    covariance = np.linalg.inv(normal)[design.shape[1] :, design.shape[1] :]
    made = first.values_dn + coefficients[design.shape[1] :] @ basis
    return _rising(first.levels_dn, made, np.einsum("in,ij,jn->n", basis, covariance, basis))


def _sample_with_ends(target: Float32Array, valid: BoolArray) -> tuple[IntArray, IntArray]:
    """A sample of pixels, and more of the darkest and the brightest, which are rare."""
    rows, cols = sampled(valid, _SAMPLE_PX)
    low, high = np.percentile(target[rows, cols], [_RARE_PERCENT, 100 - _RARE_PERCENT]).tolist()
    rare = sampled(valid & ((target < low) | (target > high)), _RARE_PX)
    return np.concatenate([rows, rare[0]]), np.concatenate([cols, rare[1]])


def _by_medians(
    source: Float32Array, smooth_target: Float32Array, target: Float32Array, valid: BoolArray
) -> ToneCurve | None:
    """Cubic through the medians of the source at levels of the target, over all its levels."""
    slope_y, slope_x = np.gradient(smooth_target)
    steep: Float32Array = np.asarray(slope_y * slope_y + slope_x * slope_x)
    smooth = valid & (steep <= float(np.quantile(steep[valid], _SMOOTH_SHARE)))
    level, value = smooth_target[smooth], source[smooth]
    edges = np.linspace(float(level.min()), float(level.max()) + 1e-6, _BINS + 1)
    index = np.digitize(level, edges) - 1
    middles, medians, counts = [], [], []
    for bin_number in range(_BINS):
        inside = index == bin_number
        count = np.count_nonzero(inside)
        if count >= _LEAST_PX:
            middles.append(float(np.median(level[inside])))
            medians.append(float(np.median(value[inside])))
            counts.append(count)
    if len(middles) < _DEGREE + 2:
        return None
    curve = np.polynomial.Polynomial.fit(middles, medians, _DEGREE, w=np.array(counts) ** 0.25)
    levels = np.linspace(float(target[valid].min()), float(target[valid].max()) + 1e-6, _TABLE)
    return _rising(levels, np.asarray(curve(levels)), np.zeros(_TABLE))


def _rising(
    levels_dn: FloatArray, values_dn: FloatArray, variance_dn2: FloatArray
) -> ToneCurve | None:
    """The curve, made to rise everywhere; None if it does not as a whole."""
    steps = np.diff(values_dn)
    mean = float(steps.mean())
    if not mean > 0:
        return None
    rising = np.concatenate([[0.0], np.cumsum(np.maximum(steps, _LEAST_SLOPE * mean))])
    middle = len(levels_dn) // 2
    values = values_dn[middle] - rising[middle] + rising
    return ToneCurve(levels_dn=levels_dn, values_dn=values, variance_dn2=variance_dn2)


def _basis(first: ToneCurve, levels: Float32Array) -> FloatArray:
    """Cubic B-splines over the levels, orthogonal to a constant and to the first curve.

    Otherwise the target would explain itself. Shape ``(splines, n)``.
    """
    low, high = float(first.levels_dn[0]), float(first.levels_dn[-1])
    step = (high - low) / (_KNOTS - 1)
    knots = low + step * np.arange(-3, _KNOTS + 3)
    table = (
        BSpline.design_matrix(np.clip(first.levels_dn, low, high - 1e-9 * step), knots, 3)
        .toarray()
        .T
    )
    share, _ = np.histogram(levels, bins=_TABLE, range=(low, high))
    root = np.sqrt(share + 1e-3)
    fixed = np.stack([np.ones(_TABLE), first.values_dn - first.values_dn.mean()])
    weights = np.linalg.lstsq((fixed * root).T, (table * root).T, rcond=None)[0]
    return np.asarray(table - weights.T @ fixed)
