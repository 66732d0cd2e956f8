"""The newest frame of the camera, for any number of viewers, none of which delays the camera."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Condition

from acquisition.devices import CameraSettings, Frame, FrameImage

LAST_FRAME_ID = 65535
"""Block ids of GigE Vision have 16 bits; 0 is not used."""

RATED_FRAMES = 60


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LiveFrame:
    """A complete frame, numbered from 1 in order of arrival, with its camera settings.

    ``received_s`` is Unix time, ``arrived_s`` the same on the monotonic clock, for its age.
    """

    image_dn: FrameImage
    sequence: int
    received_s: float
    settings: CameraSettings
    arrived_s: float = field(default_factory=time.monotonic)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameCounts:
    """Frames since the console was started.

    ``lost`` counts ids that never came, within one start of the stream.
    """

    complete: int = 0
    incomplete: int = 0
    lost: int = 0
    rate_hz: float = 0.0


class FrameBroadcaster:
    """Takes every frame from the thread that owns the camera and provides the newest.

    Parameters
    ----------
    clock
        Unix time in seconds.
    """

    def __init__(self, *, clock: Callable[[], float] = time.time) -> None:
        self._clock = clock
        self._changed = Condition()
        self._latest: LiveFrame | None = None
        self._listeners: list[Callable[[], None]] = []
        self._last_id: int | None = None
        self._complete = self._incomplete = self._lost = 0
        self._arrivals_s: deque[float] = deque(maxlen=RATED_FRAMES)

    @property
    def latest(self) -> LiveFrame | None:
        """The newest complete frame, or None before the first."""
        return self._latest

    @property
    def counts(self) -> FrameCounts:
        """Frames so far, and the rate of the last ones."""
        with self._changed:
            arrivals_s = list(self._arrivals_s)
            rate_hz = 0.0
            if len(arrivals_s) > 1 and self._clock() - arrivals_s[-1] < 2.0:
                span_s = arrivals_s[-1] - arrivals_s[0]
                rate_hz = (len(arrivals_s) - 1) / span_s if span_s > 0 else 0.0
            return FrameCounts(
                complete=self._complete,
                incomplete=self._incomplete,
                lost=self._lost,
                rate_hz=rate_hz,
            )

    @property
    def period_s(self) -> float:
        """Time from one frame to the next to be expected: as the last ones, or as exposed."""
        with self._changed:
            arrivals_s, latest = list(self._arrivals_s), self._latest
        mean_s = exposure_s = 0.0
        if len(arrivals_s) > 1:
            mean_s = (arrivals_s[-1] - arrivals_s[0]) / (len(arrivals_s) - 1)
        if latest is not None:
            exposure_s = 1e-6 * latest.settings.exposure_us
        return max(mean_s, exposure_s)

    def stream_began(self) -> None:
        """Note that the camera was started: its ids restart."""
        with self._changed:
            self._last_id = None
            self._arrivals_s.clear()

    def publish(self, frame: Frame, settings: CameraSettings) -> None:
        """Count a frame, and publish it if it is complete."""
        with self._changed:
            if self._last_id is not None:
                self._lost += _ids_between(self._last_id, frame.frame_id)
            self._last_id = frame.frame_id
            if not frame.is_complete:
                self._incomplete += 1
                return
            self._complete += 1
            now_s = self._clock()
            self._arrivals_s.append(now_s)
            self._latest = LiveFrame(
                image_dn=frame.image_dn,
                sequence=self._complete,
                received_s=now_s,
                settings=settings,
            )
            self._changed.notify_all()
            listeners = tuple(self._listeners)
        for listener in listeners:
            listener()

    def wait_newer(self, sequence: int, timeout_s: float) -> LiveFrame | None:
        """Wait for a frame after ``sequence``; None if there was none within ``timeout_s``."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._latest is not None and self._latest.sequence > sequence, timeout_s
            )
            latest = self._latest
        return latest if latest is not None and latest.sequence > sequence else None

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call ``listener`` at each frame, in the camera's thread; it must not block.

        Returns
        -------
        callable
            Ends the subscription; calling it twice is harmless.
        """
        with self._changed:
            self._listeners.append(listener)

        def end() -> None:
            with self._changed:
                if listener in self._listeners:
                    self._listeners.remove(listener)

        return end


def _ids_between(last: int, this: int) -> int:
    """Number of frame ids missing between two frames; 0 if the id goes backwards."""
    step = (this - last) % LAST_FRAME_ID
    return step - 1 if 1 <= step < LAST_FRAME_ID // 2 else 0
