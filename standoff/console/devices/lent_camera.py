"""The camera as a job has it: all see its frames, STOP is heard, and a loss is waited for."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from acquisition.devices import Camera, CameraSettings, DeviceInfo, Frame, StreamStatistics
from acquisition.errors import (
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceTimeoutError,
    StreamInterruptedError,
)

SLICE_S = 0.25
"""Longest wait for a frame in one go: however long the exposure, STOP is heard in between."""


class CameraLender(Protocol):
    """Who owns the camera and lends it."""

    def is_present(self, camera: Camera) -> bool:
        """Whether this is the camera, and it delivers frames."""
        ...

    def present(self, check: Callable[[], None]) -> Camera:
        """The camera as soon as it delivers frames."""
        ...

    def take_turn(self, check: Callable[[], None]) -> None:
        """End the live stream."""
        ...

    def give_turn(self) -> None:
        """Let the live stream continue."""
        ...

    def saw(self, frame: Frame, camera: Camera) -> None:
        """Publish a frame."""
        ...

    def waits(self, camera: Camera) -> None:
        """Note that a frame is being exposed from now on."""
        ...

    def began(self, camera: Camera) -> None:
        """Note that the stream is running."""
        ...

    def lost(self, error: DeviceError, gone: Camera | None = None) -> None:
        """Note that the stream was lost; ``gone`` must be opened anew."""
        ...


class LentCamera:
    """The `Camera` lent to a job: its frames reach all viewers, and it can be stopped.

    A stream that broke off, for whatever reason, is a `StreamInterruptedError`. The next `start`
    waits until the camera is back, as long as its owner expects it, and sets exposure and gain
    again.

    Parameters
    ----------
    lender
        Owns the camera.
    camera
        The one that it has now.
    check
        Called while something is waited for; may raise to end the borrower's work.
    """

    def __init__(self, lender: CameraLender, camera: Camera, check: Callable[[], None]) -> None:
        self._lender = lender
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
        """See `Camera.start`; waits for the live stream to end, and for a camera that was lost."""
        self._check()
        self._take(self._check)
        try:
            self._camera.start()
        except BaseException as error:
            if isinstance(error, DeviceDisconnectedError):
                self._lender.lost(error)
            self.give_back()
            raise
        self._lender.began(self._camera)

    def next_frame(self, timeout_s: float) -> Frame:
        """See `Camera.next_frame`.

        Raises
        ------
        StreamInterruptedError
            If the camera was lost: start it again.
        """
        left_s = timeout_s
        while True:
            self._check()
            wait_s = min(left_s, SLICE_S)
            try:
                frame = self._camera.next_frame(wait_s)
            except StreamInterruptedError as error:
                self._lender.lost(error)
                raise
            except DeviceDisconnectedError as error:
                self._lender.lost(error, self._camera)
                raise StreamInterruptedError(str(error)) from error
            except DeviceTimeoutError as error:
                left_s -= wait_s
                if left_s <= 0:
                    raise DeviceTimeoutError(
                        f"no frame from the camera within {timeout_s:g} s", timeout_s=timeout_s
                    ) from error
            else:
                self._lender.saw(frame, self._camera)
                self._lender.waits(self._camera)
                return frame

    def stop(self) -> None:
        """See `Camera.stop`; without its turn it has no stream of its own to stop."""
        if not self._has_turn:
            return
        try:
            self._camera.stop()
        finally:
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
            self._lender.give_turn()

    def _wait_for_return(self) -> None:
        """Take the camera that is there now in place of one that was lost, with its settings."""
        if self._lender.is_present(self._camera):
            return
        before, info = self._camera.settings, self._camera.info
        self._camera = self._lender.present(self._check)
        if self._camera.info != info:
            raise CameraFeatureError(
                f"another camera came back: {self._camera.info.model} "
                f"{self._camera.info.serial_number} in place of {info.model} {info.serial_number}",
                feature="DeviceSerialNumber",
            )
        now = self._camera.settings
        self._lender.take_turn(self._check)
        try:
            if now.exposure_us != before.exposure_us:
                self._camera.set_exposure_us(before.exposure_us)
            if before.gain_db is not None and now.gain_db != before.gain_db:
                self._camera.set_gain_db(before.gain_db)
        finally:
            self._lender.give_turn()

    def _take(self, check: Callable[[], None]) -> None:
        while not self._has_turn:
            self._wait_for_return()
            self._lender.take_turn(check)
            self._has_turn = True
            if not self._lender.is_present(self._camera):  # lost while its turn was waited for
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
