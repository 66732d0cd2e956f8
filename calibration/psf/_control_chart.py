"""Control charts of a camera's calibrations: whether its PSF has drifted, and since when.

Each calibration is compared with the mean of those before it. Where nothing has changed, these
differences over their standard errors are independent and normal of variance 1, whatever the
errors of the single calibrations: the limits are those of the calibrations' own errors, and no
first year without drift has to be set aside. Their cumulative sums (CUSUM) upwards and downwards
pass a limit when small changes of one sign add up. The limit is such that of all histories without
a change, as long as this one, 1 % pass it, in any parameter and either direction.

D. M. Hawkins and D. H. Olwell, "Cumulative sum charts and charting for quality improvement",
Springer, 1998, chapters 2 and 7 (self-starting charts). D. Brook and D. A. Evans, "An approach to
the probability distribution of cusum run length", Biometrika 59 (1972), 539.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import lru_cache
from math import sqrt
from typing import Any, Final, Literal

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from calibration.estimate import NORMAL_95
from calibration.psf._comparison import independent_calibrations
from calibration.psf._document import PsfCalibration
from simulation.arrays import FloatArray

FALSE_ALARMS: Final = 0.01
"""Share of histories without a change in which any chart of a camera passes its limit."""

_PARAMETERS = ("sigma_x_px", "sigma_y_px", "rho")
_FEWEST = 5
_ALLOWANCE = 0.5  # standard errors: half of the change that is found soonest
_STATES = 150
_SIDES = 2
_WITHIN_95 = NORMAL_95**2
_DAYS_A_YEAR = 365.25
_KINDS = {
    "step": "changed at once",
    "steady": "drifts steadily",
    "either": "changed, at once or steadily",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """A change of a parameter in a history, and its date.

    ``seen_utc`` is when its chart passed the limit. ``kind`` says whether it is a step or a steady
    drift, ``either`` where the calibrations do not tell. It began after ``after_utc`` and not later
    than ``before_utc``, with 95 % confidence. ``change`` is the step, or what a steady drift has
    added up to at the end, with its standard error; ``start`` the level before.
    """

    seen_utc: str
    kind: Literal["step", "steady", "either"]
    after_utc: str
    before_utc: str
    start: float
    change: float
    change_err: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControlChart:
    """One parameter over time: values, their standard errors, and both cumulative sums.

    ``limit`` bounds the sums, which are in standard errors. ``centre`` is the mean of the
    calibrations, up to a drift where there is one.
    """

    parameter: str
    captured_utc: tuple[str, ...]
    values: tuple[float, ...]
    errs: tuple[float, ...]
    upwards: tuple[float, ...]
    downwards: tuple[float, ...]
    limit: float
    centre: float
    drift: Drift | None

    def __str__(self) -> str:
        name = self.parameter.removesuffix("_px").replace("_", " ")
        drift = self.drift
        if drift is None:
            return f"{name}: no drift in {len(self.values)} calibrations"
        reach = NORMAL_95 * drift.change_err
        if self.parameter == "rho":
            amount = f"{drift.change:+.3f} ± {reach:.3f}"
        else:
            share = 100 / drift.start
            amount = f"{share * drift.change:+.2f} ± {share * reach:.2f} %"
        return (
            f"{name} {_KINDS[drift.kind]}, by {amount}: it began between "
            f"{drift.after_utc[:10]} and {drift.before_utc[:10]}, and its chart passed the limit "
            f"on {drift.seen_utc[:10]}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the chart as plain values."""
        return asdict(self)


def control_charts(psfs: Sequence[PsfCalibration]) -> tuple[ControlChart, ...]:
    """Return the charts of one camera's calibrations; none with fewer than five that state a date.

    Those of the same captures count once, and of several methods, colours or parts of the frame
    those that there are most of.
    """
    dated = sorted(
        (psf for psf in independent_calibrations(psfs) if psf.captured_utc is not None),
        key=lambda psf: psf.captured_utc or "",
    )
    known = {
        name: [
            (psf.captured_utc or "", found.value, found.err)
            for psf in dated
            if (found := psf.estimate(name)) is not None and found.err > 0
        ]
        for name in _PARAMETERS
    }
    charted = {name: rows for name, rows in known.items() if len(rows) >= _FEWEST}
    return tuple(_chart(name, rows, len(charted)) for name, rows in charted.items())


def _chart(parameter: str, rows: Sequence[tuple[str, float, float]], charts: int) -> ControlChart:
    dates = tuple(date for date, _, _ in rows)
    values, errs = np.array([(value, err) for _, value, err in rows]).T
    upwards, downwards = cumulative_sums(values, errs)
    limit = cusum_limit(len(rows) - 1, FALSE_ALARMS / (_SIDES * charts))
    passed = np.flatnonzero(np.maximum(upwards, downwards) > limit)
    drift = _drift(dates, values, errs, int(passed[0])) if passed.size else None
    before = len(rows) if drift is None else max(dates.index(drift.after_utc) + 1, 1)
    return ControlChart(
        parameter=parameter,
        captured_utc=dates,
        values=tuple(values.tolist()),
        errs=tuple(errs.tolist()),
        upwards=tuple(upwards.tolist()),
        downwards=tuple(downwards.tolist()),
        limit=limit,
        centre=float(np.average(values[:before], weights=errs[:before] ** -2)),
        drift=drift,
    )


def cumulative_sums(values: FloatArray, errs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both sums after each value, 0 at the first one, shape ``(n,)`` each."""
    weight = np.cumsum(errs**-2)
    mean = np.cumsum(values * errs**-2) / weight
    away = (values[1:] - mean[:-1]) / np.sqrt(errs[1:] ** 2 + 1 / weight[:-1])
    up, down = np.zeros(values.size), np.zeros(values.size)
    for number, one in enumerate(away, start=1):
        up[number] = max(up[number - 1] + one - _ALLOWANCE, 0.0)
        down[number] = max(down[number - 1] - one - _ALLOWANCE, 0.0)
    return up, down


@lru_cache(maxsize=64)
def cusum_limit(count: int, share: float) -> float:
    """Return the limit that one sum passes within so many values in this share of histories."""
    return float(brentq(lambda limit: _passing(limit, count) - share, 0.2, 60.0, xtol=1e-4))


def _passing(limit: float, count: int) -> float:
    """Probability that a sum of unit normals passes a limit within ``count`` of them."""
    step = 2 * limit / (2 * _STATES - 1)  # the first state is 0, half as wide
    places = np.arange(_STATES) * step
    ends = np.concatenate([[-np.inf], places + 0.5 * step])
    below = ndtr(ends[None, :] - places[:, None] + _ALLOWANCE)
    moves = np.diff(below, axis=1)
    state = np.zeros(_STATES)
    state[0] = 1.0
    for _ in range(count):
        state = state @ moves
    return float(1.0 - state.sum())


def _drift(dates: tuple[str, ...], values: FloatArray, errs: FloatArray, seen: int) -> Drift:
    """Fit a step or a steady drift from each date on, and take the likeliest."""
    when = _years(dates)
    fits: dict[tuple[Literal["step", "steady"], int], _Fit] = {
        (kind, start): _fit(np.column_stack([np.ones(when.size), shape(when, start)]), values, errs)
        for kind, shape in _SHAPES.items()
        for start in range(1, when.size - (kind == "steady"))
    }
    kind, start = min(fits, key=lambda one: fits[one].chi2)
    best = fits[kind, start]
    near = [one for one in fits if fits[one].chi2 <= best.chi2 + _WITHIN_95]
    starts = [one for _, one in near]
    last = _SHAPES[kind](when, start)[-1]
    return Drift(
        seen_utc=dates[seen],
        kind=kind if len({one for one, _ in near}) == 1 else "either",
        after_utc=dates[min(starts) - 1],
        before_utc=dates[max(starts)],
        start=best.level,
        change=best.change * float(last),
        change_err=best.change_err * float(last),
    )


def _years(dates: Sequence[str]) -> FloatArray:
    first = datetime.fromisoformat(dates[0])
    seconds = [(datetime.fromisoformat(one) - first).total_seconds() for one in dates]
    return np.array(seconds) / (86400 * _DAYS_A_YEAR)


def _step(when: FloatArray, start: int) -> FloatArray:
    """1 from a calibration on."""
    return (np.arange(when.size) >= start).astype(np.float64)


def _steady(when: FloatArray, start: int) -> FloatArray:
    """Time since the calibration before."""
    return np.asarray(np.maximum(when - when[start - 1], 0.0))


_SHAPES: dict[Literal["step", "steady"], Callable[[FloatArray, int], FloatArray]] = {
    "step": _step,
    "steady": _steady,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    level: float
    change: float
    change_err: float
    chi2: float


def _fit(design: FloatArray, values: FloatArray, errs: FloatArray) -> _Fit:
    weighted = design / errs[:, None]
    covariance = np.linalg.pinv(weighted.T @ weighted)
    level, change = (covariance @ weighted.T @ (values / errs)).tolist()
    left = (values - design @ np.array([level, change])) / errs
    return _Fit(
        level=level,
        change=change,
        change_err=sqrt(float(covariance[1, 1])),
        chi2=float(left @ left),
    )
