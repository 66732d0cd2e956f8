"""Live guidance: the newest frame of the phone is judged, older ones are passed over."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf
from threading import Thread

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.errors import ApplicationError
from analysis.pose import PoseFollower, RadialTerm, straightened
from calibration.errors import RegistrationError
from simulation.arrays import FloatArray
from simulation.pose import project
from standoff.console.guide._assessment import UNSURE_UP_TO, Assessment, Judge, is_steady
from standoff.console.guide._own_psf import FineFrame, FrameCurve, OwnPsf
from standoff.console.guide._reference import FRAME_PX
from standoff.console.photographs import JpegError, jpeg_size

ByteImage = NDArray[np.uint8]

MOST_FRAME_BYTES = 512 * 1024
_SIDES_PX = range(96, 1025)
_STALE_S = 1.0
"""From frames further apart no motion is told."""

_APPROACH_S = 10.0
"""Without a frame, after which an approach has ended: its camera may have been focused anew."""

_MOST_PHONES = 16
"""That are told apart; the one that was heard longest ago is forgotten for one more."""


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
    if found is None or found.shape != size[::-1]:
        raise FrameError("the frame is damaged")
    factor = FRAME_PX / max(size)
    if factor != 1:
        scaled = [max(round(factor * side), 1) for side in size]
        found = cv2.resize(found, scaled, interpolation=cv2.INTER_LINEAR)
    return np.asarray(found, np.uint8)


@dataclass(slots=True)
class _Phone:
    """What is kept of one phone: who follows it, its newest frame's number, when its last pose was.

    Each is followed by itself: what another one shows takes no pose from it. ``own`` is of the
    approach that it is on, as ``lens``; ``heard_s`` is when its newest frame was taken.
    """

    own: OwnPsf
    lens: RadialTerm = field(default_factory=RadialTerm)
    heard_s: float = -inf
    follower: PoseFollower | None = None
    newest: int = 0
    before: tuple[float, FloatArray] | None = None


class LiveGuidance:
    """Judges one frame at a time, always the newest of a phone, and the phones in turn.

    ``clock`` tells the seconds at which frames were taken whose phone does not tell.
    """

    def __init__(self, judge: Judge, clock: Callable[[], float] = time.monotonic) -> None:
        self._judge = judge
        self._clock = clock
        self._turn = asyncio.Lock()
        self._phones: dict[str, _Phone] = {}
        self._measuring: Thread | None = None
        self._first: PoseFollower | None = self._new_follower()  # before anybody waits

    async def judged(
        self, data: bytes, *, phone: str = "", taken_s: float | None = None, is_fine: bool = False
    ) -> Assessment | None:
        """Judge a frame of a phone; None if a newer one of it came while it waited.

        ``is_fine``: whether it is hardly compressed, as was asked for.
        """
        known = self._known(phone)
        known.newest += 1
        mine = known.newest
        async with self._turn:
            if mine != known.newest:
                return None
            return await asyncio.to_thread(self._look, data, known, taken_s, is_fine)

    def look(
        self, data: bytes, *, phone: str = "", taken_s: float | None = None, is_fine: bool = False
    ) -> Assessment:
        """Judge one frame, from its JPEG file, taken at ``taken_s`` of its phone's clock."""
        return self._look(data, self._known(phone), taken_s, is_fine)

    def judge_of(self, phone: str) -> Judge:
        """Who judges a still of this phone: by what its frames have told so far."""
        return self._judge.by_frames(self.frame_curve_of(phone))

    def frame_curve_of(self, phone: str) -> FrameCurve | None:
        """What the frames of this phone have told of its camera so far; None if nothing."""
        known = self._phones.get(phone)
        return None if known is None else known.own.found

    def wait(self, timeout_s: float) -> None:
        """Wait for the measurement that is at work, if one is."""
        if self._measuring is not None:
            self._measuring.join(timeout_s)

    def _look(self, data: bytes, known: _Phone, taken_s: float | None, is_fine: bool) -> Assessment:
        levels = decoded_frame(data)
        now_s = self._clock() if taken_s is None else taken_s
        if not 0 <= now_s - known.heard_s < _APPROACH_S:  # what it showed before may be long ago
            known.own, known.lens = OwnPsf(self._judge.reference), RadialTerm()
        known.heard_s = now_s
        before, known.before = known.before, None
        follower = known.follower = known.follower or self._new_follower()
        try:
            found = follower.update(levels)
        except RegistrationError:  # a covered lens
            follower.reset()
            return self._judge.lost()
        if found.pose is None:
            return self._judge.lost()
        rows, cols = levels.shape
        matrix = known.lens.without(found.pose, (rows, cols))
        now = now_s, matrix
        motion = _motion(before, now, levels.shape)
        judge = self._judge.by_frames(known.own.found)
        assessed = judge.judged(straightened(levels, known.lens.k1), matrix, motion=motion)
        if assessed.deviation is None:
            follower.reset()
            return assessed
        known.before = now
        if assessed.deviation.largest_cost <= UNSURE_UP_TO:
            known.lens.add(found.pose, (rows, cols))
        if judge.has_curve or not is_steady(motion):
            return assessed
        own, zoom = known.own, found.pose.zoom
        if is_fine and max(jpeg_size(data)) >= FRAME_PX:
            own.add(FineFrame(levels=levels, zoom=zoom))
        if own.is_due:
            self._measuring = Thread(target=own.measure, name="own psf", daemon=True)
            self._measuring.start()
        return replace(assessed, wants_fine=own.wants(zoom))

    def _known(self, phone: str) -> _Phone:
        known = self._phones.pop(phone, None)
        if known is None:
            if len(self._phones) >= _MOST_PHONES:
                del self._phones[next(iter(self._phones))]
            known = _Phone(OwnPsf(self._judge.reference))
            known.follower, self._first = self._first, None
        self._phones[phone] = known  # the last one is the one that was heard last
        return known

    def _new_follower(self) -> PoseFollower:
        """A follower of the reference, whose features it has found."""
        made = PoseFollower(self._judge.reference.levels)
        made.update(self._judge.reference.levels)
        made.reset()
        return made


def _motion(
    before: tuple[float, FloatArray] | None, now: tuple[float, FloatArray], shape: tuple[int, ...]
) -> float | None:
    """Speed of the picture's middle since the frame before, in frames a second; None if unknown."""
    if before is None or not 0 < now[0] - before[0] < _STALE_S:
        return None
    rows, cols = shape
    middle = np.array([(cols - 1) / 2]), np.array([(rows - 1) / 2])
    x, y = project(np.asarray(np.linalg.inv(now[1]) @ before[1], np.float64), *middle)
    moved = np.hypot(x - middle[0], y - middle[1])
    return float(moved[0]) / max(rows, cols) / (now[0] - before[0])
