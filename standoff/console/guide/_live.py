"""Live guidance: the newest frame of the phone is judged, older ones are passed over."""

import asyncio
import time
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.errors import ApplicationError
from analysis.pose import PoseFollower
from calibration.errors import RegistrationError
from simulation.arrays import FloatArray
from simulation.pose import project
from standoff.console.guide._assessment import Assessment, Judge
from standoff.console.guide._jpeg import JpegError, jpeg_size
from standoff.console.guide._reference import FRAME_PX

ByteImage = NDArray[np.uint8]

MOST_FRAME_BYTES = 512 * 1024
_SIDES_PX = range(96, 1025)
_STALE_S = 1.0
"""From frames further apart no motion is told."""


class FrameError(ApplicationError):
    """What was sent is no frame of a camera."""


def decoded_frame(data: bytes) -> ByteImage:
    """Decode a JPEG frame to grey levels, shape ``(rows, cols)``; its header is checked first.

    The longer side is brought to 640 px, so that the pose is followed on where a phone sends
    smaller frames over a slower link.
    """
    try:
        size = jpeg_size(data)
    except JpegError as error:
        raise FrameError("a frame is a JPEG file") from error
    if not all(side in _SIDES_PX for side in size):
        raise FrameError(
            f"a frame has {_SIDES_PX.start} to {_SIDES_PX.stop - 1} px a side, got "
            f"{size[0]} x {size[1]}"
        )
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    found = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if found is None:
        raise FrameError("the frame is damaged")
    factor = FRAME_PX / max(size)
    if factor != 1:
        scaled = [max(round(factor * side), 1) for side in size]
        found = cv2.resize(found, scaled, interpolation=cv2.INTER_LINEAR)
    return np.asarray(found, np.uint8)


class LiveGuidance:
    """Judges one frame at a time, always the newest; one camera is followed.

    ``clock`` tells seconds.
    """

    def __init__(self, judge: Judge, clock: Callable[[], float] = time.monotonic) -> None:
        self._judge = judge
        self._clock = clock
        self._follower = PoseFollower(judge.reference.levels)
        self._turn = asyncio.Lock()
        self._newest = 0
        self._before: tuple[float, FloatArray] | None = None
        self._follower.update(judge.reference.levels)  # its features, before anybody waits
        self._follower.reset()

    async def judged(self, data: bytes) -> Assessment | None:
        """Judge a frame; None if a newer one came while it waited."""
        self._newest += 1
        mine = self._newest
        async with self._turn:
            if mine != self._newest:
                return None
            return await asyncio.to_thread(self.look, data)

    def look(self, data: bytes) -> Assessment:
        """Judge one frame, from its JPEG file."""
        levels = decoded_frame(data)
        try:
            found = self._follower.update(levels)
        except RegistrationError:  # a covered lens
            self._follower.reset()
            self._before = None
            return self._judge.lost()
        if found.pose is None:
            self._before = None
            return self._judge.lost()
        matrix = found.pose.matrix
        assessed = self._judge.judged(levels, matrix, motion=self._motion(matrix, levels.shape))
        if assessed.deviation is None:
            self._follower.reset()
            self._before = None
        return assessed

    def _motion(self, matrix: FloatArray, shape: tuple[int, ...]) -> float:
        """Speed of the picture's middle since the frame before, in frames a second."""
        now_s, before = self._clock(), self._before
        self._before = now_s, matrix
        if before is None or not 0 < now_s - before[0] < _STALE_S:
            return 0.0
        rows, cols = shape
        middle = np.array([(cols - 1) / 2]), np.array([(rows - 1) / 2])
        x, y = project(np.asarray(np.linalg.inv(matrix) @ before[1], np.float64), *middle)
        moved = np.hypot(x - middle[0], y - middle[1])
        return float(moved[0]) / max(rows, cols) / (now_s - before[0])
