"""Executes the commands that concern the live picture: levels, camera settings, focus."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from acquisition.averaging import average_frames, restarted
from acquisition.bench import CameraConfig
from acquisition.capture import EXPOSURE_AIM, SHORTEST_EXPOSURE_US, FoundExposure, find_exposure
from acquisition.choices import FocusMeasure
from acquisition.devices import CameraSettings
from acquisition.exposure_control import ExposureControl
from acquisition.focus import FocusOptions, Region
from standoff.console.bench_hub import BenchHub
from standoff.console.camera_service import LONG_S
from standoff.console.focus_sweep import SweepPlan
from standoff.console.frames import line_profile, pixel_reading
from standoff.console.jobs import BusyError, Job
from standoff.console.snapshot_library import (
    SnapshotRecord,
    identity_of,
    settings_of_record,
    snapshot_bytes,
    utc_text,
)
from standoff.console.web._messages import Coordinate, Finite, Pixels, Positive, command
from standoff.errors import ApplicationError

AUTO_EXPOSURE = "finding the exposure"
SNAPSHOT = "averaging a snapshot"
LEAST_REGION_PX = 8

Document = dict[str, Any]
T = TypeVar("T")


class PictureCommands:
    """Commands that act on the camera, its newest frame, and the monitors that watch it."""

    _hub: BenchHub

    @command("exposure")
    def _set_exposure(self, exposure_us: Positive, is_long_wanted: bool = False) -> None:
        """Set the exposure of the live picture; one above 2 s only where that is wanted."""
        self._refuse_while_capturing()
        self._refuse_beyond_limits(exposure_us)
        if exposure_us > 1e6 * LONG_S and not is_long_wanted:
            raise ApplicationError(
                f"Each picture would take {1e-6 * exposure_us:.3g} s: confirm that you want this."
            )
        self._hub.camera.set_exposure_us(exposure_us)

    @command("break-off")
    def _break_off(self) -> None:
        """Break a long exposure off, and go back to the shorter one of before."""
        self._refuse_while_capturing()
        self._hub.camera.break_off()

    @command("gain")
    def _set_gain(
        self, gain_db: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]
    ) -> None:
        """Set the gain."""
        self._refuse_while_capturing()
        self._hub.camera.set_gain_db(gain_db)

    @command("probe", needs_control=False)
    def _probe(self, x: Pixels, y: Pixels) -> Document:
        """Read the level of a pixel."""
        frame = self._hub.frames.latest
        reading = None if frame is None else pixel_reading(frame, x, y)
        document: Document = {"type": "probe", "x": x, "y": y, "level_dn": None}
        if frame is None or reading is None:
            return document
        return document | {
            "level_dn": reading.level_dn,
            "mean_dn": round(reading.mean_dn, 1),
            "max_level_dn": frame.settings.max_level_dn,
        }

    @command("profile", needs_control=False)
    def _profile(
        self, start: tuple[Coordinate, Coordinate], end: tuple[Coordinate, Coordinate]
    ) -> Document:
        """Read the levels along a line; ends are x and y, with pixel centres at integers."""
        frame = self._hub.frames.latest
        profile = None if frame is None else line_profile(frame, start, end)
        document: Document = {"type": "profile", "length_px": 0.0, "levels_dn": []}
        if profile is None:
            return document
        return document | {
            "length_px": round(profile.length_px, 2),
            "levels_dn": [round(float(level), 1) for level in profile.levels_dn],
        }

    @command("auto-exposure")
    def _auto_exposure(self) -> None:
        """Find the exposure for what the camera sees, once."""
        self._refuse_while_capturing()
        self._hub.jobs.begin(AUTO_EXPOSURE, self._find_exposure)

    @command("snapshot")
    def _take_snapshot(self, frames: Literal[1, 10]) -> None:
        """Store the newest frame, or the mean of several, as a TIFF file."""
        if frames > 1:
            self._hub.jobs.begin(SNAPSHOT, lambda job: self._average_snapshot(job, frames))
            return
        frame, status = self._hub.frames.latest, self._hub.camera.status
        if frame is None or status.state == "lost":
            raise ApplicationError(f"There is no picture to store. {status.text}".strip())
        taken = datetime.fromtimestamp(frame.received_s, UTC)
        self._store(frame.image_dn, 1, frame.settings, taken)

    @command("region")
    def _look_at(self, region: tuple[Pixels, Pixels, Pixels, Pixels] | None) -> None:
        """Measure the focus in a region, or in the whole frame if it is null."""
        cut = None
        if region is not None:
            x_px, y_px, width_px, height_px = region
            if min(width_px, height_px) < LEAST_REGION_PX:
                raise ApplicationError(
                    f"A region must be at least {LEAST_REGION_PX} pixels wide and high."
                )
            cut = Region(x_px=x_px, y_px=y_px, width_px=width_px, height_px=height_px)
        self._hub.picture.look_at(cut)
        self._hub.sharpness.look_at(cut)

    @command("metric")
    def _measure_by(self, metric: FocusMeasure) -> None:
        """Choose another focus measure."""
        self._hub.picture.measure_by(metric)

    @command("forget-peak")
    def _forget_peak(self) -> None:
        """Restart the focus trace."""
        self._hub.picture.forget_peak()
        self._hub.sharpness.forget_peaks()

    @command("watch-field")
    def _watch_field(self, is_on: bool) -> None:
        """Measure the four regions near the corners, or stop it."""
        self._hub.sharpness.watch_field(is_on)

    @command("watch-square")
    def _watch_squareness(self, is_on: bool) -> None:
        """Measure the tilt of the board, or stop it."""
        self._hub.squareness.watch(is_on)

    @command("sweep-focus")
    def _sweep_focus(
        self,
        low_mm: Finite | None = None,
        high_mm: Finite | None = None,
        steps: Annotated[int, Field(ge=7, le=200)] = 15,
        has_field: bool = False,
        ends_at_peak: bool = True,
    ) -> None:
        """Sweep the stage through focus: between two heights, or the whole travel."""
        hub = self._hub
        if (low_mm is None) != (high_mm is None):
            raise ApplicationError("Give both heights of the sweep, or neither.")
        facts = hub.picture.facts
        plan = SweepPlan(
            heights_mm=None if low_mm is None or high_mm is None else (low_mm, high_mm),
            steps=steps,
            options=FocusOptions(measure=facts.measure, region=facts.region),
            has_field=has_field,
            ends_at_peak=ends_at_peak,
        )
        hub.require_devices()
        hub.sweep.prepare(plan)
        hub.jobs.begin("focus sweep", lambda job: hub.sweep.work(job, plan))

    def _find_exposure(self, job: Job) -> None:
        """Find the exposure; if that fails or is stopped, the one before is set again."""
        service, bench = self._hub.camera, self._hub.bench
        low_us, high_us = service.exposure_limits_us
        mains_hz = bench.capture.mains_hz
        longest = longest_exposure(bench.camera, high_us)
        limits_us = (max(SHORTEST_EXPOSURE_US, low_us), longest.exposure_us)
        with service.lent(job.check) as camera:
            exposure_us = camera.settings.exposure_us
            try:
                found = self._restarted(
                    lambda: find_exposure(
                        camera,
                        ExposureControl(camera, None, self._hub.clock),
                        limits_us=limits_us,
                        mains_hz=mains_hz,
                    )
                )
                exposure_us = found.exposure_us
            finally:
                # Asked of the service, so that a camera that is reopened gets it, too.
                service.set_exposure_us(exposure_us)
        self._hub.tell(exposure_sentence(found, longest=longest, mains_hz=mains_hz))

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

    def _refuse_beyond_limits(self, exposure_us: float) -> None:
        low_us, high_us = self._hub.camera.exposure_limits_us
        if not self._hub.camera.status.is_ready or low_us <= exposure_us <= high_us:
            return
        limit = f"at least {low_us:.9g} µs, its shortest"
        if exposure_us > high_us:
            limit = f"at most {high_us:.9g} µs, its longest"
        raise ApplicationError(f"The exposure of this camera must be {limit}.")

    def _refuse_while_capturing(self) -> None:
        job = self._hub.jobs.current
        if job is None:
            return
        if self._hub.sweep.view.state == "running":
            raise BusyError(job.name, "A sweep locks exposure and gain: wait, or stop it.")
        if self._hub.run.is_under_way:
            raise BusyError(job.name, "The session sets exposure and gain while it runs.")
        if job.name in (AUTO_EXPOSURE, SNAPSHOT):
            raise BusyError(job.name)


@dataclass(frozen=True, slots=True, kw_only=True)
class _LongestExposure:
    """The longest exposure that is tried: what sets it, and what one may do about that."""

    exposure_us: float
    words: str
    remedy: str


def longest_exposure(camera: CameraConfig, high_us: float) -> _LongestExposure:
    """The camera's longest, or one that does not slow the pictures down if that is shorter."""
    frame = _LongestExposure(
        exposure_us=1e6 / camera.frame_rate_hz,
        words=f"a frame takes at camera.frame_rate_hz = {camera.frame_rate_hz:g}",
        remedy="raise the gain, or lower camera.frame_rate_hz in the bench file",
    )
    bench = _LongestExposure(
        exposure_us=camera.exposure_us,
        words="camera.exposure_us of the bench file",
        remedy="raise the gain, or enter a longer exposure",
    )
    own = _LongestExposure(
        exposure_us=high_us, words="the camera can expose", remedy="or raise the gain"
    )
    allowed = max(frame, bench, key=lambda each: each.exposure_us)
    return min(allowed, own, key=lambda each: each.exposure_us)


def exposure_sentence(found: FoundExposure, *, longest: _LongestExposure, mains_hz: float) -> str:
    """What was found, and why and what to do if it is not the level that is aimed at."""
    exposure = f"Exposure {found.exposure_us:.9g} µs"
    reached = f"{100 * found.bright_fraction:.0f} % of the range"
    if not found.limited_by:
        return f"{exposure}: the brightest parts reach {reached}."
    aim = f"not {100 * EXPOSURE_AIM:.0f} %"
    if "shortest" in found.limited_by:
        many = (
            "parts of the picture are saturated"
            if found.bright_fraction >= 1
            else (f"the brightest parts reach {reached}, {aim}")
        )
        return f"{exposure}, the shortest, and {many}: close the aperture, or give less light."
    period = f"whole periods of the mains light ({0.5e6 / mains_hz:.9g} µs)" if mains_hz else ""
    if "longest" in found.limited_by:
        whole = f", in {period}" if "flicker" in found.limited_by else ""
        return (
            f"{exposure}, no longer than {longest.words}{whole}, and the brightest parts reach "
            f"only {reached}, {aim}: give more light, open the aperture, {longest.remedy}."
        )
    return (
        f"{exposure}: the brightest parts reach {reached}, {aim}, because exposures are {period} "
        "and one more would be too bright. Give more light or raise the gain slightly; for light "
        "that does not flicker, set capture.mains_hz = 0 in the bench file."
    )
