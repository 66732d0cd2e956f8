"""Owns the camera: streams all the time, lends it to a run, and reopens it when lost."""

import math
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
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceProtocolError,
    DeviceTimeoutError,
    DriverMissingError,
    StreamInterruptedError,
)
from standoff.console.devices.device_status import DeviceStatus
from standoff.console.devices.frame_broadcaster import FrameBroadcaster
from standoff.console.devices.lent_camera import SLICE_S, LentCamera
from standoff.console.devices.long_exposure import Exposing, ExposureClock
from standoff.doctor import advice_on

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
    return_s
        How long a camera that was lost is expected back by whoever borrows it.
    clock
        Monotonic time in seconds.
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
        self._open = open_camera
        self._broadcaster = broadcaster
        self._report = report
        self._return_s = return_s
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
        self._lost_s = -math.inf
        self._gone: Camera | None = None
        self._exposure = ExposureClock(clock)
        self._is_closing = Event()
        self._thread = Thread(target=self._run, name="camera service", daemon=True)

    @property
    def status(self) -> DeviceStatus:
        """Whether it delivers frames, and what to do if not."""
        return self._status

    @property
    def is_expected(self) -> bool:
        """Whether it delivers frames, or did so a moment ago."""
        was_there = self._status.is_ready or self._clock() - self._lost_s < self._return_s
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
        lent = LentCamera(self, self.present(check), check)
        self._is_lent = True
        try:
            yield lent
        finally:
            self._is_lent = False
            lent.give_back()

    # The methods below are for the lent camera and the thread.

    def is_present(self, camera: Camera) -> bool:
        """Whether this is the camera, and it delivers frames."""
        is_ours = camera is self._camera and camera is not self._gone
        return is_ours and self._status.is_ready

    def present(self, check: Callable[[], None]) -> Camera:
        """Wait for the camera, if it is expected.

        Raises
        ------
        DeviceDisconnectedError
            If no camera is connected.
        """
        while True:
            camera = self._camera
            if camera is not None and self.is_present(camera):
                return camera
            if not self.is_expected:
                raise DeviceDisconnectedError(f"{self._status.text}. {self._status.remedy}")
            check()
            time.sleep(TURN_S)

    def take_turn(self, check: Callable[[], None] = lambda: None) -> None:
        """End the live stream and hold the camera until `give_turn`; ``check`` may raise."""
        with self._counting:
            self._wishes += 1
        try:
            while not self._turn.acquire(timeout=TURN_S):
                check()
        except BaseException:
            with self._counting:
                self._wishes -= 1
            raise

    def give_turn(self) -> None:
        """Let the live stream continue, or whoever else waits for the camera."""
        with self._counting:
            self._wishes -= 1
        self._turn.release()

    def saw(self, frame: Frame, camera: Camera) -> None:
        """Publish a frame, whoever fetched it."""
        self._broadcaster.publish(frame, camera.settings)

    def waits(self, camera: Camera) -> None:
        """Note that a frame is being exposed from now on."""
        self._exposure.began(camera.settings.exposure_us)

    def began(self, camera: Camera) -> None:
        """Note that the stream is running."""
        self.waits(camera)
        self._settings, self._info = camera.settings, camera.info
        self._broadcaster.stream_began()
        self._status = DeviceStatus(state="ready")

    def lost(self, error: DeviceError, gone: Camera | None = None) -> None:
        """Note that the stream was lost; ``gone`` is closed and opened anew."""
        self._gone = gone or self._gone
        if self._status.is_ready:
            self._lost_s = self._clock()
        self._exposure.ended()
        remedy = LOST_REMEDY if self._settings is not None else ABSENT_REMEDY
        if isinstance(error, DriverMissingError):
            remedy = DRIVER_REMEDY
        elif isinstance(error, FAULTS_OF_ITS_OWN):
            advice = advice_on(error)
            remedy = f"{advice[0].upper()}{advice[1:]}. The console keeps trying."
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
        if self._exposure.is_broken_off:
            self._apply_requests(camera)
        camera.start()
        self.began(camera)
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
                self.saw(frame, camera)
            self.waits(camera)
            now_s = self._clock()
            if now_s - asked_s > STATISTICS_S:
                asked_s, self._statistics = now_s, camera.statistics()

    def _opened(self) -> Camera:
        if self._camera is not None and self._camera is self._gone:
            self._drop()
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
            self.waits(camera)

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
