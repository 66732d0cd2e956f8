"""Owns the camera: streams all the time, lends it to a run, and reopens it when lost."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread

from acquisition.devices import (
    Camera,
    CameraSettings,
    DeviceInfo,
    Frame,
    LimitedExposureCamera,
    StreamStatistics,
)
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    DeviceTimeoutError,
    DriverMissingError,
    StreamInterruptedError,
)
from standoff.console.devices.device_status import DeviceStatus
from standoff.console.devices.frame_broadcaster import FrameBroadcaster

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


class CameraService:
    """The camera's only thread; it publishes every frame to the broadcaster.

    Parameters
    ----------
    open_camera
        Opens and configures it; repeated until it succeeds.
    broadcaster
        Where every frame is published.
    report
        Called with one line when the camera rejects a setting.
    clock
        Monotonic time in seconds.
    """

    def __init__(
        self,
        open_camera: Callable[[], Camera],
        broadcaster: FrameBroadcaster,
        *,
        report: Callable[[str], None] = lambda _: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._open = open_camera
        self._broadcaster = broadcaster
        self._report = report
        self._clock = clock
        self._camera: Camera | None = None
        self._status = DeviceStatus(state="opening", text="The camera is being opened")
        self._statistics: StreamStatistics | None = None
        self._settings: CameraSettings | None = None
        self._info: DeviceInfo | None = None
        self._exposure_limits_us = USUAL_LIMITS_US
        self._wanted: dict[str, float] = {}
        self._requests: SimpleQueue[tuple[str, float]] = SimpleQueue()
        self._turn = Lock()
        self._wishes = 0
        self._counting = Lock()
        self._is_lent = False
        self._lost_s = -RETURN_S
        self._is_closing = Event()
        self._thread = Thread(target=self._run, name="camera service", daemon=True)

    @property
    def status(self) -> DeviceStatus:
        """Whether it delivers frames, and what to do if not."""
        return self._status

    @property
    def is_expected(self) -> bool:
        """Whether it delivers frames, or did so a moment ago."""
        was_there = self._status.is_ready or self._clock() - self._lost_s < RETURN_S
        return was_there and not self._is_closing.is_set()

    @property
    def settings(self) -> CameraSettings | None:
        """Settings as read back; None until it is first opened."""
        return self._settings

    @property
    def info(self) -> DeviceInfo | None:
        """Identity of the camera; None until it is first opened."""
        return self._info

    @property
    def exposure_limits_us(self) -> tuple[float, float]:
        """Shortest and longest exposure that it states, or usual ones."""
        return self._exposure_limits_us

    @property
    def statistics(self) -> StreamStatistics | None:
        """The stream's own counts, at most a second old; None before the first frames."""
        return self._statistics

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the operator about network and settings."""
        return tuple(getattr(self._camera, "warnings", ()))

    def start(self) -> None:
        """Start streaming, in a thread."""
        self._thread.start()

    def close(self) -> None:
        """End the stream and release the camera, within a few seconds."""
        self._is_closing.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE_TIMEOUT_S)

    def set_exposure_us(self, exposure_us: float) -> None:
        """Set the exposure before the next frame; `settings` shows the result."""
        self._requests.put(("exposure_us", exposure_us))

    def set_gain_db(self, gain_db: float) -> None:
        """Set the gain before the next frame."""
        self._requests.put(("gain_db", gain_db))

    @contextmanager
    def lent(self, check: Callable[[], None] = lambda: None) -> Iterator[Camera]:
        """Lend the camera; between a stop and the next start the live stream continues.

        A camera that was lost a moment ago is waited for.

        Parameters
        ----------
        check
            Called before each frame; may raise to end the borrower's work.

        Raises
        ------
        DeviceDisconnectedError
            If no camera is connected.
        """
        while (camera := self._camera) is None or not self._status.is_ready:
            if not self.is_expected:
                raise DeviceDisconnectedError(f"{self._status.text}. {self._status.remedy}")
            check()
            time.sleep(TURN_S)
        lent = _LentCamera(self, camera, check)
        self._is_lent = True
        try:
            yield lent
        finally:
            self._is_lent = False
            lent.give_back()

    # The methods below are for the lent camera and the thread.

    def take_turn(self) -> None:
        """End the live stream and hold the camera until `give_turn`."""
        with self._counting:
            self._wishes += 1
        self._turn.acquire()

    def give_turn(self) -> None:
        """Let the live stream continue, or whoever else waits for the camera."""
        with self._counting:
            self._wishes -= 1
        self._turn.release()

    def saw(self, frame: Frame, camera: Camera) -> None:
        """Publish a frame, whoever fetched it."""
        self._broadcaster.publish(frame, camera.settings)

    def began(self, camera: Camera) -> None:
        """Note that the stream is running."""
        self._settings, self._info = camera.settings, camera.info
        self._broadcaster.stream_began()
        self._status = DeviceStatus(state="ready")

    def lost(self, error: DeviceError) -> None:
        """Note that the stream was lost."""
        if self._status.is_ready:
            self._lost_s = self._clock()
        remedy = LOST_REMEDY if self._settings is not None else ABSENT_REMEDY
        if isinstance(error, DriverMissingError):
            remedy = DRIVER_REMEDY
        self._status = DeviceStatus(state="lost", text=str(error), remedy=remedy)

    def _run(self) -> None:
        while not self._is_closing.is_set():
            if self._wishes > 0:
                time.sleep(TURN_S)
                continue
            with self._turn:
                try:
                    self._live()
                except StreamInterruptedError as error:
                    self.lost(error)  # the next start reopens it with its settings
                except DeviceError as error:
                    self.lost(error)
                    # A job that it is lent to goes on with it, or fails by what it finds itself.
                    if not (self._is_lent and isinstance(error, DeviceTimeoutError)):
                        self._drop()
            if not self._status.is_ready:
                self._is_closing.wait(RETRY_S)
        with self._turn:
            self._drop()

    def _live(self) -> None:
        """Stream until somebody wants the camera."""
        camera = self._opened()
        camera.start()
        self.began(camera)
        try:
            asked_s = self._clock()
            waited_s = 0.0
            while not (self._wishes > 0 or self._is_closing.is_set()):
                self._apply_requests(camera)
                settings = camera.settings
                period_s = max(1 / settings.frame_rate_hz, 1e-6 * settings.exposure_us)
                timeout_s = max(0.25, 2 * period_s)
                try:
                    frame = camera.next_frame(timeout_s)
                except StreamInterruptedError:
                    raise
                except DeviceTimeoutError:
                    # The waits asked for: a machine that pauses this thread pauses the stream too.
                    waited_s += timeout_s
                    if waited_s >= max(STALL_S, STALL_PERIODS * period_s):
                        raise
                    continue
                waited_s = 0.0
                self.saw(frame, camera)
                now_s = self._clock()
                if now_s - asked_s > STATISTICS_S:
                    asked_s, self._statistics = now_s, camera.statistics()
        except BaseException as error:
            try:
                camera.stop()
            except DeviceError as stop_error:
                error.add_note(f"stopping the stream failed too: {stop_error}")
            raise
        camera.stop()

    def _opened(self) -> Camera:
        if self._camera is None:
            self._camera = self._open()
            self._settings, self._info = self._camera.settings, self._camera.info
            if isinstance(self._camera, LimitedExposureCamera):
                self._exposure_limits_us = self._camera.exposure_limits_us
            for name, value in self._wanted.items():
                self._set(self._camera, name, value)
        return self._camera

    def _drop(self) -> None:
        if self._camera is not None:
            camera, self._camera = self._camera, None
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
        self._settings = camera.settings


class _LentCamera:
    """The `Camera` lent to a run: its frames reach all viewers, and it can be stopped."""

    def __init__(self, service: CameraService, camera: Camera, check: Callable[[], None]) -> None:
        self._service = service
        self._camera = camera
        self._check = check
        self._has_turn = False

    @property
    def info(self) -> DeviceInfo:
        """See `Camera.info`."""
        return self._camera.info

    @property
    def settings(self) -> CameraSettings:
        """See `Camera.settings`."""
        return self._camera.settings

    def set_exposure_us(self, exposure_us: float) -> float:
        """See `Camera.set_exposure_us`."""
        with self._paused():
            return self._camera.set_exposure_us(exposure_us)

    def set_gain_db(self, gain_db: float) -> float:
        """See `Camera.set_gain_db`."""
        with self._paused():
            return self._camera.set_gain_db(gain_db)

    def start(self) -> None:
        """See `Camera.start`; waits for the live stream to end."""
        self._check()
        self._take()
        try:
            self._camera.start()
        except BaseException as error:
            if isinstance(error, DeviceDisconnectedError):
                self._service.lost(error)
            self.give_back()
            raise
        self._service.began(self._camera)

    def next_frame(self, timeout_s: float) -> Frame:
        """See `Camera.next_frame`."""
        self._check()
        try:
            frame = self._camera.next_frame(timeout_s)
        except DeviceDisconnectedError as error:
            self._service.lost(error)
            raise
        self._service.saw(frame, self._camera)
        return frame

    def stop(self) -> None:
        """See `Camera.stop`."""
        try:
            self._camera.stop()
        finally:
            if self._service.status.is_ready:
                self.give_back()

    def statistics(self) -> StreamStatistics:
        """See `Camera.statistics`."""
        return self._camera.statistics()

    def close(self) -> None:
        """Give it back to the service."""
        self.give_back()

    def give_back(self) -> None:
        """Let the live stream continue; calling it twice is harmless."""
        if self._has_turn:
            self._has_turn = False
            self._service.give_turn()

    def _take(self) -> None:
        if not self._has_turn:
            self._service.take_turn()
            self._has_turn = True

    @contextmanager
    def _paused(self) -> Iterator[None]:
        had_turn = self._has_turn
        self._take()
        try:
            yield
        finally:
            if not had_turn:
                self.give_back()
