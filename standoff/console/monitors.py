"""What is watched in the live picture: focus and levels, sharpness, squareness and the pose."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any, cast

import cv2
import numpy as np

from acquisition.choices import FocusMeasure
from acquisition.devices import FrameImage
from acquisition.focus import (
    FOCUS_MEASURES,
    FocusMeter,
    FocusOptions,
    FocusReading,
    FocusTrace,
    Region,
    focus_value,
    has_detail,
)
from analysis.detectability import DetectabilityCurve
from analysis.pose import PoseTracker, PoseVerdict
from calibration.errors import CalibrationError
from calibration.geometry import CharucoBoard, Levelling, find_board, level_by_board
from simulation.arrays import AnyArray, IntArray
from standoff.console.devices import Service
from standoff.console.edge_reading import EdgeReading, SteadyEdge, edge_in, edge_source, read_edge
from standoff.console.frames import FrameBroadcaster, LiveFrame
from standoff.console.reference_picture import ReferencePicture, reference_numbers
from standoff.errors import ApplicationError

BINS = 128
TRACE_STEP_S = 0.1
TRACE_VALUES = 300
"""Half a minute of focus values."""

FIELD_SHARE = 0.2
"""Of the frame's width and height: each of the four regions, which touch no border."""

FIELD_MARGIN = 0.04
FIELD_NAMES = ("top left", "top right", "bottom left", "bottom right")

TrackerMaker = Callable[[AnyArray], PoseTracker]
"""Makes the tracker of a reference image of shape ``(rows, cols)``."""


class FrameMonitor(Service):
    """Looks at the newest frame at most every ``period_s``, and skips those it has no time for."""

    period_s = 0.1
    patience_s = 0.2
    """How long a frame is waited for, before it is asked again whether any is wanted."""

    def __init__(self, name: str, broadcaster: FrameBroadcaster) -> None:
        super().__init__(name)
        self._broadcaster = broadcaster
        self._lock = Lock()

    def look(self, frame: LiveFrame) -> None:
        """Measure one frame."""
        raise NotImplementedError

    def _is_wanted(self) -> bool:
        return True

    def _miss(self) -> None:
        """Note that no frame came."""

    def _run(self) -> None:
        seen = 0
        while not self._is_closing.wait(self.period_s):
            if not self._is_wanted():
                continue
            frame = self._broadcaster.wait_newer(seen, self.patience_s)
            if frame is None:
                self._miss()
            else:
                seen = frame.sequence
                self.look(frame)


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


class PictureMonitor(FrameMonitor):
    """Focus with its trace, levels and saturation, in ``facts``.

    A change of exposure or gain, or a step of the light, resets the peak.
    """

    period_s = 0.04
    """25 pictures per second: more than the eye can follow."""

    def __init__(self, broadcaster: FrameBroadcaster) -> None:
        super().__init__("picture monitor", broadcaster)
        self.facts = PictureFacts()
        self._meter = FocusMeter(FocusOptions())
        self._trace = FocusTrace()
        self._values: deque[float] = deque(maxlen=TRACE_VALUES)
        self._values_s: deque[float] = deque(maxlen=TRACE_VALUES)
        self._traced_s = 0.0
        self._exposed: tuple[float, float | None, float | None] | None = None

    def look_at(self, region: Region | None) -> None:
        """Measure the focus in a region, or in the whole frame if None; the peak is reset."""
        with self._lock:
            self._begin(replace(self.facts, region=region))

    def measure_by(self, measure: FocusMeasure) -> None:
        """Use another focus measure; the peak is reset."""
        with self._lock:
            self._begin(replace(self.facts, measure=measure))

    def forget_peak(self) -> None:
        """Restart the trace."""
        with self._lock:
            self._begin(self.facts)

    def look(self, frame: LiveFrame) -> None:
        """Measure one frame."""
        with self._lock:
            facts = self.facts
            settings, image_dn = frame.settings, frame.image_dn
            levels = levels_of(image_dn, settings.max_level_dn)
            exposed = settings.exposure_us, settings.gain_db, settings.gain
            if exposed != self._exposed:
                self._begin(facts)
                self._exposed, facts = exposed, self.facts
            region = facts.region
            if region is not None and not _fits(region, image_dn):
                self._begin(replace(facts, region=None))
                facts = self.facts
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
            self.facts = replace(
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
        self.facts = replace(facts, focus=None, trace=(), trace_s=())


def _fits(region: Region, image_dn: FrameImage) -> bool:
    rows, cols = image_dn.shape
    right, bottom = region.x_px + region.width_px, region.y_px + region.height_px
    return right <= int(cols) and bottom <= int(rows)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FieldReading:
    """One of the four regions: its focus value, in percent of its own peak, and its edge.

    Without ``has_detail`` the region shows nothing but noise, and the focus value is the noise's.
    """

    name: str
    region: Region
    focus: float
    peak: float
    edge: EdgeReading | None
    has_detail: bool

    @property
    def percent_of_peak(self) -> float:
        """Value in percent of the largest since the last reset; 0 if there is none."""
        return 100.0 * self.focus / self.peak if self.peak > 0 else 0.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SharpnessView:
    """What was measured last; ``why_not`` says why there is no edge.

    ``sequence`` counts the measurements, ``rate_hz`` is how many there are a second, ``arrived_s``
    is when the frame arrived (monotonic). ``is_awaited`` says that an edge is asked for, and none
    has been measured yet.
    """

    sequence: int = 0
    rate_hz: float = 0.0
    edge: EdgeReading | None = None
    why_not: str = ""
    field: tuple[FieldReading, ...] = ()
    arrived_s: float | None = None
    is_awaited: bool = False


class SharpnessMonitor(FrameMonitor):
    """The edge under a region and four regions near the corners, while one of them is watched.

    Line pairs per mm need the sensor's pixel pitch, None if it is not known.
    """

    period_s = 0.12
    """Eight measurements a second, if there is the time: one takes 2 to 20 ms."""

    def __init__(self, broadcaster: FrameBroadcaster, pixel_pitch_um: float | None) -> None:
        super().__init__("sharpness monitor", broadcaster)
        self._pitch_um = pixel_pitch_um
        self.view = SharpnessView()
        self.is_field_wanted = False
        self._region: Region | None = None
        self._peaks: dict[str, float] = {}
        self._exposed: tuple[float, float | None, float | None] | None = None
        self._steady: dict[str, SteadyEdge] = {}
        self._times_s: list[float] = []

    def look_at(self, region: Region | None) -> None:
        """Measure the edge in a region; none if None."""
        with self._lock:
            self._region = region
            self._forget()

    def watch_field(self, is_wanted: bool) -> None:
        """Measure the four regions near the corners, or stop it; their peaks are reset."""
        with self._lock:
            self.is_field_wanted = is_wanted
            self._forget()

    def forget_peaks(self) -> None:
        """Reset the peaks of the four regions."""
        with self._lock:
            self._peaks = {}

    def look(self, frame: LiveFrame) -> None:
        """Measure one frame."""
        if not self._is_wanted():
            return
        region, is_field_wanted = self._region, self.is_field_wanted
        settings = frame.settings
        exposed = settings.exposure_us, settings.gain_db, settings.gain
        is_as_before = exposed == self._exposed
        steady = self._steady if is_as_before else {}
        edge, why_not = None, ""
        if region is not None:
            edge, why_not = steady.setdefault("region", SteadyEdge()).add(
                *read_edge(frame, region, self._pitch_um)
            )
        peaks = dict(self._peaks) if is_as_before else {}
        field = self._field_of(frame, peaks, steady) if is_field_wanted else ()
        with self._lock:
            if (region, is_field_wanted) != (self._region, self.is_field_wanted):
                return  # something else was asked for meanwhile
            self._peaks, self._steady, self._exposed = peaks, steady, exposed
            self._times_s = [*self._times_s[-10:], frame.received_s]
            span_s = self._times_s[-1] - self._times_s[0]
            self.view = SharpnessView(
                sequence=self.view.sequence + 1,
                rate_hz=(len(self._times_s) - 1) / span_s if span_s > 0 else 0.0,
                edge=edge,
                why_not=why_not,
                field=field,
                arrived_s=frame.arrived_s,
            )

    def _field_of(
        self, frame: LiveFrame, peaks: dict[str, float], steady: dict[str, SteadyEdge]
    ) -> tuple[FieldReading, ...]:
        found = []
        for name, region in field_regions(frame.image_dn.shape).items():
            view = region.cut(frame.image_dn)
            value = focus_value(view, black_level_dn=frame.settings.black_level_dn)
            source = edge_source(frame, region)
            is_drawn = has_detail(source.image_dn)
            # Noise is no peak: the focus of the next thing seen there may well be below its value.
            peaks[name] = max(peaks.get(name, 0.0), value if is_drawn else 0.0)
            edge = edge_in(source, self._pitch_um) if is_drawn else (None, "")
            found.append(
                FieldReading(
                    name=name,
                    region=region,
                    focus=value,
                    peak=peaks[name],
                    edge=steady.setdefault(name, SteadyEdge()).add(*edge)[0],
                    has_detail=is_drawn,
                )
            )
        return tuple(found)

    def _forget(self) -> None:
        self._peaks = {}
        self._steady = {}
        self._times_s = []
        self.view = SharpnessView(
            sequence=self.view.sequence + 1, is_awaited=self._region is not None
        )

    def _is_wanted(self) -> bool:
        return self._region is not None or self.is_field_wanted


def field_regions(shape: tuple[int, ...]) -> Mapping[str, Region]:
    """The four regions near the corners of a frame of shape ``(rows, cols)``, by name."""
    rows, cols = shape
    least = max(measure.reach_px for measure in FOCUS_MEASURES.values()) + 1
    height, width = (max(round(FIELD_SHARE * length), least) for length in (rows, cols))
    down, right = round(FIELD_MARGIN * rows), round(FIELD_MARGIN * cols)
    lefts = right, cols - right - width
    tops = down, rows - down - height
    places = [(left, top) for top in tops for left in lefts]
    return {
        name: Region(x_px=max(left, 0), y_px=max(top, 0), width_px=width, height_px=height)
        for name, (left, top) in zip(FIELD_NAMES, places, strict=True)
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class SquarenessView:
    """The tilt of the newest frame, or why there is none; ``is_wanted`` says that it is watched.

    ``arrived_s`` is when the frame arrived (monotonic).
    """

    is_wanted: bool = False
    levelling: Levelling | None = None
    why_not: str = ""
    arrived_s: float | None = None


class SquarenessMonitor(FrameMonitor):
    """The tilt against a ChArUco board under the camera, while it is wanted.

    The focal length in px is over the pixel pitch.
    """

    period_s = 0.2

    def __init__(
        self, broadcaster: FrameBroadcaster, board: CharucoBoard, focal_length_px: float
    ) -> None:
        super().__init__("squareness monitor", broadcaster)
        self._board = board
        self._focal_px = focal_length_px
        self.view = SquarenessView()

    def watch(self, is_wanted: bool) -> None:
        """Measure the tilt, or stop it."""
        with self._lock:
            self.view = SquarenessView(is_wanted=is_wanted)

    def look(self, frame: LiveFrame) -> None:
        """Measure one frame."""
        rows, cols = frame.image_dn.shape
        levelling, why_not = None, ""
        try:
            corners = find_board(frame.image_dn, self._board)
            levelling = level_by_board(corners, (rows, cols), self._focal_px)
        except (CalibrationError, ValueError) as error:
            why_not = str(error)
        with self._lock:
            if self.view.is_wanted:
                self.view = SquarenessView(
                    is_wanted=True,
                    levelling=levelling,
                    why_not=why_not,
                    arrived_s=frame.arrived_s,
                )

    def _is_wanted(self) -> bool:
        return self.view.is_wanted


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseView:
    """The current pose; ``picture`` is the reference, None if none is chosen.

    ``is_possible`` is False if there is no curve to judge by, ``fault`` says why there is no
    verdict though there is one. ``arrived_s`` is when the frame of the verdict arrived (monotonic);
    ``is_searching`` says that the pose was lost since, and the whole of a newer frame is searched.
    """

    is_possible: bool
    picture: ReferencePicture | None = None
    fault: str = ""
    verdict: PoseVerdict | None = None
    arrived_s: float | None = None
    is_searching: bool = False

    @property
    def reference(self) -> str:
        """Name of the reference; empty if none is chosen."""
        return "" if self.picture is None else self.picture.name


class PoseMonitor(FrameMonitor):
    """Go or no go: whether the pose lets a follow-up be compared with a chosen reference.

    Without a curve to judge by, so without what makes a tracker, it keeps the reference and gives
    no verdict. ``report`` is called with one line when tracking ends by itself. A search of the
    whole frame takes longer than the period.
    """

    patience_s = 2.0
    """A verdict on an older picture is none."""

    def __init__(
        self,
        broadcaster: FrameBroadcaster,
        make_tracker: TrackerMaker | None,
        *,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        super().__init__("pose monitor", broadcaster)
        self._report = report
        self._make = make_tracker
        self._numbers = reference_numbers()
        self._tracker: PoseTracker | None = None
        self._view = PoseView(is_possible=make_tracker is not None)

    @property
    def view(self) -> PoseView:
        """The current pose."""
        view, tracker = self._view, self._tracker
        return view if tracker is None else replace(view, is_searching=tracker.is_searching)

    def choose(self, name: str, image: AnyArray, max_level_dn: float | None = None) -> None:
        """Compare the pose with this image from now on; its shape is ``(rows, cols)``, in DN.

        A saturated pixel has ``max_level_dn``; None takes the largest level there is. An image with
        too little texture to be followed is refused.
        """
        try:
            tracker = None if self._make is None else self._make(image)
        except CalibrationError as error:
            raise ApplicationError(f"{name} cannot be used as a reference: {error}") from error
        most_dn = float(np.nanmax(image)) if max_level_dn is None else max_level_dn
        picture = ReferencePicture(
            number=next(self._numbers), name=name, image_dn=image, max_level_dn=max(most_dn, 1.0)
        )
        with self._lock:
            self._tracker = tracker
            self._view = PoseView(is_possible=self._make is not None, picture=picture)

    def judge_by(self, make_tracker: TrackerMaker | None) -> None:
        """Judge by another curve or threshold from now on, or by none; the reference stays."""
        picture, tracker, fault = self._view.picture, None, ""
        if picture is not None and make_tracker is not None:
            try:
                tracker = make_tracker(picture.image_dn)
            except CalibrationError as error:
                fault = f"this reference cannot be followed: {error}"
        with self._lock:
            self._make = make_tracker
            self._tracker = tracker
            self._view = PoseView(
                is_possible=make_tracker is not None, picture=picture, fault=fault
            )

    def clear(self) -> None:
        """Forget the reference."""
        with self._lock:
            self._tracker = None
            self._view = PoseView(is_possible=self._make is not None)

    def look(self, frame: LiveFrame) -> None:
        """Judge one frame."""
        with self._lock:
            tracker, view = self._tracker, self._view
        if tracker is None:
            return
        try:
            verdict = tracker.update(frame.image_dn)
        except ValueError as error:  # the frame size changed
            self._report(f"The pose is no longer judged: {error}")
            self.clear()
            return
        with self._lock:
            if tracker is self._tracker:
                self._view = replace(view, verdict=verdict, arrived_s=frame.arrived_s)

    def _is_wanted(self) -> bool:
        return self._tracker is not None

    def _miss(self) -> None:
        with self._lock:
            self._view = replace(self._view, verdict=None, arrived_s=None)


def tracker_maker(curve: DetectabilityCurve, min_dprime: float) -> TrackerMaker:
    """Return a function that makes a tracker for a reference image, using this curve."""
    return lambda image: PoseTracker(cast("Any", image), curve, min_dprime)
