"""The newest frame of a running camera, for whoever looks at it live and is slower than it."""

from collections.abc import Generator

from acquisition.devices import Camera, Frame
from acquisition.errors import DeviceTimeoutError, StreamInterruptedError

__all__ = ["newest_frames"]

_FRAME_PERIODS = 5.0
_WAITING_S = 1e-3
_WAITING_FRAMES = 64
"""As many as a driver may hold ready; a camera that is faster than this loop does not block it."""


def newest_frames(camera: Camera) -> Generator[Frame, None, None]:
    """Stream, and give the newest complete frame each time one is asked for, until closed.

    Frames that came meanwhile are left out. The stream is stopped when the iterator is closed.

    Raises
    ------
    DeviceError
        If the camera fails; a stream that broke off is begun once more.
    """
    settings = camera.settings
    timeout_s = max(1.0, _FRAME_PERIODS / settings.frame_rate_hz, 3e-6 * settings.exposure_us)
    camera.start()
    try:
        while True:
            frame = _newest(camera, timeout_s)
            if frame.is_complete:
                yield frame
    finally:
        camera.stop()


def _newest(camera: Camera, timeout_s: float) -> Frame:
    try:
        newest = camera.next_frame(timeout_s)
    except StreamInterruptedError:
        camera.start()
        newest = camera.next_frame(timeout_s)
    for _ in range(_WAITING_FRAMES):
        try:
            frame = camera.next_frame(_WAITING_S)
        except StreamInterruptedError:
            camera.start()
            break
        except DeviceTimeoutError:
            break
        if frame.is_complete:
            newest = frame
    return newest
