"""Executes the commands that concern the pose: its reference, the curve and the threshold."""

from collections.abc import Callable
from typing import Any

from standoff.console.bench_hub import BenchHub
from standoff.console.web.messages import (
    ChoosePoseCurve,
    PoseClear,
    PoseReference,
    SetPoseThreshold,
)
from standoff.errors import ApplicationError


def pose_commands(hub: BenchHub) -> dict[type[Any], Callable[[Any], None]]:
    """The commands by the type of their message."""
    commands = _PoseCommands(hub)
    return {
        PoseReference: commands.choose_reference,
        PoseClear: commands.clear,
        ChoosePoseCurve: commands.choose_curve,
        SetPoseThreshold: commands.set_threshold,
    }


class _PoseCommands:
    """Acts on the hub's reference, and on what its pose is judged by."""

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub

    def choose_reference(self, message: PoseReference) -> None:
        hub = self._hub
        if message.session is None or message.index is None:
            latest = hub.frames.latest
            if latest is None:
                raise ApplicationError("There is no picture yet.")
            hub.pose.choose(
                "the picture taken just now", latest.image_dn, latest.settings.max_level_dn
            )
            return
        session = hub.sessions.open(message.session)
        record = next((r for r in session.records if r.index == message.index), None)
        if record is None:
            raise ApplicationError(f"{message.session} has no capture {message.index} to use.")
        name = f"{message.session}, capture {message.index} at {record.height_mm:.1f} mm"
        most_dn = record.max_level_dn if record.bracket is None else None
        hub.pose.choose(name, session.load(record).mean_dn, most_dn)

    def clear(self, _: PoseClear) -> None:
        self._hub.pose.clear()

    def choose_curve(self, message: ChoosePoseCurve) -> None:
        curves = self._hub.curves
        curves.choose(message.file, message.curve)
        self._tell()

    def set_threshold(self, message: SetPoseThreshold) -> None:
        self._hub.curves.set_threshold(message.min_dprime)
        self._tell()

    def _tell(self) -> None:
        """Say on all pages what counts from now on, unless the card asks to choose a curve."""
        view = self._hub.curves.view
        if view.chosen is not None:
            self._hub.tell(
                f"Poses are judged by {view.file}: {view.name}; d' at least {view.min_dprime:g}."
            )
        elif not view.file:
            self._hub.tell(f"No curve judges poses; d' at least {view.min_dprime:g}.")
