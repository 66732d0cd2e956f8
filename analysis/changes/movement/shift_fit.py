"""The two explanations of a change on its own pixels: a shift of what was there, an added spot.

Both are fitted by Levenberg and Marquardt's steps to residuals in standard deviations. Positions
are ``(y, x)`` in a window; displacements are of what is seen, from before to after.
"""

from math import exp

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
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
    pixels: FloatArray,
    moving: FloatArray,
    valid: BoolArray,
    shift: FloatArray,
    slopes: FloatArray,
) -> FloatArray:
    """What a shift leaves, in standard deviations, shape ``(n,)``.

    Parameters
    ----------
    pixels
        Shape ``(n, 8)``: row, column, level of the image that is held, standard deviation, what no
        shift leaves, the two affine coordinates, and the sense: 1 if what is seen there after came
        from elsewhere, -1 if what was seen there before went elsewhere.
    moving
        Cubic B-spline coefficients of the image before and of the one after, shape
        ``(2, rows, cols)``.
    valid
        Where they count; a pixel from elsewhere has what no shift leaves.
    shift
        Displacement (y, x) and its slopes along the affine coordinates, shape (6,).
    slopes
        Receives the derivatives by ``shift``, shape ``(n, 6)``.
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
    pixels: FloatArray,
    moving: FloatArray,
    valid: BoolArray,
    start: FloatArray,
    prior: FloatArray,
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
def fit_spot_cost(pixels: FloatArray, shape: FloatArray) -> float:
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
