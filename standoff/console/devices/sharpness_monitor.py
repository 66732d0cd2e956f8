"""How sharp the live picture is: the edge under the region, and four regions near the corners."""

from collections.abc import Mapping
from dataclasses import dataclass
from threading import Event, Lock, Thread

from acquisition.focus import FOCUS_MEASURES, Region, focus_value, has_detail
from standoff.console.devices.edge_reading import (
    EdgeReading,
    SteadyEdge,
    edge_in,
    edge_source,
    read_edge,
)
from standoff.console.devices.frame_broadcaster import FrameBroadcaster, LiveFrame

PERIOD_S = 0.12
"""Eight measurements a second, if there is the time: one takes 2 to 20 ms."""

FIELD_SHARE = 0.2
"""Of the frame's width and height: each of the four regions, which touch no border."""

FIELD_MARGIN = 0.04
FIELD_NAMES = ("top left", "top right", "bottom left", "bottom right")


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


class SharpnessMonitor:
    """Measures the newest frame in its own thread, while a region or the field is watched.

    Parameters
    ----------
    broadcaster
        Source of the frames.
    pixel_pitch_um
        Of the sensor, for line pairs per mm; None if it is not known.
    """

    def __init__(self, broadcaster: FrameBroadcaster, pixel_pitch_um: float | None) -> None:
        self._broadcaster = broadcaster
        self._pitch_um = pixel_pitch_um
        self._lock = Lock()
        self._region: Region | None = None
        self._is_field_wanted = False
        self._peaks: dict[str, float] = {}
        self._exposed: tuple[float, float | None, float | None] | None = None
        self._steady: dict[str, SteadyEdge] = {}
        self._times_s: list[float] = []
        self._view = SharpnessView()
        self._is_closing = Event()
        self._thread = Thread(target=self._run, name="sharpness monitor", daemon=True)

    @property
    def view(self) -> SharpnessView:
        """The newest measurement."""
        return self._view

    @property
    def is_field_wanted(self) -> bool:
        """Whether the four regions are measured."""
        return self._is_field_wanted

    def start(self) -> None:
        """Start measuring, in a thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._is_closing.set()
        if self._thread.is_alive():
            self._thread.join()

    def look_at(self, region: Region | None) -> None:
        """Measure the edge in a region; none if None."""
        with self._lock:
            self._region = region
            self._forget()

    def watch_field(self, is_wanted: bool) -> None:
        """Measure the four regions near the corners, or stop it; their peaks are reset."""
        with self._lock:
            self._is_field_wanted = is_wanted
            self._forget()

    def forget_peaks(self) -> None:
        """Reset the peaks of the four regions."""
        with self._lock:
            self._peaks = {}

    def look(self, frame: LiveFrame) -> None:
        """Measure one frame."""
        region, is_field_wanted = self._region, self._is_field_wanted
        if region is None and not is_field_wanted:
            return
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
            if (region, is_field_wanted) != (self._region, self._is_field_wanted):
                return  # something else was asked for meanwhile
            self._peaks, self._steady, self._exposed = peaks, steady, exposed
            self._times_s = [*self._times_s[-10:], frame.received_s]
            span_s = self._times_s[-1] - self._times_s[0]
            self._view = SharpnessView(
                sequence=self._view.sequence + 1,
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
        self._view = SharpnessView(
            sequence=self._view.sequence + 1, is_awaited=self._region is not None
        )

    def _run(self) -> None:
        seen = 0
        while not self._is_closing.is_set():
            if self._region is None and not self._is_field_wanted:
                self._is_closing.wait(PERIOD_S)
                continue
            frame = self._broadcaster.wait_newer(seen, 0.2)
            if frame is not None:
                seen = frame.sequence
                self.look(frame)
                self._is_closing.wait(PERIOD_S)


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
