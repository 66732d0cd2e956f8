"""Searches the height of best focus: a sweep between two heights, or of the whole travel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import BenchConfig, BenchDevices
from acquisition.focus.live import FocusOptions, FocusPoint, sweep_focus
from acquisition.focus.measures import Region
from acquisition.focus.sweep import (
    UNKNOWN_PUPIL,
    FocusPeak,
    NoFocusPeakError,
    PupilOffset,
    fit_focus_peak,
)
from acquisition.stages import move_timeout_s

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
    """A sweep: lowest and highest height, how many heights, and frames at each.

    If ``heights_mm`` is None, the whole travel; ``ends_at_peak`` moves the stage there at the end.
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
    """The positions of a sweep and the peak; ``why_not`` says why there is none.

    ``field`` are the peaks of further regions, None where one has none.
    """

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
        """What would tell the peak better: what is not known, or more data than a wide step has."""
        if self.peak is None:
            return None
        step_mm = float(np.median(np.diff(np.sort(self.columns()[0]))))
        least_mm = max(_LARGE_PART * self.peak.err_mm, _NAMED_STEPS * step_mm / _NORMAL_95)
        if self.peak.scale_err_mm > least_mm:
            return (
                f"± {_NORMAL_95 * self.peak.scale_err_mm:.2g} mm of it are the target's, whose "
                "detail changes with its scale as well: use one edge across the region"
            )
        if self.peak.pupil_err_mm > least_mm:
            return (
                f"± {_NORMAL_95 * self.peak.pupil_err_mm:.2g} mm of it are the entrance pupil's, "
                "whose place is not known: give the geometry"
            )
        if _NORMAL_95 * self.peak.err_mm < _GOOD_STEPS * step_mm:
            return None
        return "to know it better, sweep further on both sides, or average more frames"


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

    There is no peak where the light changed on the way: what it would show might be the light's.

    Raises
    ------
    DeviceError
        If a device fails or a height is outside the travel.
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
