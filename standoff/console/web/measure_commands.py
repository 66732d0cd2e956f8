"""Executes the commands that concern focus: where it is measured, its peak, the sweep."""

from collections.abc import Callable
from typing import Any

from acquisition.errors import DeviceDisconnectedError
from acquisition.focus import FocusOptions, Region
from standoff.console.bench_hub import BenchHub
from standoff.console.jobs import SweepPlan
from standoff.console.web import messages
from standoff.errors import ApplicationError

LEAST_REGION_PX = 8


def require_devices(hub: BenchHub) -> None:
    """Refuse to begin what needs camera and stage while one of them is not there.

    A camera that was lost a moment ago is not refused: whatever begins waits for it.

    Raises
    ------
    DeviceDisconnectedError
        If so.
    """
    for status, is_there in (
        (hub.camera.status, hub.camera.is_expected),
        (hub.stage.status, hub.stage.status.is_ready),
    ):
        if not is_there:
            raise DeviceDisconnectedError(f"{status.text}. {status.remedy}")


def measure_commands(hub: BenchHub) -> dict[type[Any], Callable[[Any], None]]:
    """The commands by the type of their message."""
    commands = _MeasureCommands(hub)
    return {
        messages.LookAt: commands.look_at,
        messages.FocusMetric: lambda m: hub.picture.measure_by(m.metric),
        messages.ForgetPeak: commands.forget_peak,
        messages.WatchField: lambda m: hub.sharpness.watch_field(m.is_on),
        messages.WatchSquareness: lambda m: hub.squareness.watch(m.is_on),
        messages.SweepFocus: commands.sweep_focus,
    }


class _MeasureCommands:
    """Acts on the hub's monitors and sweeps."""

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub

    def look_at(self, message: messages.LookAt) -> None:
        region = None
        if message.region is not None:
            x_px, y_px, width_px, height_px = message.region
            if min(width_px, height_px) < LEAST_REGION_PX:
                raise ApplicationError(
                    f"A region must be at least {LEAST_REGION_PX} pixels wide and high."
                )
            region = Region(x_px=x_px, y_px=y_px, width_px=width_px, height_px=height_px)
        self._hub.picture.look_at(region)
        self._hub.sharpness.look_at(region)

    def forget_peak(self, _: messages.ForgetPeak) -> None:
        self._hub.picture.forget_peak()
        self._hub.sharpness.forget_peaks()

    def sweep_focus(self, message: messages.SweepFocus) -> None:
        hub = self._hub
        if (message.low_mm is None) != (message.high_mm is None):
            raise ApplicationError("Give both heights of the sweep, or neither.")
        heights_mm = None
        if message.low_mm is not None and message.high_mm is not None:
            heights_mm = message.low_mm, message.high_mm
        facts = hub.picture.facts
        plan = SweepPlan(
            heights_mm=heights_mm,
            steps=message.steps,
            options=FocusOptions(measure=facts.measure, region=facts.region),
            has_field=message.has_field,
            ends_at_peak=message.ends_at_peak,
        )
        require_devices(hub)
        hub.sweep.prepare(plan)
        hub.jobs.begin("focus sweep", lambda job: hub.sweep.work(job, plan))
