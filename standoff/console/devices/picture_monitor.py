"""What the console shows about the picture: focus with its trace, levels and saturation."""

from collections import deque
from dataclasses import dataclass, replace
from threading import Event, Lock, Thread

import cv2
import numpy as np

from acquisition.choices import FocusMeasure
from acquisition.devices import FrameImage
from acquisition.focus import FocusMeter, FocusOptions, FocusReading, FocusTrace, Region
from simulation.arrays import IntArray
from standoff.console.devices.frame_broadcaster import FrameBroadcaster, LiveFrame

BINS = 128
PERIOD_S = 0.04
"""At most 25 pictures per second are measured: more than the eye can follow."""

TRACE_STEP_S = 0.1
TRACE_VALUES = 300
"""Half a minute of focus values."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Levels:
    """Histogram in ``BINS`` bins from 0 to ``max_level_dn``, and the saturated fraction."""

    counts: IntArray
    max_level_dn: int
    mean_dn: float
    saturated_fraction: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PictureFacts:
    """Measurements of the newest picture.

    ``trace`` holds focus values, the oldest first, at most ten per second; ``trace_s`` when their
    frames came, in seconds before the last. ``focus_s`` and ``levels_s`` are when the frames of
    ``focus`` and ``levels`` arrived (monotonic).
    """

    region: Region | None = None
    measure: FocusMeasure = "squared-gradient"
    focus: FocusReading | None = None
    trace: tuple[float, ...] = ()
    trace_s: tuple[float, ...] = ()
    levels: Levels | None = None
    focus_s: float | None = None
    levels_s: float | None = None


def levels_of(image_dn: FrameImage, max_level_dn: int) -> Levels:
    """Histogram of a picture of shape ``(rows, cols)``; a level at the maximum is saturated."""
    top = float(max_level_dn + 1)
    counts = cv2.calcHist([image_dn], [0], None, [BINS], [0.0, top]).reshape(-1)
    saturated = int(np.count_nonzero(image_dn >= max_level_dn))
    return Levels(
        counts=counts.astype(np.int64),
        max_level_dn=max_level_dn,
        mean_dn=float(cv2.mean(image_dn)[0]),
        saturated_fraction=saturated / image_dn.size,
    )


class PictureMonitor:
    """Measures the newest frame in its own thread, and skips frames it has no time for.

    A change of exposure or gain, or a step of the light, resets the peak.

    Parameters
    ----------
    broadcaster
        Source of the frames.
    """

    def __init__(self, broadcaster: FrameBroadcaster) -> None:
        self._broadcaster = broadcaster
        self._lock = Lock()
        self._facts = PictureFacts()
        self._meter = FocusMeter(FocusOptions())
        self._trace = FocusTrace()
        self._values: deque[float] = deque(maxlen=TRACE_VALUES)
        self._values_s: deque[float] = deque(maxlen=TRACE_VALUES)
        self._traced_s = 0.0
        self._exposed: tuple[float, float | None, float | None] | None = None
        self._is_closing = Event()
        self._thread = Thread(target=self._run, name="picture monitor", daemon=True)

    @property
    def facts(self) -> PictureFacts:
        """The newest measurements."""
        return self._facts

    def start(self) -> None:
        """Start measuring, in a thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._is_closing.set()
        if self._thread.is_alive():
            self._thread.join()

    def look_at(self, region: Region | None) -> None:
        """Measure the focus in a region, or in the whole frame if None; the peak is reset."""
        with self._lock:
            self._begin(replace(self._facts, region=region))

    def measure_by(self, measure: FocusMeasure) -> None:
        """Use another focus measure; the peak is reset."""
        with self._lock:
            self._begin(replace(self._facts, measure=measure))

    def forget_peak(self) -> None:
        """Restart the trace."""
        with self._lock:
            self._begin(self._facts)

    def look(self, frame: LiveFrame) -> None:
        """Measure one frame."""
        with self._lock:
            facts = self._facts
            settings, image_dn = frame.settings, frame.image_dn
            levels = levels_of(image_dn, settings.max_level_dn)
            exposed = settings.exposure_us, settings.gain_db, settings.gain
            if exposed != self._exposed:
                self._begin(facts)
                self._exposed, facts = exposed, self._facts
            region = facts.region
            if region is not None and not _fits(region, image_dn):
                self._begin(replace(facts, region=None))
                facts = self._facts
            try:
                value = self._meter.add(image_dn, settings.black_level_dn)
            except ValueError:  # another frame size
                self._begin(facts)
                value = None
            if self._meter.is_after_step:
                # What was sharper in another light says nothing: no false peak, no "go back".
                self._trace.reset()
                self._values.clear()
                self._values_s.clear()
            reading = None if self._meter.is_after_step else facts.focus
            focus_s = facts.focus_s
            if value is not None and np.isfinite(value):
                reading = self._trace.add(value, has_detail=self._meter.has_detail)
                focus_s = frame.arrived_s
                if reading.has_detail and frame.received_s - self._traced_s >= TRACE_STEP_S:
                    self._traced_s = frame.received_s
                    self._values.append(reading.value)
                    self._values_s.append(frame.received_s)
            self._facts = replace(
                facts,
                focus=reading,
                trace=tuple(self._values),
                trace_s=tuple(each_s - self._traced_s for each_s in self._values_s),
                levels=levels,
                focus_s=focus_s,
                levels_s=frame.arrived_s,
            )

    def _begin(self, facts: PictureFacts) -> None:
        self._meter = FocusMeter(FocusOptions(measure=facts.measure, region=facts.region))
        self._trace.reset()
        self._values.clear()
        self._values_s.clear()
        self._facts = replace(facts, focus=None, trace=(), trace_s=())

    def _run(self) -> None:
        seen = 0
        while not self._is_closing.is_set():
            frame = self._broadcaster.wait_newer(seen, 0.2)
            if frame is None:
                continue
            seen = frame.sequence
            self.look(frame)
            self._is_closing.wait(PERIOD_S)


def _fits(region: Region, image_dn: FrameImage) -> bool:
    rows, cols = image_dn.shape
    right, bottom = region.x_px + region.width_px, region.y_px + region.height_px
    return right <= int(cols) and bottom <= int(rows)
