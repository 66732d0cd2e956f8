"""Executes the commands that concern the live picture: its levels and the camera's settings."""

from collections.abc import Callable
from typing import Any

from standoff.console.bench_hub import BenchHub
from standoff.console.devices import line_profile, pixel_reading
from standoff.console.jobs import BusyError
from standoff.console.web import messages

Document = dict[str, Any]


def picture_commands(hub: BenchHub) -> dict[type[Any], Callable[[Any], Document | None]]:
    """The commands by the type of their message."""
    commands = _PictureCommands(hub)
    return {
        messages.SetExposure: commands.set_exposure,
        messages.SetGain: commands.set_gain,
        messages.Probe: commands.probe,
        messages.Profile: commands.profile,
    }


class _PictureCommands:
    """Acts on the hub's camera and its newest frame."""

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub

    def set_exposure(self, message: messages.SetExposure) -> None:
        self._refuse_while_capturing()
        self._hub.camera.set_exposure_us(message.exposure_us)

    def set_gain(self, message: messages.SetGain) -> None:
        self._refuse_while_capturing()
        self._hub.camera.set_gain_db(message.gain_db)

    def probe(self, message: messages.Probe) -> Document:
        frame = self._hub.frames.latest
        reading = None if frame is None else pixel_reading(frame, message.x, message.y)
        document: Document = {"type": "probe", "x": message.x, "y": message.y, "level_dn": None}
        if frame is None or reading is None:
            return document
        return document | {
            "level_dn": reading.level_dn,
            "mean_dn": round(reading.mean_dn, 1),
            "max_level_dn": frame.settings.max_level_dn,
        }

    def profile(self, message: messages.Profile) -> Document:
        frame = self._hub.frames.latest
        profile = None if frame is None else line_profile(frame, message.start, message.end)
        document: Document = {"type": "profile", "length_px": 0.0, "levels_dn": []}
        if profile is None:
            return document
        return document | {
            "length_px": round(profile.length_px, 2),
            "levels_dn": [round(float(level), 1) for level in profile.levels_dn],
        }

    def _refuse_while_capturing(self) -> None:
        job = self._hub.jobs.current
        if job is not None and self._hub.sweep.view.state == "running":
            raise BusyError(job.name, "A sweep needs the same light all the way: wait, or stop it.")
        if job is not None and self._hub.run.view.state in ("running", "paused"):
            raise BusyError(job.name, "The session sets exposure and gain while it runs.")
