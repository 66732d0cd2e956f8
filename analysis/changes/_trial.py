"""Whether a shift explains one change better than an added spot does.

Both are fitted by Levenberg and Marquardt's steps to residuals in standard deviations, on the
change's pixels and a ring around them. Chi-squared is the mean square in standard deviations times
the number of independent values: errors with the correlation ``exp(-d^2 / (4 s^2))`` have, by the
variance of a sum of their squares, one to ``2 pi s^2`` pixels. Positions are ``(y, x)`` in a
window; displacements are of what is seen, from before to after.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import ceil, exp, inf, pi

import cv2
import numpy as np
from scipy.ndimage import spline_filter

from simulation.arrays import BoolArray, FloatArray, FloatImage, IntArray
from simulation.compiled import compiled, compiled_part

_STEPS = 12
_LEAST_GAIN = 1e-3
_MOST_DAMPING = 1e3
_PER_SHIFT, _PER_SPOT = 6, 6


@compiled_part()
def _weights(t: float, weight: FloatArray, slope: FloatArray) -> None:
    """Cubic B-spline and its derivative, at the distances of four knots."""
    weight[0] = (1 - t) ** 3 / 6
    weight[1] = (4 - 6 * t * t + 3 * t**3) / 6
    weight[2] = (1 + 3 * t + 3 * t * t - 3 * t**3) / 6
    weight[3] = t**3 / 6
    slope[0] = -((1 - t) ** 2) / 2
    slope[1] = (3 * t * t - 4 * t) / 2
    slope[2] = (1 + 2 * t - 3 * t * t) / 2
    slope[3] = t * t / 2


@compiled_part()
def _solve(normal: FloatArray, right: FloatArray, count: int) -> None:
    """Solve a positive definite system in place, by Cholesky."""
    for i in range(count):
        for j in range(i + 1):
            total = normal[i, j]
            for k in range(j):
                total -= normal[i, k] * normal[j, k]
            normal[i, j] = np.sqrt(max(total, 1e-30)) if i == j else total / normal[j, j]
    for i in range(count):
        for k in range(i):
            right[i] -= normal[i, k] * right[k]
        right[i] /= normal[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            right[i] -= normal[k, i] * right[k]
        right[i] /= normal[i, i]


@compiled()
def shift_residuals(
    pixels: FloatArray, moving: FloatArray, valid: BoolArray, shift: FloatArray, slopes: FloatArray
) -> FloatArray:
    """What a shift leaves, in standard deviations, shape ``(n,)``.

    ``pixels``: shape ``(n, 8)``: row, column, level of the image that is held, standard deviation,
    what no shift leaves, the two affine coordinates, and the sense: 1 if what is seen there after
    came from elsewhere, -1 if what was seen there before went elsewhere. ``moving``: cubic B-spline
    coefficients of the image before and of the one after, shape ``(2, rows, cols)``. ``valid``:
    where they count; a pixel from elsewhere has what no shift leaves. ``shift``: displacement (y,
    x) and its slopes along the affine coordinates, shape (6,). ``slopes``: receives the derivatives
    by ``shift``, shape ``(n, 6)``.
    """
    count = len(pixels)
    rows, cols = valid.shape
    left = np.empty(count)
    down, along = np.empty(4), np.empty(4)
    down_slope, along_slope = np.empty(4), np.empty(4)
    for i in range(count):
        u, v, sense = pixels[i, 5], pixels[i, 6], pixels[i, 7]
        image = 0 if sense > 0 else 1
        y = pixels[i, 0] - sense * (shift[0] + shift[2] * u + shift[3] * v)
        x = pixels[i, 1] - sense * (shift[1] + shift[4] * u + shift[5] * v)
        row, col = int(np.floor(y)), int(np.floor(x))
        is_seen = 1 <= row < rows - 2 and 1 <= col < cols - 2
        is_seen = is_seen and valid[int(np.rint(y)), int(np.rint(x))]
        if not is_seen:
            left[i] = pixels[i, 4]
            slopes[i, :] = 0.0
            continue
        _weights(y - row, down, down_slope)
        _weights(x - col, along, along_slope)
        level = by_y = by_x = 0.0
        for j in range(4):
            line = line_slope = 0.0
            for k in range(4):
                value = moving[image, row - 1 + j, col - 1 + k]
                line += along[k] * value
                line_slope += along_slope[k] * value
            level += down[j] * line
            by_y += down_slope[j] * line
            by_x += down[j] * line_slope
        left[i] = sense * (pixels[i, 2] - level) / pixels[i, 3]
        by_y /= pixels[i, 3]
        by_x /= pixels[i, 3]
        slopes[i, 0], slopes[i, 1] = by_y, by_x
        slopes[i, 2], slopes[i, 3] = by_y * u, by_y * v
        slopes[i, 4], slopes[i, 5] = by_x * u, by_x * v
    return left


@compiled()
def fit_shift(
    pixels: FloatArray, moving: FloatArray, valid: BoolArray, start: FloatArray, prior: FloatArray
) -> FloatArray:
    """Shift that leaves least, shape (6,), from ``start``.

    ``prior``, shape (7,): weights of the squared distances from ``start``'s, infinite for what is
    not fitted, and the furthest way.
    """
    free = np.flatnonzero(np.isfinite(prior[:6]))
    count, most_px = len(free), prior[6]
    slopes, trial_slopes = np.empty((len(pixels), 6)), np.empty((len(pixels), 6))
    shift = start.copy()
    left = shift_residuals(pixels, moving, valid, shift, slopes)
    cost = np.sum(left * left)
    damping = 1e-3
    normal, right = np.empty((count, count)), np.empty(count)
    for _ in range(_STEPS):
        for i in range(count):
            weight = prior[free[i]]
            right[i] = -np.sum(slopes[:, free[i]] * left)
            right[i] -= weight * (shift[free[i]] - start[free[i]])
            for j in range(i + 1):
                normal[i, j] = np.sum(slopes[:, free[i]] * slopes[:, free[j]])
            normal[i, i] = (normal[i, i] + weight) * (1 + damping)
        _solve(normal, right, count)
        trial = shift.copy()
        for i in range(count):
            trial[free[i]] += right[i]
        gained = -1.0
        if np.hypot(trial[0], trial[1]) < most_px:
            trial_left = shift_residuals(pixels, moving, valid, trial, trial_slopes)
            trial_cost = np.sum(trial_left * trial_left)
            for i in range(count):
                trial_cost += prior[free[i]] * (trial[free[i]] - start[free[i]]) ** 2
            gained = cost - trial_cost
        if gained < 0:
            damping *= 10
            if damping > _MOST_DAMPING:
                break
            continue
        shift, left, cost = trial, trial_left, trial_cost
        slopes, trial_slopes = trial_slopes, slopes
        damping = max(damping / 10, 1e-6)
        if gained < _LEAST_GAIN * cost:
            break
    return shift


@compiled()
def search_costs(
    pixels: FloatArray, images: FloatArray, valid: BoolArray, ways: IntArray
) -> FloatArray:
    """Sum of squares that each way ``(y, x)`` in whole pixels leaves, shape ``(len(ways),)``.

    ``images`` are themselves, not coefficients; the rest is as ``shift_residuals`` has it.
    """
    rows, cols = valid.shape
    costs = np.zeros(len(ways))
    for i in range(len(ways)):
        for j in range(len(pixels)):
            sense = int(pixels[j, 7])
            row, col = (
                int(pixels[j, 0]) - sense * ways[i, 0],
                int(pixels[j, 1]) - sense * ways[i, 1],
            )
            left = pixels[j, 4]
            if 0 <= row < rows and 0 <= col < cols and valid[row, col]:
                level = images[0 if sense > 0 else 1, row, col]
                left = (pixels[j, 2] - level) / pixels[j, 3]
            costs[i] += left * left
    return costs


@compiled()
def joint_search_costs(
    pixels: FloatArray, images: FloatArray, changed: BoolArray, ways: IntArray
) -> FloatArray:
    """The same where each pixel has the better sense of those whose other place has changed."""
    rows, cols = changed.shape
    costs = np.zeros(len(ways))
    for i in range(len(ways)):
        for j in range(len(pixels)):
            y, x = int(pixels[j, 0]), int(pixels[j, 1])
            least = pixels[j, 4] ** 2
            for sense in (1, -1):
                row, col = y - sense * ways[i, 0], x - sense * ways[i, 1]
                if 0 <= row < rows and 0 <= col < cols and changed[row, col]:
                    held, moving = (1, 0) if sense > 0 else (0, 1)
                    left = (images[held, y, x] - images[moving, row, col]) / pixels[j, 3]
                    least = min(least, left * left)
            costs[i] += least
    return costs


@compiled_part()
def _spot(pixels: FloatArray, shape: FloatArray, slopes: FloatArray) -> None:
    """A spot of height 1 and its derivatives; columns of ``slopes``: height, y, x, and the root."""
    for i in range(len(pixels)):
        down, along = pixels[i, 0] - shape[1], pixels[i, 1] - shape[2]
        u, v = shape[3] * down + shape[4] * along, shape[5] * along
        level = exp(-(u * u + v * v) / 2) / pixels[i, 3]
        slopes[i, 0] = level
        level *= shape[0]
        slopes[i, 1] = level * u * shape[3]
        slopes[i, 2] = level * (u * shape[4] + v * shape[5])
        slopes[i, 3] = -level * u * down
        slopes[i, 4] = -level * u * along
        slopes[i, 5] = -level * v * along


@compiled()
def _fit_spot_cost(pixels: FloatArray, shape: FloatArray) -> float:
    """Sum of squares that the best elliptic Gaussian leaves of the difference.

    ``shape``: height, centre and the Cholesky root of the inverse covariance to start from,
    shape (6,).
    """
    slopes = np.empty((len(pixels), _PER_SPOT))
    normal, right = np.empty((_PER_SPOT, _PER_SPOT)), np.empty(_PER_SPOT)
    best = shape.copy()
    cost, damping = np.inf, 1e-2
    left = np.empty(len(pixels))
    trial = best.copy()
    kept = np.empty((len(pixels), _PER_SPOT))
    for _ in range(2 * _STEPS):
        _spot(pixels, trial, slopes)
        # The height is linear: the best one for this place and width.
        power = np.sum(slopes[:, 0] ** 2)
        height = np.sum(slopes[:, 0] * pixels[:, 4]) / max(power, 1e-30)
        ratio = height / trial[0] if trial[0] != 0 else 0.0
        trial_left = pixels[:, 4] - height * slopes[:, 0]
        trial_cost = np.sum(trial_left**2)
        if trial_cost < cost:
            gained = cost - trial_cost
            best, cost, left = trial.copy(), trial_cost, trial_left
            best[0] = height
            kept[:] = slopes
            kept[:, 1:] *= ratio
            damping = max(damping / 10, 1e-6)
            if gained < _LEAST_GAIN * cost:
                break
        else:
            damping *= 10
            if damping > _MOST_DAMPING:
                break
        for i in range(_PER_SPOT):
            right[i] = np.sum(kept[:, i] * left)
            for j in range(i + 1):
                normal[i, j] = np.sum(kept[:, i] * kept[:, j])
            normal[i, i] = normal[i, i] * (1 + damping) + 1e-12
        _solve(normal, right, _PER_SPOT)
        trial = best + right
    return cost


_RING = 2.0
"""Width over the smoothing, plus a pixel, of the ring: at rest, unless what is there moved too."""

LEAST_SHARES = {0: 0.6, 2: 0.85, 6: 0.85}
"""Of what stands out beyond the noise, which a shift of so many parameters has to explain; 0: that
of a neighbour, beside which strips are covered and uncovered."""

LEAST_GAINS = {0: -6.0, 2: 6.0, 6: 10.0}
"""Chi-squared by which it has to be better than a spot."""

_FOLLOWS_PX = 0.5
"""How far a shift may be from a neighbour's."""

_AFFINE_VALUES = 2.0
"""Independent values that a change must have for its shift to vary over it."""

_CHANGED_SD, _LEAST_LEFT = 2.5, 0.5
"""What moved has changed its other place, by so much, on this share of its pixels at least."""

_NEARLY_ALL, _LEAST_RIGID, _MOST_LEFT = 0.95, 0.4, 0.75
"""Shares beyond which nothing better is looked for, and below which nothing can be found: a rigid
shift's, and what a whole way leaves."""

_SHIFT_ERR_PX = 0.1
"""Error of a shift that covers and uncovers its surroundings, beside that of the noise."""

_UNSEEN_PX = 1000.0
"""Error of a shift along an edge, where nothing tells it."""

_MOST_SLOPE = 0.15
"""Change of the shift from one pixel to the next beyond which it is no local shift."""

_MOST_PIXELS = 1500
_MOST_SEARCHED = 150
_APART_PX = 2
_MARGIN_PX = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Images:
    """Before and after on one grid with the standard deviation of their difference.

    All of shape ``(rows, cols)`` and smoothed by ``smoothing_px``.
    """

    before_dn: FloatImage = field(repr=False)
    after_dn: FloatImage = field(repr=False)
    sd_dn: FloatImage = field(repr=False)
    valid: BoolArray = field(repr=False)
    smoothing_px: float

    @property
    def values_by_pixel(self) -> float:
        """Independent values to a pixel."""
        return 1 / (2 * pi * self.smoothing_px**2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shift:
    """A shift that explains a change.

    ``displacement_px``: ``(y, x)``, from before to after, at the change's centre. ``information``:
    inverse of its covariance, shape (2, 2). ``share``: of what stood out beyond the noise,
    explained. ``gain``: chi-squared by which it is better than a spot.
    """

    displacement_px: FloatArray
    information: FloatArray
    share: float
    gain: float


def ways_within(radius_px: float) -> IntArray:
    """Whole displacements ``(y, x)`` of at most this length, the shortest first."""
    most = int(radius_px)
    ways = np.array([
        (y, x)
        for y in range(-most, most + 1)
        for x in range(-most, most + 1)
        if y * y + x * x <= radius_px**2
    ], dtype=np.int64)  # fmt: skip
    return ways[np.argsort((ways**2).sum(axis=1), kind="stable")]


class Trial:
    """A change with the pixels on which its explanations are compared.

    ``rows, cols``: the change's pixels. ``reach_px``: the longest displacement that will be tried.
    """

    def __init__(self, images: Images, rows: IntArray, cols: IntArray, reach_px: float) -> None:
        smoothing = images.smoothing_px
        self._smoothing_px, self._norm = smoothing, images.values_by_pixel
        ring = round(_RING * smoothing) + 1
        margin = ring + ceil(reach_px) + _MARGIN_PX
        top, left = max(int(rows.min()) - margin, 0), max(int(cols.min()) - margin, 0)
        crop = np.s_[top : int(rows.max()) + margin + 1, left : int(cols.max()) + margin + 1]
        self._images = np.stack([images.before_dn[crop], images.after_dn[crop]]).astype(np.float64)
        self._valid = np.ascontiguousarray(images.valid[crop])
        self._sd = np.where(self._valid, images.sd_dn[crop], 1.0).astype(np.float64)
        self._reach_px = reach_px
        own = np.zeros(self._valid.shape, dtype=np.uint8)
        self._given = rows - top, cols - left
        own[self._given] = 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * ring + 1, 2 * ring + 1))
        around = (cv2.dilate(own, disc) > own) & self._valid
        inner, outer = np.nonzero(own), np.nonzero(around)
        # A large change has more pixels than its shift needs.
        self._stride = max(1, (len(inner[0]) + len(outer[0])) // _MOST_PIXELS)
        self._own = len(inner[0][:: self._stride])
        self._y, self._x = (
            np.concatenate([a[:: self._stride], b[:: self._stride]])
            for a, b in zip(inner, outer, strict=True)
        )
        self._norm *= self._stride
        self._radius_px = max(float(np.ptp(rows)), float(np.ptp(cols)), 2.0) / 2
        self._significance = (self._images[1] - self._images[0]) / self._sd
        self._z = self._significance[self._y, self._x]
        self._made_pixels: dict[float, FloatArray] = {}
        self._found_starts: dict[float, list[FloatArray]] = {}

    @cached_property
    def _static(self) -> FloatArray:
        return np.asarray(self._z**2)

    @cached_property
    def _spot_cost(self) -> float:
        """Chi-squared that the best elliptic Gaussian leaves."""
        return self.spot_cost_on(self._pixels(1.0))

    def spot_cost_on(self, pixels: FloatArray) -> float:
        """The same on some of the pixels; a spot leaves nothing where none of them stands out."""
        stands_out = np.abs(pixels[:, 4])
        if not stands_out.any():
            return 0.0
        # The ring stands out by its noise alone, which is not to widen the start.
        weight = np.where(stands_out > 0.3 * stands_out.max(), stands_out, 0.0)
        weight /= weight.sum()
        centre_y, centre_x = float(weight @ pixels[:, 0]), float(weight @ pixels[:, 1])
        y, x = pixels[:, 0] - centre_y, pixels[:, 1] - centre_x
        pixel = 0.3  # of the variance: a pixel is not a point
        yy, xx, yx = weight @ (y * y) + pixel, weight @ (x * x) + pixel, weight @ (y * x)
        root = np.linalg.cholesky(np.linalg.inv(np.array([[yy, yx], [yx, xx]])))
        start = np.array([1.0, centre_y, centre_x, root[0, 0], root[1, 0], root[1, 1]])
        return self._norm * float(_fit_spot_cost(pixels, start))

    def shift(self, ways: IntArray, starts: int) -> Shift | None:
        """Find the shift that explains the change best, from the best of whole ways.

        What is seen now may have come from elsewhere, and what was seen may have gone.
        """
        best: Fit | None = None
        for is_whole in (True, False):
            for sense in (1.0, -1.0):
                for start in self._starts(ways, starts, sense):
                    best = _better(best, self._from(start, sense, is_whole))
            if best is not None and best.share > _NEARLY_ALL:
                break
        return None if best is None else self.explained(best)

    def following(self, start: FloatArray) -> Shift | None:
        """The shift of a neighbour, held there, with less asked of it."""
        best: Fit | None = None
        for sense in (1.0, -1.0):
            for is_whole in (True, False):
                fit = self._fitted(np.append(start, np.zeros(4)), sense, is_whole, 0)
                best = _better(best, self._judged(fit))
        return None if best is None else self.explained(best)

    def _starts(self, ways: IntArray, count: int, sense: float) -> list[FloatArray]:
        """The best whole ways; none where none explains a part of the change."""
        if sense not in self._found_starts:
            stride = 1 + self._own // _MOST_SEARCHED
            pixels = self._pixels(sense)[: self._own : stride]
            costs = search_costs(pixels, self._images, self._valid, ways)
            at_rest = float(self._static[: self._own : stride].sum())
            likely = costs < _MOST_LEFT * at_rest
            self._found_starts[sense] = lowest(costs[likely], ways[likely], count)
        return self._found_starts[sense]

    def _from(self, start: FloatArray, sense: float, is_whole: bool) -> "Fit | None":
        """The better of a rigid shift near a start and of one that varies."""
        rigid = self._fitted(np.append(start, np.zeros(4)), sense, is_whole, 2)
        best = self._judged(rigid)
        is_small = self._own * self._norm < _AFFINE_VALUES
        if is_small or rigid.share > _NEARLY_ALL or rigid.share < _LEAST_RIGID:
            return best
        return _better(best, self._judged(self._fitted(rigid.shift, sense, is_whole, 6)))

    def _fitted(self, start: FloatArray, sense: float, is_whole: bool, count: int) -> "Fit":
        """Fit a shift to the change and its ring, or to the change alone with a ring at rest."""
        pixels = self._pixels(sense)
        fitted = pixels if is_whole else pixels[: self._own]
        prior = np.full(7, inf)
        prior[:2] = 1e-6 if count else 1 / (self._norm * _FOLLOWS_PX**2)
        prior[2 : max(count, 2)] = 1.0
        prior[6] = self._reach_px + 1
        found = fit_shift(fitted, self._splines, self._valid, start, prior)
        slopes = np.empty((len(pixels), 6))
        square = shift_residuals(pixels, self._splines, self._valid, found, slopes) ** 2
        if not is_whole:
            square[self._own :] = np.minimum(square[self._own :], self._static[self._own :])
        cost = self._norm * float(square.sum())
        expected = self._norm * len(square)
        stood_out = max(self._norm * float(self._static.sum()) - expected, 1e-9)
        return Fit(
            shift=found,
            sense=sense,
            is_whole=is_whole,
            count=count,
            share=1 - max(cost - expected, 0.0) / stood_out,
            cost=cost,
            own_cost=self._norm * float(square[: self._own].sum()),
            slopes=slopes[: len(fitted), :2],
            excess=max(1.0, cost / expected),
        )

    def _judged(self, fit: "Fit") -> "Fit | None":
        """The fit with its gain, if it explains the change."""
        if fit.share < LEAST_SHARES[fit.count]:
            return None
        if np.abs(fit.shift[2:]).max() > _MOST_SLOPE * self._radius_px:
            return None
        gain = self._spot_cost - fit.cost
        if not fit.is_whole and fit.count:
            pixels = self._pixels(fit.sense)[: self._own]
            if self._changed_elsewhere(pixels, fit.shift).mean() < _LEAST_LEFT:
                return None
            # An even surface is seen anywhere else: that it is here says nothing of a shift.
            gain = min(gain, self._norm * _even_cost(pixels) - fit.own_cost)
        gain -= LEAST_GAINS[fit.count]
        return replace(fit, gain=gain) if gain > 0 else None

    def explained(self, fit: "Fit") -> Shift:
        """Return a fit with its errors."""
        return Shift(
            displacement_px=fit.shift[:2],
            information=self._information(fit),
            share=fit.share,
            gain=fit.gain,
        )

    def _changed_elsewhere(self, pixels: FloatArray, shift: FloatArray) -> BoolArray:
        """Pixels whose other place, where they came from or went, has changed too."""
        u, v, sense = pixels[:, 5], pixels[:, 6], pixels[:, 7]
        rows = np.rint(pixels[:, 0] - sense * (shift[0] + shift[2] * u + shift[3] * v))
        cols = np.rint(pixels[:, 1] - sense * (shift[1] + shift[4] * u + shift[5] * v))
        last_row, last_col = (size - 1 for size in self._valid.shape)
        rows = np.clip(rows, 0, last_row).astype(np.int64)
        cols = np.clip(cols, 0, last_col).astype(np.int64)
        return np.asarray(self._changed[rows, cols])

    @cached_property
    def _changed(self) -> BoolArray:
        return np.asarray((np.abs(self._significance) > _CHANGED_SD) & self._valid)

    def _information(self, fit: "Fit") -> FloatArray:
        """Inverse covariance of a least-squares shift in errors whose neighbours agree."""
        slopes, count = fit.slopes, len(fit.slopes)
        normal = slopes.T @ slopes + 1e-6 * np.eye(2)
        scattered = np.empty_like(slopes)
        for axis in range(2):
            grid = np.zeros(self._valid.shape)
            grid[self._y[:count], self._x[:count]] = slopes[:, axis]
            blurred = cv2.GaussianBlur(grid, (0, 0), 2**0.5 * self._smoothing_px)
            scattered[:, axis] = blurred[self._y[:count], self._x[:count]]
        # What strides leave out is as many times as much.
        correlated = 4 * pi * self._smoothing_px**2 * slopes.T @ scattered * self._stride
        return shift_information(normal, correlated * (fit.excess / self._stride))

    @cached_property
    def _splines(self) -> FloatArray:
        return np.stack([spline_filter(image, 3, mode="mirror") for image in self._images])

    def _pixels(self, sense: float) -> FloatArray:
        """Rows as ``shift_residuals`` wants them, all of one sense."""
        if sense not in self._made_pixels:
            y, x = self._y, self._x
            u = (y - y[: self._own].mean()) / self._radius_px
            v = (x - x[: self._own].mean()) / self._radius_px
            held = self._images[1 if sense > 0 else 0, y, x]
            columns = [y, x, held, self._sd[y, x], self._z, u, v, np.full(len(y), sense)]
            self._made_pixels[sense] = np.stack(columns, axis=1)
        return self._made_pixels[sense]


def shift_information(normal: FloatArray, correlated: FloatArray) -> FloatArray:
    """Inverse covariance of a shift by least squares.

    ``normal``: normal matrix S' S of the slopes S, shape (2, 2), positive definite. ``correlated``:
    S' C S with the covariance C of the errors; between pixels that strides leave apart it may come
    out singular, or below nothing.
    """
    values, axes = np.linalg.eigh((correlated + correlated.T) / 2)
    inverse = np.linalg.inv(normal)
    covariance = inverse @ ((axes * np.maximum(values, 1e-6)) @ axes.T) @ inverse
    # Covered strips pull at a shift: it is known no better than this.
    covariance += _SHIFT_ERR_PX**2 * np.eye(2)
    # Beside a variance without bounds, that across the edge would be lost in rounding.
    variances, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    known = np.clip(variances, _SHIFT_ERR_PX**2, _UNSEEN_PX**2)
    return np.asarray((axes / known) @ axes.T, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """A fitted shift with what it leaves."""

    shift: FloatArray
    sense: float
    is_whole: bool
    count: int
    share: float
    cost: float
    own_cost: float
    slopes: FloatArray
    excess: float
    gain: float = 0.0


def _better(first: Fit | None, second: Fit | None) -> Fit | None:
    if first is None or second is None:
        return first or second
    return first if first.gain >= second.gain else second


def _even_cost(pixels: FloatArray) -> float:
    """Sum of squares that a plane leaves of the levels of the image that is held."""
    weight = 1 / pixels[:, 3]
    plane = np.stack([weight, weight * pixels[:, 5], weight * pixels[:, 6]], axis=1)
    level = pixels[:, 2] * weight
    normal = plane.T @ plane
    normal[np.diag_indices(3)] += 1e-9 * normal[0, 0]
    left = level - plane @ np.linalg.solve(normal, plane.T @ level)
    return float(left @ left)


def lowest(costs: FloatArray, ways: IntArray, count: int) -> list[FloatArray]:
    """The best ways that are not beside a better one."""
    chosen: list[IntArray] = []
    for index in np.argsort(costs, kind="stable"):
        if all(np.abs(ways[index] - other).max() > _APART_PX for other in chosen):
            chosen.append(ways[index])
            if len(chosen) == count:
                break
    return [way.astype(np.float64) for way in chosen]
