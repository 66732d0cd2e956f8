"""Executes the commands that concern the live picture: its levels and the camera's settings."""

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.averaging import average_frames
from acquisition.bracket import ExposureControl
from acquisition.capture import SHORTEST_EXPOSURE_US, FoundExposure, find_exposure
from acquisition.devices import CameraSettings
from acquisition.restarting import restarted
from standoff.console.bench_hub import BenchHub
from standoff.console.devices import LONG_S, line_profile, pixel_reading
from standoff.console.jobs import BusyError, Job
from standoff.console.snapshot_library import (
    SnapshotRecord,
    identity_of,
    settings_of_record,
    snapshot_bytes,
    utc_text,
)
from standoff.console.web import messages
from standoff.errors import ApplicationError

AUTO_EXPOSURE = "finding the exposure"
SNAPSHOT = "averaging a snapshot"

FAINT_FRACTION = 0.5
"""Of the range: what is darker than that was not exposed as intended."""

Document = dict[str, Any]
T = TypeVar("T")


def picture_commands(hub: BenchHub) -> dict[type[Any], Callable[[Any], Document | None]]:
    """The commands by the type of their message."""
    commands = _PictureCommands(hub)
    return {
        messages.SetExposure: commands.set_exposure,
        messages.BreakOff: commands.break_off,
        messages.SetGain: commands.set_gain,
        messages.AutoExposure: commands.find_exposure,
        messages.TakeSnapshot: commands.take_snapshot,
        messages.Probe: commands.probe,
        messages.Profile: commands.profile,
    }


class _PictureCommands:
    """Acts on the hub's camera and its newest frame."""

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub

    def set_exposure(self, message: messages.SetExposure) -> None:
        self._refuse_while_capturing()
        if message.exposure_us > 1e6 * LONG_S and not message.is_long_wanted:
            raise ApplicationError(
                f"Each picture would take {1e-6 * message.exposure_us:.3g} s: say that this is "
                "wanted."
            )
        self._hub.camera.set_exposure_us(message.exposure_us)

    def break_off(self, _: messages.BreakOff) -> None:
        self._refuse_while_capturing()
        self._hub.camera.break_off()

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

    def find_exposure(self, _: messages.AutoExposure) -> None:
        self._refuse_while_capturing()
        self._hub.jobs.begin(AUTO_EXPOSURE, self._find_exposure)

    def take_snapshot(self, message: messages.TakeSnapshot) -> None:
        if message.frames > 1:
            self._hub.jobs.begin(SNAPSHOT, lambda job: self._average_snapshot(job, message.frames))
            return
        frame, status = self._hub.frames.latest, self._hub.camera.status
        if frame is None or status.state == "lost":
            raise ApplicationError(f"There is no picture to store. {status.text}".strip())
        taken = datetime.fromtimestamp(frame.received_s, UTC)
        self._store(frame.image_dn, 1, frame.settings, taken)

    def _find_exposure(self, job: Job) -> None:
        """Find the exposure; if that fails or is stopped, the one before is set again."""
        service, bench = self._hub.camera, self._hub.bench
        low_us, high_us = service.exposure_limits_us
        period_us = max(1e6 / bench.camera.frame_rate_hz, bench.camera.exposure_us)
        limits_us = (max(SHORTEST_EXPOSURE_US, low_us), min(period_us, high_us))
        with service.lent(job.check) as camera:
            exposure_us = camera.settings.exposure_us
            try:
                found = self._restarted(
                    lambda: find_exposure(
                        camera,
                        ExposureControl(camera, None, self._hub.clock),
                        limits_us=limits_us,
                        mains_hz=bench.capture.mains_hz,
                    )
                )
                exposure_us = found.exposure_us
            finally:
                # Asked of the service, so that a camera that is reopened gets it, too.
                service.set_exposure_us(exposure_us)
        self._hub.tell(exposure_sentence(found))

    def _average_snapshot(self, job: Job, frames: int) -> None:
        with self._hub.camera.lent(job.check) as camera:
            averaged = self._restarted(
                lambda: average_frames(camera, frames, clock=self._hub.clock)
            )
            settings = camera.settings
        self._store(averaged.mean_dn, frames, settings, datetime.now(UTC))

    def _restarted(self, work: Callable[[], T]) -> T:
        """Do what streams, from its beginning again where the stream breaks off."""
        timeout_s = self._hub.bench.camera.reconnect_timeout_s
        return restarted(work, timeout_s=timeout_s, clock=self._hub.clock)

    def _store(
        self,
        levels_dn: NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32],
        frames: int,
        settings: CameraSettings,
        taken: datetime,
    ) -> None:
        region = self._hub.picture.facts.region
        stage = self._hub.stage.view
        record = SnapshotRecord(
            taken_utc=utc_text(taken),
            operator=self._hub.operator,
            frames=frames,
            height_mm=stage.height_mm if stage.status.is_ready and stage.is_homed else None,
            region_px=(
                None
                if region is None
                else (region.x_px, region.y_px, region.width_px, region.height_px)
            ),
            camera=identity_of(self._hub.camera.info),
            **settings_of_record(settings),
        )
        name = self._hub.snapshots.save(snapshot_bytes(levels_dn, record), taken)
        self._hub.tell(f"Snapshot stored: {name}")

    def _refuse_while_capturing(self) -> None:
        job = self._hub.jobs.current
        if job is None:
            return
        if self._hub.sweep.view.state == "running":
            raise BusyError(job.name, "A sweep needs the same light all the way: wait, or stop it.")
        if self._hub.run.is_under_way:
            raise BusyError(job.name, "The session sets exposure and gain while it runs.")
        if job.name in (AUTO_EXPOSURE, SNAPSHOT):
            raise BusyError(job.name)


def exposure_sentence(found: FoundExposure) -> str:
    """What was found, and what to do if it is not enough light, or too much."""
    reached = f"{100 * found.bright_fraction:.0f} % of the range"
    if found.bright_fraction >= 1:
        return (
            f"Exposure {found.exposure_us:g} µs, the shortest, and parts of the picture are still "
            "saturated: close the aperture, or give less light."
        )
    if found.bright_fraction < FAINT_FRACTION:
        return (
            f"Exposure {found.exposure_us:g} µs, the longest without flicker in a frame, and the "
            f"brightest parts reach only {reached}: give more light, open the aperture, or lower "
            "camera.frame_rate_hz in the bench file."
        )
    return f"Exposure {found.exposure_us:g} µs: the brightest parts reach {reached}."
