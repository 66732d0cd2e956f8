"""Frames of the camera for any number of viewers: the newest, its levels, and as it is sent."""

import math
import struct
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Condition, Lock

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from acquisition.devices import CameraSettings, Frame, FrameImage
from simulation.arrays import FloatArray

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
    """Takes every frame from the thread that owns the camera; ``latest`` is None before the first.

    The clock gives Unix time in seconds.
    """

    def __init__(self, *, clock: Callable[[], float] = time.time) -> None:
        self._clock = clock
        self._changed = Condition()
        self.latest: LiveFrame | None = None
        self._listeners: list[Callable[[], None]] = []
        self._last_id: int | None = None
        self._complete = self._incomplete = self._lost = 0
        self._arrivals_s: deque[float] = deque(maxlen=RATED_FRAMES)

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
            arrivals_s, latest = list(self._arrivals_s), self.latest
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
            self.latest = LiveFrame(
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
                lambda: self.latest is not None and self.latest.sequence > sequence, timeout_s
            )
            latest = self.latest
        return latest if latest is not None and latest.sequence > sequence else None

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call ``listener`` at each frame, in the camera's thread, until the result is called.

        It must not block.
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


AROUND_PX = 2
"""Pixels on each side of one that are averaged with it: 5 x 5."""

MOST_SAMPLES = 2000

Point = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelReading:
    """Level of a pixel, and the mean of it and its neighbours (5 x 5, less at the border)."""

    level_dn: int
    mean_dn: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LineProfile:
    """Levels at equal distances along a line of ``length_px``, both of its ends included."""

    levels_dn: FloatArray
    length_px: float


def pixel_reading(frame: LiveFrame, x_px: int, y_px: int) -> PixelReading | None:
    """Read a pixel; the upper left one is at 0, 0. None if it is not in the frame."""
    image_dn = frame.image_dn
    rows, cols = image_dn.shape
    if not (0 <= x_px < cols and 0 <= y_px < rows):
        return None
    around = image_dn[
        max(y_px - AROUND_PX, 0) : y_px + AROUND_PX + 1,
        max(x_px - AROUND_PX, 0) : x_px + AROUND_PX + 1,
    ]
    return PixelReading(level_dn=int(image_dn[y_px, x_px]), mean_dn=float(around.mean()))


def line_profile(frame: LiveFrame, start: Point, end: Point) -> LineProfile | None:
    """Sample a line bilinearly, at most one pixel apart unless it is longer than `MOST_SAMPLES`.

    Ends are x and y in px, with pixel centres at integers; None if one is not in the frame.
    """
    rows, cols = frame.image_dn.shape
    for x_px, y_px in (start, end):
        if not (-0.5 <= x_px <= cols - 0.5 and -0.5 <= y_px <= rows - 0.5):
            return None
    length_px = math.dist(start, end)
    count = min(max(math.ceil(length_px) + 1, 2), MOST_SAMPLES)
    across, down = (np.linspace(*pair, count) for pair in zip(start, end, strict=True))
    levels = map_coordinates(
        frame.image_dn, [down, across], output=np.float64, order=1, mode="nearest"
    )
    return LineProfile(levels_dn=levels, length_px=length_px)


HEADER = struct.Struct("<4sIdHHI")
"""Magic, sequence, time of arrival in ms since 1970, columns, rows, bytes of the JPEG."""

EXACT, COMPRESSED = b"SOF1", b"SOF2"
"""Then follow the pixels row by row; or a JPEG, which may have fewer pixels, and a PNG of its size
whose white pixels are saturated, of no bytes where none are."""

SATURATED = 255
"""A pixel at the largest level; every other pixel is at most one less."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureForm:
    """How pixels are sent: each as it is where there is no ``quality``, which is JPEG's.

    One pixel is sent for each square of ``reduction`` pixels. Pictures of this form may come as
    seldom as every ``period_s``; where the link is slower, a smaller form serves better.
    ``bytes_per_px`` of the frame is the size to be expected before the first.
    """

    quality: int | None
    reduction: int
    period_s: float
    bytes_per_px: float


FORMS = (
    PictureForm(quality=None, reduction=1, period_s=0.1, bytes_per_px=1.0),
    PictureForm(quality=90, reduction=1, period_s=0.07, bytes_per_px=0.35),
    PictureForm(quality=70, reduction=1, period_s=0.07, bytes_per_px=0.2),
    PictureForm(quality=45, reduction=1, period_s=0.07, bytes_per_px=0.13),
    PictureForm(quality=70, reduction=2, period_s=0.25, bytes_per_px=0.05),
    PictureForm(quality=45, reduction=2, period_s=0.4, bytes_per_px=0.035),
    PictureForm(quality=45, reduction=4, period_s=0.5, bytes_per_px=0.01),
    PictureForm(quality=45, reduction=8, period_s=0.5, bytes_per_px=0.003),
)
"""From the best to the smallest."""


def levels_8bit(image_dn: FrameImage, max_level_dn: int) -> NDArray[np.uint8]:
    """Scale levels to 0 to 254, with 255 for saturated pixels; the shape is kept."""
    scaled = cv2.convertScaleAbs(image_dn, alpha=(SATURATED - 1) / max_level_dn)
    shown = np.minimum(scaled, SATURATED - 1, dtype=np.uint8)
    np.putmask(shown, image_dn >= max_level_dn, SATURATED)
    return shown


class PictureEncoder:
    """Encodes each frame once in each form, for however many viewers."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._sequence = 0
        self._pixels: NDArray[np.uint8] = np.empty((0, 0), np.uint8)
        self._encoded: dict[PictureForm, bytes] = {}
        self._bytes_per_px: dict[PictureForm, float] = {}
        self._detail = 1.0  # how much larger pictures are than was to be expected

    def encode(self, frame: LiveFrame, form: PictureForm = FORMS[0]) -> bytes:
        """Return header and pixels of a frame."""
        with self._lock:
            if frame.sequence != self._sequence:
                self._pixels = levels_8bit(frame.image_dn, frame.settings.max_level_dn)
                self._sequence, self._encoded = frame.sequence, {}
            if form not in self._encoded:
                data = _encoded(self._pixels, frame, form)
                self._encoded[form] = data
                self._bytes_per_px[form] = len(data) / self._pixels.size
                if form.quality is not None:
                    self._detail = self._bytes_per_px[form] / form.bytes_per_px
            return self._encoded[form]

    def size_bytes(self, frame: LiveFrame, form: PictureForm) -> float:
        """Size to be expected of a frame in a form, by the last one that was encoded so."""
        guess = form.bytes_per_px * (1.0 if form.quality is None else self._detail)
        return frame.image_dn.size * self._bytes_per_px.get(form, guess)


def _encoded(pixels: NDArray[np.uint8], frame: LiveFrame, form: PictureForm) -> bytes:
    rows, cols = pixels.shape
    facts = (frame.sequence & 0xFFFFFFFF, 1e3 * frame.received_s, cols, rows)
    if form.quality is None:
        return HEADER.pack(EXACT, *facts, 0) + pixels.tobytes()
    size = (-(-cols // form.reduction), -(-rows // form.reduction))
    reduced = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    picture = _file(".jpg", reduced, [cv2.IMWRITE_JPEG_QUALITY, form.quality])
    marks = b""
    is_saturated = pixels == SATURATED
    if is_saturated.any():
        share = cv2.resize(is_saturated.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        white = np.where(share > 0, SATURATED, 0).astype(np.uint8)  # where one is, the square is
        marks = _file(".png", white, [cv2.IMWRITE_PNG_BILEVEL, 1])
    return HEADER.pack(COMPRESSED, *facts, len(picture)) + picture + marks


def _file(suffix: str, pixels: cv2.typing.MatLike, options: list[int]) -> bytes:
    is_done, data = cv2.imencode(suffix, pixels, options)
    assert is_done
    return data.tobytes()
