"""How often a control chart of calibrations alarms, without a change and with one, and its dates.

Drawn histories have normal errors of the size that a calibration states; measured ones are
calibrations of rendered edges at the dates, each with its own noise, whose errors are what
``standoff calibrate`` makes of them. Drifts begin in the middle of the year; the interval of dates
must hold the true one.
"""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta

import numpy as np

import standoff
from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.lenses import edge_photographs, gaussian
from calibration.psf import ControlChart, PsfCalibration, control_charts

COUNTS = (6, 12, 26, 52)
MEASURED = 12
"""Calibrations a year: one a month."""
SIGMA_PX, ERR_SHARE = 0.7, 0.004
ANGLES_DEG = (6.0, 96.0)
START = datetime(2026, 1, 5, tzinfo=UTC)

Change = Callable[[float], float]
"""Relative change of the width by the share of the year."""


def none(year: float) -> float:
    """No change."""
    return 0.0 * year


def step_of(size: float) -> Change:
    """A step in the middle of the year."""
    return lambda year: size * (year >= 0.5)


def steady_of(size: float) -> Change:
    """A drift from the middle of the year on, of this size at its end."""
    return lambda year: size * max(year - 0.5, 0.0) / 0.5


def dates(count: int) -> list[str]:
    """Dates evenly over a year."""
    return [(START + timedelta(days=365 * n / count)).isoformat() for n in range(count)]


def drawn(count: int, change: Change, rng: np.random.Generator) -> list[PsfCalibration]:
    """A history whose errors are normal, and differ from calibration to calibration."""
    found = []
    for number, date in enumerate(dates(count)):
        errs = ERR_SHARE * SIGMA_PX * rng.uniform(0.5, 2.0, 3)
        true = SIGMA_PX * (1 + change(number / count))
        values = np.array([true, true, 0.0]) + errs * rng.standard_normal(3)
        found.append(
            PsfCalibration(
                sigma_x_px=values[0],
                sigma_x_err_px=errs[0],
                sigma_y_px=values[1],
                sigma_y_err_px=errs[1],
                rho=values[2],
                rho_err=errs[2],
                captured_utc=date,
            )
        )
    return found


def calibrated(count: int, change: Change, seed: int) -> list[PsfCalibration]:
    """A history of calibrations of rendered edges."""
    found = []
    for number, date in enumerate(dates(count)):
        camera = gaussian(SIGMA_PX * (1 + change(number / count)), has_pixel=True)
        images = edge_photographs(camera, ANGLES_DEG, 90, 100, 1000 * seed + number)
        psf = standoff.calibrate_psf(list(images))
        found.append(psf.model_copy(update={"captured_utc": date, "provenance": None}))
    return found


def _alarms(histories: Sequence[list[PsfCalibration]]) -> float:
    return float(np.mean([any(one.drift for one in control_charts(psfs)) for psfs in histories]))


def _dated(charts: Sequence[ControlChart], start_utc: str) -> list[bool]:
    """Whether the interval of a drift that was found holds its start.

    The calibration at the start is the first that a step has changed, and the last before a steady
    drift.
    """
    return [
        chart.drift.after_utc <= start_utc <= chart.drift.before_utc
        and (chart.drift.kind != "step" or chart.drift.after_utc < start_utc)
        for chart in charts
        if chart.drift is not None
    ]


def _share(found: Sequence[bool]) -> float:
    return 100 * float(np.mean(found)) if found else 0.0


@benchmark("numpy", "scipy", note="a year, changes from its middle on")
def main(record: Recorder) -> None:
    """Count alarms, and dates that are right."""
    rng = np.random.default_rng(18)
    draws = record.pick(2000, 20)
    record.say("drawn histories: share with an alarm")
    for count in COUNTS:
        share = _alarms([drawn(count, none, rng) for _ in range(draws)])
        record.say(f"  {count:3d} calibrations, no change: {100 * share:.2f} %")
        record.figure(f"false alarms, {count} calibrations", 100 * share, "%")
    cases = {
        "step of 1 standard error": step_of(ERR_SHARE),
        "step of 3": step_of(3 * ERR_SHARE),
        "steady to 3": steady_of(3 * ERR_SHARE),
        "steady to 6": steady_of(6 * ERR_SHARE),
    }
    for count in (12, 52):
        start = dates(count)[count // 2]
        for name, change in cases.items():
            seen, right, kinds = 0, list[bool](), list[bool]()
            for _ in range(draws // 4):
                charts = [
                    one for one in control_charts(drawn(count, change, rng))
                    if one.parameter != "rho"
                ]  # fmt: skip
                seen += any(one.drift for one in charts)
                right += _dated(charts, start)
                kinds += [
                    one.drift.kind in name
                    for one in charts
                    if one.drift is not None and one.drift.kind != "either"
                ]
            record.say(
                f"  {count:3d} calibrations, {name:24s}: seen {400 * seen / draws:5.1f} %; dates "
                f"hold {_share(right):5.1f} % of {len(right)}, kind right "
                f"{_share(kinds):5.1f} % of {len(kinds)}"
            )
            record.figure(f"seen, {count} calibrations, {name}", 400 * seen / draws, "%")
            held = _share(right)
            record.figure(f"dates that hold, {count} calibrations, {name}", held, "%")
    record.say(f"\ncalibrations of rendered edges, {MEASURED} a year")
    years = record.pick(60, 2)
    share = _alarms([calibrated(MEASURED, none, seed) for seed in range(years)])
    record.figure("false alarms, measured calibrations", 100 * share, "%")
    change, right, seen = step_of(0.02), list[bool](), 0
    for seed in range(years // 2):
        found = control_charts(calibrated(MEASURED, change, 500 + seed))
        seen += any(one.drift for one in found)
        right += _dated(found, dates(MEASURED)[MEASURED // 2])
    record.figure("seen, measured, step of 2 %", 200 * seen / max(years, 2), "%")
    record.figure("dates that hold, measured", _share(right), "%")
