"""The height of best focus from a sweep: a peak fitted to focus values, with its uncertainty."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import f as f_distribution

from acquisition.choices import FEWEST_POSITIONS

Floats = NDArray[np.float64]
Side = Literal["lower", "higher"]

_SHAPES: dict[str, Callable[[Floats], Floats]] = {
    "root Lorentzian": lambda u: (1.0 + u**2) ** -0.5,
    "Lorentzian": lambda u: 1.0 / (1.0 + u**2),
    "Gaussian": lambda u: np.exp(-0.5 * u**2),
}
"""Peak shapes. A blur whose variance grows with the square of the defocus makes the squared
gradient of an edge a root Lorentzian; textures fall faster."""

_LINEAR = 3
_PARAMETERS = 5
_P_NO_PEAK = 0.01
_WORST_ERR = 0.15  # of the travel
_SLOPE_SIGMAS = 3.0
_LEAST_HEIGHT = 0.25  # of the travel; below it a height is not a distance


class NoFocusPeakError(ValueError):
    """A sweep contains no peak; ``side`` says where to look for it, if that is known."""

    def __init__(self, message: str, *, side: Side | None = None) -> None:
        super().__init__(message)
        self.side = side


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusPeak:
    """Where a sweep was sharpest; ``err_mm`` is a standard error.

    The error includes the scatter about the curve and the disagreement between curve shapes that
    fit about equally well. ``shape`` is the best one; ``width_mm`` and ``curve`` are its own.
    """

    height_mm: float
    err_mm: float
    shape: str
    width_mm: float
    base: float
    slope_per_mm: float
    amplitude: float
    shape_height_mm: float
    is_inverse: bool

    def curve(self, heights_mm: Floats) -> Floats:
        """The fitted focus value at given heights."""
        offset = _defocus(heights_mm, self.shape_height_mm, self.is_inverse)
        shape = _SHAPES[self.shape](offset / self.width_mm)
        return self.base + self.slope_per_mm * offset + self.amplitude * shape

    @property
    def value(self) -> float:
        """The focus value at the peak."""
        return self.base + self.amplitude


@dataclass(frozen=True, slots=True)
class _Fit:
    shape: str
    is_inverse: bool
    centre: float
    width: float
    linear: Floats
    err: float
    rss: float


def fit_focus_peak(
    heights_mm: Floats, values: Floats, value_errs: Floats | None = None
) -> FocusPeak:
    """Fit a peak on a sloping base to focus values by height.

    Three shapes of peak, symmetric in height or in 1/height, are fitted and averaged by how well
    they fit (Akaike weights), so that the uncertainty of the shape is part of the error. A thin
    lens blurs in proportion to 1/distance - 1/focus, and heights are nearly distances. The slope
    of the base stands for what a change of height does besides defocus: the scale, and so the
    texture, changes.

    Parameters
    ----------
    heights_mm
        At least seven, in any order.
    values
        Focus value at each.
    value_errs
        Their standard errors, as weights; equal weights if None. The size of the errors is
        always taken from the scatter about the curve.

    Raises
    ------
    NoFocusPeakError
        If the values have no peak inside the range; the error says on which side to look.
    ValueError
        If there are too few positions, or values that are not finite.

    References
    ----------
    Burnham, Anderson: Model Selection and Multimodel Inference, 2nd ed. 2002, section 4.3:
    weights and unconditional variance of an average over models.
    """
    order = np.argsort(heights_mm)
    x, y = np.asarray(heights_mm, float)[order], np.asarray(values, float)[order]
    if x.size < FEWEST_POSITIONS:
        raise ValueError(f"a focus sweep needs at least {FEWEST_POSITIONS} positions, got {x.size}")
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(y))) or x[0] == x[-1]:
        raise ValueError("heights and focus values must be finite, and the heights must differ")
    unit = float(np.ptp(y)) or 1.0  # solvers use absolute tolerances
    y = y / unit
    root_weight = np.ones_like(y)
    if value_errs is not None:
        err = np.asarray(value_errs, float)[order]
        err = np.maximum(err, 0.3 * float(np.median(err)) + 1e-300)
        root_weight = float(np.median(err)) / err
    line_rss, slope, slope_err = _line(x, y, root_weight)
    scales = (False, True) if x[0] > _LEAST_HEIGHT * float(np.ptp(x)) else (False,)
    fits = [
        _fit_shape(name, x, y, root_weight, is_inverse) for name in _SHAPES for is_inverse in scales
    ]
    found = [fit for fit in fits if fit is not None]
    best = min(found, key=lambda fit: fit.rss, default=None)
    _require_peak(x, best, line_rss, slope, slope_err)
    assert best is not None
    freedom = x.size - _PARAMETERS
    noise = max(best.rss / freedom, 1e-30)
    akaike = np.array([np.exp(-0.5 * (fit.rss - best.rss) / noise) for fit in found])
    akaike /= akaike.sum()
    centres = np.array([fit.centre for fit in found])
    centre = float(akaike @ centres)
    errs = np.array([fit.err for fit in found])
    err_mm = float(akaike @ np.sqrt(errs**2 + (centres - centre) ** 2))
    _require_inside(x, centre, err_mm)
    return FocusPeak(
        height_mm=centre,
        err_mm=err_mm,
        shape=best.shape,
        width_mm=best.width,
        base=unit * float(best.linear[0]),
        slope_per_mm=unit * float(best.linear[1]),
        amplitude=unit * float(best.linear[2]),
        shape_height_mm=best.centre,
        is_inverse=best.is_inverse,
    )


def _line(x: Floats, y: Floats, root_weight: Floats) -> tuple[float, float, float]:
    design = np.stack([np.ones_like(x), x - x.mean()], axis=1) * root_weight[:, None]
    values, *_ = np.linalg.lstsq(design, y * root_weight, rcond=None)
    left = y * root_weight - design @ values
    rss = float(left @ left)
    covariance = np.linalg.inv(design.T @ design) * rss / (x.size - 2)
    return rss, float(values[1]), float(np.sqrt(covariance[1, 1]))


def _defocus(x: Floats, centre: float, is_inverse: bool) -> Floats:
    """Distance from the centre; the inverse one has the same slope there."""
    return (x - centre) * (centre / x if is_inverse else 1.0)


def _fit_shape(
    name: str, x: Floats, y: Floats, root_weight: Floats, is_inverse: bool
) -> _Fit | None:
    """Best centre and width; base, slope and amplitude follow from them linearly."""
    shape, travel = _SHAPES[name], float(np.ptp(x))

    def linear(centre: float, width: float) -> tuple[Floats, Floats]:
        offset = _defocus(x, centre, is_inverse)
        design = np.stack([np.ones_like(x), offset, shape(offset / width)], axis=1)
        design *= root_weight[:, None]
        values, *_ = np.linalg.lstsq(design, y * root_weight, rcond=None)
        return np.asarray(values), design @ values - y * root_weight

    least, most = 0.5 * float(np.median(np.diff(x))) + 1e-9, travel
    start = _best_of_grid(x, y, root_weight, shape, is_inverse, np.geomspace(least, most, 8)[:-1])
    if start is None:
        return None
    centre, width = start

    def residuals(parameters: Floats) -> Floats:
        return linear(float(parameters[0]), float(np.exp(parameters[1])))[1]

    solved = least_squares(
        residuals,
        [centre, np.log(width)],
        bounds=([x[0] - travel, np.log(0.5 * least)], [x[-1] + travel, np.log(2 * most)]),
        x_scale=[travel, 1.0],
    )
    centre, width = float(solved.x[0]), float(np.exp(solved.x[1]))
    values, left = linear(centre, width)
    if values[2] <= 0:
        return None
    rss = float(left @ left)
    # The Jacobian of the reduced problem carries the linear parameters' share of the error.
    jacobian = np.asarray(solved.jac, dtype=np.float64)
    information = jacobian.T @ jacobian
    if np.linalg.cond(information) > 1e14:
        return None
    covariance = np.linalg.inv(information) * rss / (x.size - _PARAMETERS)
    return _Fit(name, is_inverse, centre, width, values, float(np.sqrt(covariance[0, 0])), rss)


def _best_of_grid(
    x: Floats,
    y: Floats,
    root_weight: Floats,
    shape: Callable[[Floats], Floats],
    is_inverse: bool,
    widths: Floats,
) -> tuple[float, float] | None:
    """Centre and width of the best upright peak on a grid; all linear fits in one go."""
    centre, width = (
        axis.reshape(-1, 1)
        for axis in np.meshgrid(np.linspace(x[0], x[-1], 2 * x.size + 1), widths)
    )
    offset = (x - centre) * (centre / x if is_inverse else 1.0)
    scale = float(np.ptp(x))
    design = np.stack([np.ones_like(offset), offset / scale, shape(offset / width)], axis=2)
    design *= root_weight[:, None]
    normal = np.einsum("gki,gkj->gij", design, design) + 1e-12 * np.eye(_LINEAR)
    values = np.linalg.solve(normal, np.einsum("gki,k->gi", design, y * root_weight)[..., None])
    left = (design @ values)[..., 0] - y * root_weight
    rss = np.where(values[:, 2, 0] > 0, np.sum(left**2, axis=1), np.inf)
    best = int(np.argmin(rss))
    return (float(centre[best, 0]), float(width[best, 0])) if np.isfinite(rss[best]) else None


def _require_peak(
    x: Floats, best: _Fit | None, line_rss: float, slope: float, slope_err: float
) -> None:
    """Raise if a peak explains the values no better than a line does."""
    freedom = x.size - _PARAMETERS
    if best is not None:
        gained = (line_rss - best.rss) / _LINEAR / max(best.rss / freedom, 1e-300)
        if f_distribution.sf(gained, _LINEAR, freedom) < _P_NO_PEAK:
            return
    if abs(slope) > _SLOPE_SIGMAS * slope_err:
        _refuse_end(x, "higher" if slope > 0 else "lower")
    raise NoFocusPeakError(
        f"the focus value has no peak from {x[0]:g} to {x[-1]:g} mm: it changes no more than its "
        "noise; use a target with detail, sweep further, or average more frames"
    )


def _require_inside(x: Floats, centre: float, err_mm: float) -> None:
    if centre <= x[1]:
        _refuse_end(x, "lower")
    if centre >= x[-2]:
        _refuse_end(x, "higher")
    travel = float(np.ptp(x))
    if not err_mm <= _WORST_ERR * travel:
        raise NoFocusPeakError(
            f"the peak at about {centre:.2f} mm is known only to {err_mm:.2f} mm; average more "
            "frames, or sweep more positions"
        )


def _refuse_end(x: Floats, side: Side) -> None:
    end = x[-1] if side == "higher" else x[0]
    raise NoFocusPeakError(
        f"the focus value still rises towards {end:g} mm, the {side} end of the sweep: "
        f"sweep {side}",
        side=side,
    )
