"""The height of best focus from a sweep: a peak fitted to focus values, with its uncertainty."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import f as f_distribution, norm, t as student

from acquisition.bench import BenchConfig, BenchDevices
from acquisition.choices import FEWEST_POSITIONS
from acquisition.focus._live import FocusOptions, FocusPoint, sweep_focus
from acquisition.focus._measures import Region
from acquisition.stages import move_timeout_s

Floats = NDArray[np.float64]
_Side = Literal["lower", "higher"]

_LINEAR = 2
_P_NO_PEAK = 0.01
_PEAK_FREEDOM = 3
_WORST_ERR = 0.15  # of the travel
_SLOPE_SIGMAS = 3.0
_LEAST_HEIGHT = 0.25  # of the travel; below it a height is not a distance
_PUPIL_SIGMAS = 5.0  # as far as the fit may take the pupil from where it is expected
_ROUNDS = 3
_START_TAIL = 2.0
_TAIL_MEAN, _TAIL_SD = 1.5, 1.0
_BASE_SD = 0.3
_WIDTH_SD = 2.0  # of its logarithm
_CENTRE, _LOG_WIDTH, _TAIL, _PUPIL, _BASE = range(5)

_SCALE_SD = 1.0
"""How much a texture's focus value may change with its scale alone: d ln F / d ln distance. Of nine
prints of photographs on the simulated bench it is 0.5 in the rms, of a board of squares 1."""


class NoFocusPeakError(ValueError):
    """A sweep contains no peak; ``side`` says where to look for it, if that is known."""

    def __init__(self, message: str, *, side: _Side | None = None) -> None:
        super().__init__(message)
        self.side = side


@dataclass(frozen=True, slots=True, kw_only=True)
class PupilOffset:
    """Distance of the entrance pupil from the target at height 0, with its standard error."""

    offset_mm: float
    err_mm: float


UNKNOWN_PUPIL = PupilOffset(offset_mm=0.0, err_mm=30.0)
"""Where nothing is known of it: the entrance pupil is in the lens, about from where one measures
heights."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusPeak:
    """The height at which a sweep was sharpest, and the curve fitted to its focus values.

    Parameters
    ----------
    height_mm, err_mm
        Height of the peak, and its standard error. The error includes the scatter about the curve,
        at its degrees of freedom, and the two parts below.
    pupil_err_mm
        The part of the error that would vanish if the position of the entrance pupil were known.
    scale_err_mm
        The part of the error from a texture whose detail changes with its scale.
    width_mm
        Width of the peak: near its top it has the shape ``1 - defocus^2 / (2 width_mm^2)``.
    tail
        Shape of the peak: 0 for a Gaussian, 1 for a Lorentzian, 2 for a root Lorentzian.
    base, amplitude
        Focus value far from the focus, and what the peak adds to it.
    pupil_offset_mm
        Distance of the entrance pupil from the target at height 0.
    """

    height_mm: float
    err_mm: float
    pupil_err_mm: float
    scale_err_mm: float
    width_mm: float
    tail: float
    base: float
    amplitude: float
    pupil_offset_mm: float

    @property
    def shape(self) -> str:
        """Name of the shape nearest to ``tail``: Gaussian, Lorentzian or root Lorentzian."""
        return ("Gaussian", "Lorentzian", "root Lorentzian")[min(round(self.tail), 2)]

    def curve(self, heights_mm: Floats) -> Floats:
        """The fitted focus value at given heights."""
        defocus = _defocus(np.asarray(heights_mm), self.height_mm, self.pupil_offset_mm)
        return self.base + self.amplitude * _shape(defocus / self.width_mm, self.tail)

    @property
    def value(self) -> float:
        """The focus value at the peak."""
        return self.base + self.amplitude


def fit_focus_peak(
    heights_mm: Floats,
    values: Floats,
    value_errs: Floats | None = None,
    *,
    pupil: PupilOffset = UNKNOWN_PUPIL,
    texture_share: float = 0.0,
) -> FocusPeak:
    """Fit a peak to focus values by height, at least seven, in any order.

    A thin lens blurs in proportion to 1/distance - 1/focus, distances taken from the entrance
    pupil, so that the peak is symmetric in 1/(height + offset). A blur whose variance grows with
    the square of that makes the squared gradient of an edge a root Lorentzian; textures fall
    faster. Centre, width, tail, base and offset are fitted together, the last three with what is
    expected of them, so that whatever the values do not tell of them is part of the error.

    What moving the camera does to a texture besides defocus, its scale, looks like a shift of the
    peak. No sweep tells the two apart: the shift is not fitted, but part of the error, by
    ``texture_share``, the share of the focus value that is not of an edge across the region, 0 to
    1.

    ``value_errs`` are the values' standard errors, as weights; equal weights if None. The size of
    the errors is always taken from the scatter about the curve. If the values have no peak inside
    the range, a `NoFocusPeakError` says on which side to look.

    References
    ----------
    Hecht: Optics, 5th ed. 2017, section 5.2: the blur of a thin lens. Tarantola: Inverse Problem
    Theory, 2005, section 3.2: least squares with what is known before. Schmidt: "Application of
    state-space methods to navigation problems", Advances in Control Systems 3, 1966: parameters
    that are not estimated but whose uncertainty counts.
    """
    order = np.argsort(heights_mm)
    x, y = np.asarray(heights_mm, float)[order], np.asarray(values, float)[order]
    if x.size < FEWEST_POSITIONS:
        raise ValueError(f"a focus sweep needs at least {FEWEST_POSITIONS} positions, got {x.size}")
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(y))) or x[0] == x[-1]:
        raise ValueError("heights and focus values must be finite, and the heights must differ")
    unit = float(np.ptp(y)) or 1.0  # solvers use absolute tolerances
    root_weight = np.ones_like(y)
    if value_errs is not None:
        err = np.asarray(value_errs, float)[order]
        err = np.maximum(err, 0.3 * float(np.median(err)) + 1e-300)
        root_weight = float(np.median(err)) / err
    model = _Model(x, y / unit, root_weight, _expected(pupil, x))
    fit = model.fitted()
    _require_peak(model, fit)
    assert fit is not None
    peak = model.peak(fit, _SCALE_SD * texture_share)
    _require_inside(x, peak)
    return replace(peak, base=unit * peak.base, amplitude=unit * peak.amplitude)


def _expected(pupil: PupilOffset, x: Floats) -> PupilOffset:
    """The pupil that is expected: above the target at every height."""
    travel = float(np.ptp(x))
    if pupil is UNKNOWN_PUPIL and x[0] <= _LEAST_HEIGHT * travel:
        # Heights from such a zero are no distances.
        return PupilOffset(offset_mm=2.0 * travel - float(x[0]), err_mm=travel)
    if not x[0] + pupil.offset_mm > 0:
        raise ValueError(
            f"at {x[0]:g} mm the entrance pupil must be above the target, "
            f"got an offset of {pupil.offset_mm:g} mm"
        )
    return PupilOffset(offset_mm=pupil.offset_mm, err_mm=max(pupil.err_mm, 1e-3))


def _defocus(x: Floats, centre: float, pupil_mm: float) -> Floats:
    """Blur in mm of height: the distance from the centre, there."""
    return (x - centre) * (centre + pupil_mm) / (x + pupil_mm)


def _shape(u: Floats, tail: float) -> Floats:
    """1 less u^2 / 2 near the peak; ``tail`` says how slowly it falls farther out."""
    tail = max(tail, 1e-4)
    return np.exp(-np.log1p(0.5 * tail * u**2) / tail)


@dataclass(frozen=True, slots=True)
class _Fit:
    """Parameters and Jacobian of the weighted values; the amplitude follows linearly."""

    parameters: Floats
    jacobian: Floats
    rss: float
    noise: float
    freedom: float


@dataclass(frozen=True, slots=True)
class _Model:
    x: Floats
    y: Floats
    root_weight: Floats
    pupil: PupilOffset

    @property
    def travel(self) -> float:
        return float(np.ptp(self.x))

    @property
    def expected(self) -> tuple[Floats, Floats]:
        """Means and standard deviations that are known of the parameters before the sweep."""
        means = [0.0, np.log(self.travel), _TAIL_MEAN, self.pupil.offset_mm, 0.0]
        return np.array(means), np.array([np.inf, _WIDTH_SD, _TAIL_SD, self.pupil.err_mm, _BASE_SD])

    def curve(self, parameters: Floats) -> tuple[Floats, float]:
        """The weighted values of the curve, and its amplitude."""
        centre, log_width, tail, pupil_mm, base = (float(value) for value in parameters)
        u = _defocus(self.x, centre, pupil_mm) / np.exp(log_width)
        curve = (base + _shape(u, tail)) * self.root_weight
        amplitude = float(curve @ (self.y * self.root_weight) / (curve @ curve))
        return amplitude * curve, amplitude

    def fitted(self) -> _Fit | None:
        """The most likely curve; None if no upright peak fits better than none at all."""
        start = self._start()
        if start is None:
            return None
        parameters, noise = start
        low, high = self._bounds()
        parameters = np.clip(parameters, low + 1e-9, high - 1e-9)
        means, sds = self.expected
        fit = None
        for _ in range(_ROUNDS):

            def residuals(values: Floats, noise: float = noise) -> Floats:
                left = self.curve(values)[0] - self.y * self.root_weight
                return np.append(left, noise * ((values - means) / sds)[1:])

            solved = least_squares(
                residuals,
                parameters,
                bounds=(low, high),
                jac="3-point",
                x_scale=[self.travel, 1.0, 1.0, self.pupil.err_mm, 1.0],
                max_nfev=100,
            )
            parameters = np.asarray(solved.x)
            jacobian = np.asarray(solved.jac, dtype=np.float64)[: self.x.size]
            rss = float(np.sum(solved.fun[: self.x.size] ** 2))
            # What is known beforehand takes away fewer degrees of freedom than what is fitted.
            information = jacobian.T @ jacobian
            known = np.diag((noise / sds) ** 2)
            taken = 1.0 + float(np.trace(np.linalg.solve(information + known, information)))
            freedom = max(self.x.size - taken, 1.0)
            noise = max(float(np.sqrt(rss / freedom)), 1e-12)
            fit = _Fit(parameters, jacobian, rss, noise, freedom)
        return fit if self.curve(parameters)[1] > 0 else None

    def peak(self, fit: _Fit, scale_sd: float) -> FocusPeak:
        """The peak of a fit, with its error; in the unit of the values."""
        sds = self.expected[1]
        information = fit.jacobian.T @ fit.jacobian / fit.noise**2
        covariance = np.linalg.inv(information + np.diag(sds**-2.0))
        shared = covariance[_CENTRE] ** 2 / sds**2
        scatter = float((covariance @ information @ covariance)[_CENTRE, _CENTRE])
        heavier = student.ppf(0.975, fit.freedom) / norm.ppf(0.975)
        centre, log_width, tail, pupil_mm, base = (float(value) for value in fit.parameters)
        # How the centre moves if the values grow in proportion to the distance.
        curve, amplitude = self.curve(fit.parameters)
        growth = curve * np.log((self.x + pupil_mm) / (centre + pupil_mm))
        growth -= curve * (curve @ growth) / (curve @ curve)
        per_growth = (covariance @ fit.jacobian.T @ growth)[_CENTRE] / fit.noise**2
        scale_err = scale_sd * abs(float(per_growth))
        return FocusPeak(
            height_mm=centre,
            err_mm=float(np.sqrt(scatter * heavier**2 + shared.sum() + scale_err**2)),
            pupil_err_mm=abs(float(covariance[_CENTRE, _PUPIL]))
            / float(np.sqrt(covariance[_PUPIL, _PUPIL])),
            scale_err_mm=scale_err,
            width_mm=float(np.exp(log_width)),
            tail=tail,
            base=base * amplitude,
            amplitude=amplitude,
            pupil_offset_mm=pupil_mm,
        )

    def _bounds(self) -> tuple[Floats, Floats]:
        """Least and largest parameters; the pupil stays above the target."""
        travel, pupil = self.travel, self.pupil
        reach = _PUPIL_SIGMAS * pupil.err_mm
        nearest = float(self.x[0]) + pupil.offset_mm
        lowest = pupil.offset_mm - min(reach, 0.9 * nearest)
        least_width = np.log(0.2 * travel / self.x.size)
        low = [self.x[0] - travel, least_width, 0.0, lowest, -2.0]
        high = [self.x[-1] + travel, np.log(30.0 * travel), 5.0, pupil.offset_mm + reach, 5.0]
        return np.array(low), np.array(high)

    def _start(self) -> tuple[Floats, float] | None:
        """Parameters and scatter of the best upright peak on a grid; all linear fits in one go."""
        x, pupil_mm = self.x, self.pupil.offset_mm
        widths = np.geomspace(0.5 * self.travel / (x.size - 1), 2.0 * self.travel, 10)
        centres = np.linspace(x[0], x[-1], 2 * x.size + 1)
        centre, width = (axis.reshape(-1, 1) for axis in np.meshgrid(centres, widths))
        u = (x - centre) * (centre + pupil_mm) / (x + pupil_mm) / width
        design = np.stack([np.ones_like(u), _shape(u, _START_TAIL)], axis=2)
        design *= self.root_weight[:, None]
        normal = np.einsum("gki,gkj->gij", design, design) + 1e-12 * np.eye(_LINEAR)
        target = self.y * self.root_weight
        values = np.linalg.solve(normal, np.einsum("gki,k->gi", design, target)[..., None])
        left = (design @ values)[..., 0] - target
        rss = np.where(values[:, 1, 0] > 0, np.sum(left**2, axis=1), np.inf)
        best = int(np.argmin(rss))
        if not np.isfinite(rss[best]):
            return None
        base, amplitude = values[best, :, 0]
        parameters = [centre[best, 0], np.log(width[best, 0]), _START_TAIL, pupil_mm]
        scatter = float(np.sqrt(rss[best] / (x.size - 4))) + 1e-9
        return np.array([*parameters, base / amplitude]), scatter


def _line(x: Floats, y: Floats, root_weight: Floats) -> tuple[float, float, float]:
    design = np.stack([np.ones_like(x), x - x.mean()], axis=1) * root_weight[:, None]
    values, *_ = np.linalg.lstsq(design, y * root_weight, rcond=None)
    left = y * root_weight - design @ values
    rss = float(left @ left)
    covariance = np.linalg.inv(design.T @ design) * rss / (x.size - 2)
    return rss, float(values[1]), float(np.sqrt(covariance[1, 1]))


def _require_peak(model: _Model, fit: _Fit | None) -> None:
    """Raise if a peak explains the values no better than a line does."""
    x = model.x
    line_rss, slope, slope_err = _line(x, model.y, model.root_weight)
    if fit is not None:
        gained = (line_rss - fit.rss) / _PEAK_FREEDOM / max(fit.rss / fit.freedom, 1e-300)
        if f_distribution.sf(gained, _PEAK_FREEDOM, fit.freedom) < _P_NO_PEAK:
            return
    if abs(slope) > _SLOPE_SIGMAS * slope_err:
        _refuse_end(x, "higher" if slope > 0 else "lower")
    raise NoFocusPeakError(
        f"the focus value has no peak from {x[0]:g} to {x[-1]:g} mm: it changes no more than its "
        "noise; use a target with detail, sweep further, or average more frames"
    )


def _require_inside(x: Floats, peak: FocusPeak) -> None:
    if peak.height_mm <= x[1]:
        _refuse_end(x, "lower")
    if peak.height_mm >= x[-2]:
        _refuse_end(x, "higher")
    travel = float(np.ptp(x))
    if peak.err_mm <= _WORST_ERR * travel:
        return
    remedy = "average more frames, or sweep more positions"
    if peak.scale_err_mm > 0.5 * peak.err_mm:
        remedy = "use an edge across the region: a texture also changes with its scale"
    elif peak.pupil_err_mm > 0.5 * peak.err_mm:
        remedy = "give the position of the entrance pupil with geometry.json"
    raise NoFocusPeakError(
        f"the peak at about {peak.height_mm:.2f} mm is known only to {peak.err_mm:.2f} mm; {remedy}"
    )


def _refuse_end(x: Floats, side: _Side) -> None:
    end = x[-1] if side == "higher" else x[0]
    raise NoFocusPeakError(
        f"the focus value still rises towards {end:g} mm, the {side} end of the sweep: "
        f"sweep {side}",
        side=side,
    )


_NORMAL_95 = 1.959963984540054
_REFINED_STEPS = 2
_LIGHT_STEP = 0.15  # of the logarithm
_GOOD_STEPS = 0.25  # of the distance between heights, for a 95 % half-interval
_LARGE_PART = 0.5  # of the error
_NAMED_STEPS = 0.01  # of the distance between heights: a smaller part is not worth a word
_SHARP = 0.5  # of the largest focus value
_POOLED_FREEDOM = 20.0
"""The error of one height is taken from a few frames, and is no better known than they are many:
from two frames it may be zero by chance. It counts as much against that of all the heights."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepRequest:
    """A sweep between two heights, or over the whole travel if ``heights_mm`` is None.

    ``field`` are further regions that are measured; ``pupil`` is what is known of the lens.
    """

    heights_mm: tuple[float, float] | None
    steps: int
    frames: int
    ends_at_peak: bool = False
    field: tuple[Region, ...] = ()
    pupil: PupilOffset = UNKNOWN_PUPIL


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusSweep:
    """The positions of a sweep, the peak or ``why_not``, and the peaks of further regions."""

    points: tuple[FocusPoint, ...]
    peak: FocusPeak | None
    why_not: str | None
    field: tuple[FocusPeak | None, ...] = ()

    def columns(self) -> tuple[np.ndarray[Any, np.dtype[np.float64]], ...]:
        """Heights, values and their standard errors."""
        rows = [(point.height_mm, point.value, point.err) for point in self.points]
        return tuple(np.array(rows).T)

    @property
    def remark(self) -> str | None:
        """Advice on how to find the peak more precisely; None if there is none."""
        if self.peak is None:
            return None
        step_mm = float(np.median(np.diff(np.sort(self.columns()[0]))))
        least_mm = max(_LARGE_PART * self.peak.err_mm, _NAMED_STEPS * step_mm / _NORMAL_95)
        if self.peak.scale_err_mm > least_mm:
            return (
                f"± {_NORMAL_95 * self.peak.scale_err_mm:.2g} mm of this are due to the target, "
                "whose detail also changes with its scale: use a single edge across the region"
            )
        if self.peak.pupil_err_mm > least_mm:
            return (
                f"± {_NORMAL_95 * self.peak.pupil_err_mm:.2g} mm of this are due to the entrance "
                "pupil, whose position is not known: give the geometry"
            )
        if _NORMAL_95 * self.peak.err_mm < _GOOD_STEPS * step_mm:
            return None
        return "for a smaller interval, sweep further on both sides, or average more frames"


def positions_of(request: SweepRequest) -> int:
    """How many positions a sweep has: the whole travel is swept coarsely, then finely."""
    return request.steps * (1 if request.heights_mm is not None else 2)


def sweep_bench(
    devices: BenchDevices,
    options: FocusOptions,
    request: SweepRequest,
    progress: Callable[[FocusPoint], None],
) -> FocusSweep:
    """Sweep between two heights; without them, the whole travel, then the range about the best.

    If the light changed during the sweep, there is no peak, because it might be one of the light.
    """
    low_mm, high_mm = request.heights_mm or devices.stage.limits_mm
    points: tuple[FocusPoint, ...] = ()
    for _ in range(positions_of(request) // request.steps):
        if points:
            low_mm, high_mm = _about_the_best(points)
        points = sweep_focus(
            devices,
            _positions(devices.config, low_mm, high_mm, request.steps),
            options,
            frames=request.frames,
            field=request.field,
            progress=progress,
        )
    found = FocusSweep(
        points=points, peak=None, why_not=_nothing_seen(points) or light_fault(points)
    )
    if found.why_not is not None:
        return found
    heights_mm, values, errs = found.columns()
    try:
        peak = fit_focus_peak(
            heights_mm,
            values,
            pooled_errs(errs, request.frames),
            pupil=request.pupil,
            texture_share=_texture_share(points),
        )
    except NoFocusPeakError as error:
        return replace(found, why_not=str(error))
    if request.ends_at_peak:
        timeout_s = move_timeout_s(devices.config.stage)
        devices.stage.move_to(round(peak.height_mm, 3), timeout_s)
    fields = np.array([point.field for point in points]).T
    field = (_peak_or_none(heights_mm, one, request.pupil) for one in fields)
    return replace(found, peak=peak, field=tuple(field))


def _nothing_seen(points: Sequence[FocusPoint]) -> str | None:
    if any(point.has_detail for point in points):
        return None
    heights = [point.height_mm for point in points]
    return (
        f"there is nothing to focus on from {min(heights):.2f} to {max(heights):.2f} mm: take off "
        "the lens cap, and place a target with detail"
    )


def light_fault(points: Sequence[FocusPoint]) -> str | None:
    """Say why a sweep tells nothing of the focus: its light was not the same all the way."""
    ordered = sorted(points, key=lambda point: point.height_mm)
    levels = np.log([max(point.level_dn, 1e-3) for point in ordered])
    steps = np.diff(levels)
    for number in range(1, steps.size - 1):
        # A height changes the light, but neighbouring heights by about as much.
        own, beside = steps[number], steps[[number - 1, number + 1]]
        if min(abs(own - beside[0]), abs(own - beside[1])) > _LIGHT_STEP:
            low, high = ordered[number], ordered[number + 1]
            return (
                f"the light changed by {100 * abs(np.expm1(own)):.0f} % between "
                f"{low.height_mm:.2f} and {high.height_mm:.2f} mm; keep it steady and sweep again"
            )
    return None


def pooled_errs(errs: NDArray[np.float64], frames: int) -> NDArray[np.float64]:
    """Standard errors of several heights, each from a few frames, drawn towards their median.

    References
    ----------
    Smyth: "Linear models and empirical Bayes methods for assessing differential expression",
    Statistical Applications in Genetics and Molecular Biology 3, 2004, equation 5: the variance
    that is moderated.
    """
    freedom = frames - 1
    own, common = freedom * errs**2, _POOLED_FREEDOM * float(np.median(errs)) ** 2
    return np.asarray(np.sqrt((own + common) / (freedom + _POOLED_FREEDOM)))


def _texture_share(points: Sequence[FocusPoint]) -> float:
    """The largest share of a texture in the pictures that are sharp."""
    least = _SHARP * max(point.value for point in points)
    return max((point.texture_share for point in points if point.value >= least), default=1.0)


def _peak_or_none(
    heights_mm: NDArray[np.float64], values: NDArray[np.float64], pupil: PupilOffset
) -> FocusPeak | None:
    try:
        return fit_focus_peak(heights_mm, values, pupil=pupil)
    except NoFocusPeakError:
        return None


def _positions(config: BenchConfig, low_mm: float, high_mm: float, steps: int) -> list[float]:
    heights = [round(float(height), 3) for height in np.linspace(low_mm, high_mm, steps)]
    return heights if config.stage.approach == "from_below" else heights[::-1]


def _about_the_best(points: tuple[FocusPoint, ...]) -> tuple[float, float]:
    """Range of two steps on either side of the sharpest position."""
    ordered = sorted(points, key=lambda point: point.height_mm)
    best = max(range(len(ordered)), key=lambda index: ordered[index].value)
    low = ordered[max(best - _REFINED_STEPS, 0)].height_mm
    high = ordered[min(best + _REFINED_STEPS, len(ordered) - 1)].height_mm
    return low, high
