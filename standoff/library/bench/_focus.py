"""Live focus values of a bench's camera, and the height at which its picture is sharpest."""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.choices import FocusMeasure
from acquisition.files import write_file
from acquisition.focus import (
    UNKNOWN_PUPIL,
    FocusOptions,
    FocusPeak,
    FocusPoint,
    FocusReading,
    FocusSweep,
    FocusTrace,
    NoFocusPeakError,
    PupilOffset,
    Region as FocusRegion,
    SweepRequest,
    focus_values,
    positions_of,
    sweep_bench,
)
from calibration.edges import Region
from calibration.estimate import NORMAL_95
from calibration.files import read_geometry
from calibration.geometry import GeometryCalibration
from calibration.noise import level_noise
from simulation.arguments import checked
from simulation.notebook import Shown
from standoff.errors import ArgumentError
from standoff.library.bench._devices import MovableBench, OpenCamera, opened_camera, place_target
from standoff.library.bench._plan_preview import bench_config
from standoff.library.call import (
    Call,
    FilePath,
    NoiseLike,
    Progress,
    camera_noise,
    output_path,
    path_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LIVE_FRAMES = 3
_CLIPPED = 0.01
_EDGE_ORIENTATION_DEG = 5.0
_READING = ("value", "peak", "percent_of_peak", "trend", "is_past_peak", "noise", "has_detail")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class WatchedFocus(Shown):
    """The last reading of the live focus aid."""

    reading: FocusReading
    measure: FocusMeasure
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the reading as ``standoff focus --json`` prints it."""
        return {**{name: getattr(self.reading, name) for name in _READING}, "metric": self.measure}


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class FoundFocus(Shown):
    """A sweep through focus; ``tolerance_mm`` is the positioning tolerance of the stage."""

    sweep: FocusSweep
    measure: FocusMeasure
    tolerance_mm: float
    notes: tuple[str, ...] = ()

    @property
    def peak(self) -> FocusPeak:
        """The height of best focus, with its standard error.

        Raises
        ------
        NoFocusPeakError
            If the sweep has no peak; the message says where to look.
        """
        if self.sweep.peak is None:
            raise NoFocusPeakError(self.sweep.why_not or "no peak")
        return self.sweep.peak

    @property
    def half_interval_mm(self) -> float:
        """Half the 95 % interval of the height of the peak."""
        return NORMAL_95 * self.peak.err_mm

    @property
    def is_finer_than_stage(self) -> bool:
        """Whether the peak is known more precisely than the stage can hold its position."""
        return self.half_interval_mm < self.tolerance_mm

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the focus value against the height, with the peak."""
        from analysis.reports import plot_focus_sweep  # matplotlib, for whoever looks

        heights_mm, values, errs = self.sweep.columns()
        return plot_focus_sweep(heights_mm, values, errs, self.sweep.peak, self.measure, ax)

    def write_plot(self, path: FilePath) -> None:
        """Write the figure as PNG.

        Raises
        ------
        ApplicationError
            If the file cannot be written.
        """
        from analysis.reports import png_bytes

        write_file(output_path(path, "path", {".png"}), png_bytes(self.plot()))

    def to_json(self) -> dict[str, Any]:
        """Return the peak as ``standoff focus --sweep --json`` prints it."""
        peak, points = self.peak, self.sweep.points
        return {
            "height_mm": peak.height_mm,
            "height_err_mm": peak.err_mm,
            "height_err_pupil_mm": peak.pupil_err_mm,
            "height_err_scale_mm": peak.scale_err_mm,
            "value": peak.value,
            "shape": peak.shape,
            "width_mm": peak.width_mm,
            "metric": self.measure,
            "remark": self.sweep.remark,
            "positions": [
                {"height_mm": p.height_mm, "value": p.value, "value_err": p.err} for p in points
            ],
        }


@checked
def watch_focus(
    bench: BenchConfig | FilePath,
    show: Callable[[FocusReading, float], None] = lambda *_: None,
    *,
    settings: Mapping[str, Any] | None = None,
    measure: FocusMeasure = "squared-gradient",
    region: Region | None = None,
    frames: int = _LIVE_FRAMES,
    readings: int | None = None,
    noise: NoiseLike | None = None,
    target: str | None = None,
    progress: Progress | None = None,
) -> WatchedFocus:
    """Show focus values of the live picture until Ctrl-C, or for a number of readings.

    Ctrl-C is the normal way to end this, so it is not an error once a value has been shown.

    Parameters
    ----------
    bench, settings
        The path of a bench file or a `BenchConfig`, and values that override keys of the file.
    show
        Called with each reading and its time in s.
    measure
        Focus measure; ``docs/focus.md`` describes them.
    region
        Part of the frame to use, in px; None for all of it.
    frames
        Number of frames in the running median that is shown; an even number counts as the next
        odd one.
    readings
        Number of readings after which to end; None to go on until Ctrl-C.
    noise
        Noise of the camera, or the path of a noise.json; if None, it is measured.
    target
        Name of a target to place under a simulated camera.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    WatchedFocus
        The last reading.

    Raises
    ------
    ArgumentError
        If the region reaches beyond the frame, or the target cannot be placed.
    BenchConfigError, DeviceError, NoiseFileError
        If the bench, the camera or the noise is at fault.
    KeyboardInterrupt
        If Ctrl-C is pressed before the first value.

    Examples
    --------
    >>> values = []
    >>> def show(reading, time_s):
    ...     values.append(reading.value)
    >>> last = standoff.watch_focus("bench.toml", show, readings=3, target="coins")
    >>> len(values)
    3
    """
    call, config = Call("watch_focus", progress), bench_config(bench, settings)
    options = _options(measure, region, noise)
    smoothed = frames // 2 * 2 + 1
    trace = FocusTrace(smoothed=smoothed, window=max(12, smoothed))
    last: FocusReading | None = None
    with opened_camera(config) as opened:
        _prepare(call, opened, target, options)
        try:
            with closing(focus_values(opened.camera, options)) as values:
                for number, (value, has_detail) in enumerate(values, start=1):
                    last = trace.add(value, has_detail=has_detail)
                    show(last, opened.clock())
                    if number == readings:
                        break
        except KeyboardInterrupt:
            if last is None:
                raise
    assert last is not None
    return WatchedFocus(reading=last, measure=measure, notes=call.notes)


@checked
def find_focus(
    bench: BenchConfig | FilePath,
    heights_mm: tuple[float, float] | None = None,
    *,
    settings: Mapping[str, Any] | None = None,
    steps: int = 15,
    frames: int | None = None,
    ends_at_peak: bool = False,
    measure: FocusMeasure = "squared-gradient",
    region: Region | None = None,
    noise: NoiseLike | None = None,
    geometry: GeometryCalibration | FilePath | None = None,
    target: str | None = None,
    measured: Callable[[FocusPoint], None] = lambda _: None,
    progress: Progress | None = None,
) -> FoundFocus:
    """Sweep the stage through focus and fit the height at which the picture is sharpest.

    Parameters
    ----------
    bench, settings, measure, region, noise, target, progress
        As in ``watch_focus``.
    heights_mm
        Lowest and highest height of the sweep; if None, the whole travel is swept coarsely and
        then the range about the best height finely.
    steps
        Number of heights, at least 7.
    frames
        Number of frames at each height, at least 2; if None, that of the bench file.
    ends_at_peak
        Whether the stage moves to the peak at the end.
    geometry
        Geometry of an earlier session with this lens, or the path of its geometry.json, for the
        position of the entrance pupil. Without it, the error of the peak includes the uncertainty
        of that position.
    measured
        Called with the focus value of each height as it is measured.

    Returns
    -------
    FoundFocus
        ``peak`` is the height with its error; if there is no peak, ``sweep.why_not`` says why and
        where to look.

    Raises
    ------
    ArgumentError
        As ``watch_focus``, and if the heights are not in order.
    BenchConfigError, DeviceError, GeometryFileError, NoiseFileError
        If the bench, a device, the geometry or the noise is at fault; the stage is stopped first.

    Examples
    --------
    >>> deep = {"simulated.focus_distance_mm": 300, "simulated.f_number": 1.0}
    >>> found = standoff.find_focus(
    ...     "bench.toml", (260, 320), settings=deep, steps=9, frames=2, target="edge"
    ... )
    >>> round(found.peak.height_mm)
    288
    """
    if heights_mm is not None and not heights_mm[0] < heights_mm[1]:
        raise ArgumentError(
            f"expected the lower one first, got {heights_mm}", argument="heights_mm"
        )
    call, config = Call("find_focus", progress), bench_config(bench, settings)
    options = _options(measure, region, noise)
    request = SweepRequest(
        heights_mm=heights_mm,
        steps=steps,
        frames=frames or config.capture.frames_per_capture,
        ends_at_peak=ends_at_peak,
        pupil=pupil_of(geometry),
    )
    with MovableBench(config) as opened:
        _prepare(call, opened, target, options)
        with call.bar("sweeping", positions_of(request)) as advance_to:
            done = count(1)

            def show(point: FocusPoint) -> None:
                measured(point)
                advance_to(next(done))

            found = sweep_bench(opened.devices, options, request, show)
    if max(point.saturated_fraction for point in found.points) > _CLIPPED:
        call.note(
            "parts of the picture are saturated, which blunts the peak; use a shorter exposure"
        )
    tolerance_mm = config.stage.tolerance_mm
    return FoundFocus(sweep=found, measure=measure, tolerance_mm=tolerance_mm, notes=call.notes)


def pupil_of(geometry: GeometryCalibration | FilePath | None) -> PupilOffset:
    """Return the offset of the entrance pupil by a geometry; unknown if there is none."""
    if geometry is None:
        return UNKNOWN_PUPIL
    if not isinstance(geometry, GeometryCalibration):
        geometry = read_geometry(path_of(geometry, "geometry"))
    err_mm = geometry.pupil_offset_err_mm
    return PupilOffset(
        offset_mm=geometry.pupil_offset_mm,
        err_mm=UNKNOWN_PUPIL.err_mm if err_mm is None else err_mm,
    )


def focus_region(region: Region | None) -> FocusRegion | None:
    """Return the region of a picture in which focus is measured."""
    if region is None:
        return None
    sides = {name: getattr(region, name) for name in ("x_px", "y_px", "width_px", "height_px")}
    try:
        return FocusRegion(**sides)
    except ValueError as error:
        raise ArgumentError(str(error), argument="region") from error


def _options(measure: FocusMeasure, region: Region | None, noise: NoiseLike | None) -> FocusOptions:
    camera = camera_noise(noise)
    model = None if camera is None else level_noise(camera)
    return FocusOptions(
        measure=measure,
        region=focus_region(region),
        noise=None
        if model is None
        else lambda level_dn: float(model.variance_dn2(np.array([level_dn]))[0]),
    )


def _prepare(
    call: Call, opened: MovableBench | OpenCamera, target: str | None, options: FocusOptions
) -> None:
    for remark in opened.warnings:
        call.note(remark)
    place_target(opened.simulated, target, _EDGE_ORIENTATION_DEG)
    region, frame = options.region, opened.camera.settings
    if region is not None and (
        region.x_px + region.width_px > frame.width_px
        or region.y_px + region.height_px > frame.height_px
    ):
        raise ArgumentError(
            f"the region reaches beyond the frame of {frame.width_px} x {frame.height_px} px",
            argument="region",
        )
