"""Owns the camera: streams all the time, lends it to a run, and reopens it when lost."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from threading import Lock

from acquisition.devices import (
    Camera,
    CameraSettings,
    DeviceInfo,
    Frame,
    LimitedExposureCamera,
    StreamStatistics,
)
from acquisition.errors import (
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceProtocolError,
    DeviceTimeoutError,
    DriverMissingError,
    StreamInterruptedError,
)
from standoff.console.devices import DeviceStatus, Service
from standoff.console.frames import FrameBroadcaster
from standoff.doctor import advice_on

LONG_S = 2.0
"""Longer exposures are asked about first, counted down, and can be broken off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposing:
    """A long exposure; ``left_s`` is 0 once its frame is due.

    ``is_dropped`` says that it was broken off, and that the camera finishes it all the same.
    """

    seconds: float
    left_s: float
    is_dropped: bool = False


class ExposureClock:
    """Follows the exposures of one camera; its thread tells when each begins.

    A long exposure that is broken off ends with the stream. A camera that cannot abort finishes
    it: until then nothing else comes from it, and what does is dropped.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._lock = Lock()
        self._seconds = self._began_s = 0.0
        self._dropped: tuple[float, float] | None = None
        self.shorter_us = 1e6 * LONG_S
        """The last exposure that was not long."""

    @property
    def view(self) -> Exposing | None:
        """The long exposure that is waited for; None if there is none."""
        with self._lock:
            # The exposure that follows it is told of, if that is long as well.
            is_dropped = self._dropped is not None and self._seconds <= LONG_S
            now = self._began_s, self._seconds
            began_s, seconds = (self._dropped or now) if is_dropped else now
        if seconds <= LONG_S:
            return None
        left_s = max(0.0, began_s + seconds - self._clock())
        if is_dropped and left_s == 0:
            return None
        return Exposing(seconds=seconds, left_s=left_s, is_dropped=is_dropped)

    @property
    def is_broken_off(self) -> bool:
        """Whether the camera may still be busy with an exposure that nobody waits for."""
        dropped = self._dropped
        return dropped is not None and self._clock() < sum(dropped) + LONG_S

    def began(self, exposure_us: float) -> None:
        """Note that a frame is being exposed from now on."""
        with self._lock:
            self._seconds, self._began_s = 1e-6 * exposure_us, self._clock()
            if self._seconds <= LONG_S:
                self.shorter_us = exposure_us

    def ended(self) -> None:
        """Note that nothing is exposed any more."""
        with self._lock:
            self._seconds, self._dropped = 0.0, None

    def break_off(self) -> bool:
        """Give the present exposure up if it is long; returns whether it was."""
        with self._lock:
            if self._seconds <= LONG_S:
                return False
            self._dropped = self._began_s, self._seconds
            return True

    def is_dropped(self) -> bool:
        """Whether the frame that came is the one of an exposure given up; only one is."""
        with self._lock:
            was, self._dropped = self._dropped, None
            is_early = self._clock() < self._began_s + self._seconds
            return was is not None and (is_early or self._seconds <= LONG_S)


SLICE_S = 0.25
"""Longest wait for a frame in one go: however long the exposure, STOP is heard in between."""

RETRY_S = 1.0
STALL_S = 1.0
STALL_PERIODS = 5.0
STATISTICS_S = 1.0
RETURN_S = 5.0
"""A camera that was lost for less is expected back, as a busy computer loses it for a moment."""

CLOSE_TIMEOUT_S = 5.0
TURN_S = 0.005

USUAL_LIMITS_US = (20.0, 1e6)
"""Exposures of a camera that does not state its limits."""

LOST_REMEDY = (
    "Check the camera's power and network cable. The console keeps trying; no restart is needed."
)
ABSENT_REMEDY = (
    "Check the camera's power, cable and address, and that no other program is using it; "
    "the Doctor page says more. The console keeps trying."
)
DRIVER_REMEDY = "Install it, then start the console again."
FAULTS_OF_ITS_OWN = (CameraFeatureError, DeviceInUseError, DeviceProtocolError)
"""Of a camera that is there; neither its power nor its cable is to blame."""


class CameraService(Service):
    """The camera's only thread; it publishes every frame to the broadcaster.

    Opening is repeated until it succeeds. ``report`` is called with one line when the camera
    rejects a setting; one that was lost is expected back within ``return_s`` by whoever borrows it.

    ``settings`` and ``info`` are None until it is first opened; ``statistics`` are the stream's own
    counts, at most a second old.
    """

    def __init__(
        self,
        open_camera: Callable[[], Camera],
        broadcaster: FrameBroadcaster,
        *,
        report: Callable[[str], None] = lambda _: None,
        return_s: float = RETURN_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__("camera service", close_timeout_s=CLOSE_TIMEOUT_S)
        self.status = DeviceStatus(state="opening", text="The camera is being opened")
        self.settings: CameraSettings | None = None
        self.info: DeviceInfo | None = None
        self.statistics: StreamStatistics | None = None
        self.exposure_limits_us = USUAL_LIMITS_US
        self._open = open_camera
        self._broadcaster = broadcaster
        self._report = report
        self._return_s = return_s
        self._clock = clock
        self._camera: Camera | None = None
        self._wanted: dict[str, float] = {}
        self._requests: SimpleQueue[tuple[str, float]] = SimpleQueue()
        self._turn = Lock()
        self._wishes = 0
        self._counting = Lock()
        self._is_lent = False
        self._lost_s = -math.inf
        self._gone: Camera | None = None
        self._exposure = ExposureClock(clock)

    @property
    def is_expected(self) -> bool:
        """Whether it delivers frames, or did so a moment ago."""
        was_there = self.status.is_ready or self._clock() - self._lost_s < self._return_s
        return was_there and not self._is_closing.is_set()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the operator about network and settings."""
        return tuple(getattr(self._camera, "warnings", ()))

    def set_exposure_us(self, exposure_us: float) -> None:
        """Set the exposure before the next frame; `settings` shows the result."""
        self._requests.put(("exposure_us", exposure_us))

    def set_gain_db(self, gain_db: float) -> None:
        """Set the gain before the next frame."""
        self._requests.put(("gain_db", gain_db))

    @property
    def exposing(self) -> Exposing | None:
        """The long exposure that is waited for, if one is."""
        return self._exposure.view

    def break_off(self) -> None:
        """Break a long exposure off: the shorter exposure of before it is set again, at once."""
        self.set_exposure_us(self._exposure.shorter_us)

    @contextmanager
    def lent(self, check: Callable[[], None] = lambda: None) -> Iterator[Camera]:
        """Lend the camera; between a stop and the next start the live stream continues.

        A camera that was lost a moment ago is waited for; without one, this is refused. ``check``
        is called before each frame, and may raise to end the borrower's work.
        """
        lent = _LentCamera(self, self._present(check), check)
        self._is_lent = True
        try:
            yield lent
        finally:
            self._is_lent = False
            lent.give_back()

    # What follows is for the lent camera and the thread.

    def _is_present(self, camera: Camera) -> bool:
        """Whether this is the camera, and it delivers frames."""
        is_ours = camera is self._camera and camera is not self._gone
        return is_ours and self.status.is_ready

    def _present(self, check: Callable[[], None]) -> Camera:
        """Wait for the camera, if it is expected."""
        while True:
            camera = self._camera
            if camera is not None and self._is_present(camera):
                return camera
            if not self.is_expected:
                raise DeviceDisconnectedError(f"{self.status.text}. {self.status.remedy}")
            check()
            time.sleep(TURN_S)

    def _take_turn(self, check: Callable[[], None] = lambda: None) -> None:
        """End the live stream and hold the camera until `_give_turn`; ``check`` may raise."""
        with self._counting:
            self._wishes += 1
        try:
            while not self._turn.acquire(timeout=TURN_S):
                check()
        except BaseException:
            with self._counting:
                self._wishes -= 1
            raise

    def _give_turn(self) -> None:
        """Let the live stream continue, or whoever else waits for the camera."""
        with self._counting:
            self._wishes -= 1
        self._turn.release()

    def _saw(self, frame: Frame, camera: Camera) -> None:
        """Publish a frame, whoever fetched it."""
        self._broadcaster.publish(frame, camera.settings)

    def _waits(self, camera: Camera) -> None:
        """Note that a frame is being exposed from now on."""
        self._exposure.began(camera.settings.exposure_us)

    def _began(self, camera: Camera) -> None:
        """Note that the stream is running."""
        self._waits(camera)
        self.settings, self.info = camera.settings, camera.info
        self._broadcaster.stream_began()
        self.status = DeviceStatus(state="ready")

    def _lost(self, error: DeviceError, gone: Camera | None = None) -> None:
        """Note that the stream was lost; ``gone`` is closed and opened anew."""
        self._gone = gone or self._gone
        if self.status.is_ready:
            self._lost_s = self._clock()
        self._exposure.ended()
        remedy = LOST_REMEDY if self.settings is not None else ABSENT_REMEDY
        if isinstance(error, DriverMissingError):
            remedy = DRIVER_REMEDY
        elif isinstance(error, FAULTS_OF_ITS_OWN):
            advice = advice_on(error)
            remedy = f"{advice[0].upper()}{advice[1:]}. The console keeps trying."
        self.status = DeviceStatus(state="lost", text=str(error), remedy=remedy)

    def _run(self) -> None:
        while not self._is_closing.is_set():
            if self._wishes > 0:
                time.sleep(TURN_S)
                continue
            with self._turn:
                try:
                    self._live()
                except StreamInterruptedError as error:
                    self._lost(error)  # the next start reopens it with its settings
                except DeviceError as error:
                    self._lost(error)
                    # A job that it is lent to goes on with it, or fails by what it finds itself.
                    if not (self._is_lent and isinstance(error, DeviceTimeoutError)):
                        self._drop()
            if not self.status.is_ready:
                self._is_closing.wait(RETRY_S)
        with self._turn:
            self._drop()

    def _live(self) -> None:
        """Stream until somebody wants the camera."""
        camera = self._opened()
        if self._exposure.is_broken_off:
            self._apply_requests(camera)
        camera.start()
        self._began(camera)
        try:
            self._fetch(camera)
        except BaseException as error:
            try:
                camera.stop()
            except DeviceError as stop_error:
                error.add_note(f"stopping the stream failed too: {stop_error}")
            raise
        camera.stop()

    def _fetch(self, camera: Camera) -> None:
        """Fetch frames until somebody wants the camera, or not to wait for a long exposure."""
        asked_s = self._clock()
        waited_s = 0.0
        while not (self._wishes > 0 or self._is_closing.is_set()):
            if not self._requests.empty() and self._exposure.break_off():
                return
            self._apply_requests(camera)
            settings = camera.settings
            period_s = max(1 / settings.frame_rate_hz, 1e-6 * settings.exposure_us)
            try:
                frame = camera.next_frame(SLICE_S)
            except StreamInterruptedError:
                raise
            except DeviceTimeoutError:
                # The waits asked for: a machine that pauses this thread pauses the stream too.
                waited_s += SLICE_S
                stall_s = max(STALL_S, STALL_PERIODS * period_s)
                if waited_s >= stall_s and not self._exposure.is_broken_off:
                    raise
                continue
            waited_s = 0.0
            if not self._exposure.is_dropped():
                self._saw(frame, camera)
            self._waits(camera)
            now_s = self._clock()
            if now_s - asked_s > STATISTICS_S:
                asked_s, self.statistics = now_s, camera.statistics()

    def _opened(self) -> Camera:
        if self._camera is not None and self._camera is self._gone:
            self._drop()
        if self._camera is None:
            self._camera = self._open()
            self.settings, self.info = self._camera.settings, self._camera.info
            if isinstance(self._camera, LimitedExposureCamera):
                self.exposure_limits_us = self._camera.exposure_limits_us
            for name, value in self._wanted.items():
                self._set(self._camera, name, value)
        return self._camera

    def _drop(self) -> None:
        if self._camera is not None:
            camera, self._camera, self._gone = self._camera, None, None
            camera.close()

    def _apply_requests(self, camera: Camera) -> None:
        asked: dict[str, float] = {}
        while True:
            try:
                name, value = self._requests.get_nowait()
            except Empty:
                break
            asked[name] = value  # of several in a row, the last one counts
        for name, value in asked.items():
            self._set(camera, name, value)
        if asked:
            self._waits(camera)

    def _set(self, camera: Camera, name: str, value: float) -> None:
        try:
            if name == "exposure_us":
                self._wanted[name] = camera.set_exposure_us(value)
            else:
                self._wanted[name] = camera.set_gain_db(value)
        except DeviceDisconnectedError:
            raise
        except DeviceError as error:
            self._report(f"The camera rejected the setting: {error}")
        self.settings = camera.settings


class _LentCamera:
    """The `Camera` lent to a job: its frames reach all viewers, and it can be stopped.

    A stream that broke off, for whatever reason, is a `StreamInterruptedError`. The next `start`
    waits until the camera is back, as long as its owner expects it, and sets exposure and gain
    again.
    """

    def __init__(self, service: CameraService, camera: Camera, check: Callable[[], None]) -> None:
        self._service = service
        self._camera = camera
        self._check = check
        self._has_turn = False

    @property
    def info(self) -> DeviceInfo:
        return self._camera.info

    @property
    def settings(self) -> CameraSettings:
        return self._camera.settings

    def set_exposure_us(self, exposure_us: float) -> float:
        with self._paused():
            return self._camera.set_exposure_us(exposure_us)

    def set_gain_db(self, gain_db: float) -> float:
        with self._paused():
            return self._camera.set_gain_db(gain_db)

    def start(self) -> None:
        """Wait for the live stream to end, and for a camera that was lost; then start."""
        self._check()
        self._take(self._check)
        try:
            self._camera.start()
        except BaseException as error:
            if isinstance(error, DeviceDisconnectedError):
                self._service._lost(error)
            self.give_back()
            raise
        self._service._began(self._camera)

    def next_frame(self, timeout_s: float) -> Frame:
        left_s = timeout_s
        while True:
            self._check()
            wait_s = min(left_s, SLICE_S)
            try:
                frame = self._camera.next_frame(wait_s)
            except StreamInterruptedError as error:
                self._service._lost(error)
                raise
            except DeviceDisconnectedError as error:
                self._service._lost(error, self._camera)
                raise StreamInterruptedError(str(error)) from error
            except DeviceTimeoutError as error:
                left_s -= wait_s
                if left_s <= 0:
                    raise DeviceTimeoutError(
                        f"no frame from the camera within {timeout_s:g} s", timeout_s=timeout_s
                    ) from error
            else:
                self._service._saw(frame, self._camera)
                self._service._waits(self._camera)
                return frame

    def stop(self) -> None:
        if not self._has_turn:  # then it has no stream of its own
            return
        try:
            self._camera.stop()
        finally:
            self.give_back()

    def statistics(self) -> StreamStatistics:
        return self._camera.statistics()

    def close(self) -> None:
        self.give_back()

    def give_back(self) -> None:
        """Let the live stream continue; calling it twice is harmless."""
        if self._has_turn:
            self._has_turn = False
            self._service._give_turn()

    def _wait_for_return(self) -> None:
        """Take the camera that is there now in place of one that was lost, with its settings."""
        if self._service._is_present(self._camera):
            return
        before, info = self._camera.settings, self._camera.info
        self._camera = self._service._present(self._check)
        if self._camera.info != info:
            raise CameraFeatureError(
                f"another camera came back: {self._camera.info.model} "
                f"{self._camera.info.serial_number} in place of {info.model} {info.serial_number}",
                feature="DeviceSerialNumber",
            )
        now = self._camera.settings
        self._service._take_turn(self._check)
        try:
            if now.exposure_us != before.exposure_us:
                self._camera.set_exposure_us(before.exposure_us)
            if before.gain_db is not None and now.gain_db != before.gain_db:
                self._camera.set_gain_db(before.gain_db)
        finally:
            self._service._give_turn()

    def _take(self, check: Callable[[], None]) -> None:
        while not self._has_turn:
            self._wait_for_return()
            self._service._take_turn(check)
            self._has_turn = True
            if not self._service._is_present(self._camera):  # lost while its turn was waited for
                self.give_back()

    @contextmanager
    def _paused(self) -> Iterator[None]:
        had_turn = self._has_turn
        # Not broken off by a stop: whoever ends sets the exposure back that was there before.
        self._take(lambda: None)
        try:
            yield
        finally:
            if not had_turn:
                self.give_back()
