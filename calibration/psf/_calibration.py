"""From photographs of edges, or the captures of a session, to the PSF of the camera."""

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import ceil, hypot
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.session import CaptureRecord, Session
from calibration.choices import Pattern
from calibration.edges import (
    PITCH_PX,
    REJECTING_FLAGS,
    EdgeImage,
    EdgeMeasurement,
    EdgeSelection,
    MeasuredTransfer,
    Method,
    Orientation,
    PlanePlace,
    least_side_px,
    mean_transfer,
    plane_places,
)
from calibration.errors import CalibrationError, NoEdgeError
from calibration.estimate import Estimate
from calibration.noise import CorrectionMaps, LevelNoise, fit_level_noise
from calibration.psf._consistency import (
    HeightGroup,
    HeightTrend,
    cross_validate,
    fit_height_trend,
    shared_of,
)
from calibration.psf._covariance import (
    CovarianceFit,
    fit_covariance,
    independent,
    median_width,
    with_shared,
)
from calibration.psf._document import CameraIdentity, ColourPsf, PsfCalibration, PsfOrigin
from calibration.psf._field import FieldEdges, FieldFit, field_or_reason, fit_psf_field
from calibration.psf._repeatability import (
    LEAST_ERR_PX,
    FocusScatter,
    SharedByCapture,
    capture_numbers,
    capture_of,
    shared_reach_px2,
    without_blur,
)
from calibration.psf._softness import measure_softness
from calibration.psf._transfer_2d import Transfer2d, measure_transfer_2d
from calibration.sharpness import with_sharpness
from simulation.arrays import FloatArray

EDGE_KINDS = ("edge", "board")
SCENE_KINDS = ("texture", "chart")


def edge_records(session: Session) -> list[CaptureRecord]:
    """Return the captures from which a PSF can be measured."""
    records = [record for record in session.records if record.kind in EDGE_KINDS]
    if not records:
        chart = next((record for record in session.records if record.kind == "chart"), None)
        text = f"{session.path}: the session has no capture of kind edge or board; "
        raise NoEdgeError(
            f"{text}capture one"
            if chart is None
            else f"{text}if its charts show straight edges, give their captures as photographs: "
            f"{session.path / chart.file}"
        )
    return records


def scene_records(session: Session) -> list[list[CaptureRecord]]:
    """Captures of each placement of a textured target, nearest first, without repeats."""
    targets: dict[tuple[str, float], dict[float, CaptureRecord]] = {}
    for record in session.records:
        if record.kind in SCENE_KINDS:
            heights = targets.setdefault((record.target, record.orientation_deg), {})
            heights.setdefault(round(record.height_asked_mm, 3), record)
    series = [
        sorted(heights.values(), key=lambda record: record.height_mm)
        for heights in targets.values()
        if len(heights) > 1
    ]
    if not series:
        raise CalibrationError(
            f"{session.path}: no target of kind texture or chart was captured at two heights; "
            "capture one"
        )
    return series


def edge_images(
    session: Session,
    *,
    correction: CorrectionMaps | None = None,
    frame_noise: LevelNoise | None = None,
) -> Iterator[EdgeImage]:
    """Load the edge captures one by one; see ``capture_images``."""
    return capture_images(
        session, edge_records(session), correction=correction, frame_noise=frame_noise
    )


def capture_images(
    session: Session,
    records: Sequence[CaptureRecord],
    *,
    correction: CorrectionMaps | None = None,
    frame_noise: LevelNoise | None = None,
) -> Iterator[EdgeImage]:
    """Load captures one by one, corrected if asked, each with the noise of its temporal variance.

    A single frame has none: its noise is ``frame_noise``, or what the edge fit estimates.
    """
    for record in records:
        images = session.load(record)
        mean = images.mean_dn.astype(np.float64)
        variance: NDArray[np.floating[Any]] | None = images.variance_dn2
        clipped = None
        if correction is not None:
            try:
                # Dividing by the response moves the level at which a pixel clips.
                clipped = mean >= record.max_level_dn
                mean = correction.correct(mean)
                variance = None if variance is None else correction.correct_variance(variance)
            except ValueError as error:
                raise CalibrationError(f"{record.file}: {error}") from error
        noise = frame_noise
        if variance is not None:
            single = fit_level_noise(mean, variance, record.max_level_dn)
            noise = single.averaged(record.frames_used)
        yield EdgeImage(
            name=record.file,
            image_dn=mean,
            capture=record.index,
            height_mm=record.height_mm,
            noise=noise,
            saturation_dn=record.max_level_dn,
            clipped=clipped,
        )


def origin_of(session: Session, records: Sequence[CaptureRecord]) -> PsfOrigin:
    """Return the camera of a session, and when the first of these captures was taken."""
    camera = session.devices.get("camera", {})
    return PsfOrigin(
        camera=CameraIdentity(
            serial=_text(camera, "DeviceSerialNumber"),
            model=_text(camera, "DeviceModelName"),
            vendor=_text(camera, "DeviceVendorName"),
        ),
        captured_utc=min(record.started_utc for record in records),
        photograph=_taken_with(session, records),
    )


def _taken_with(
    session: Session, records: Sequence[CaptureRecord]
) -> dict[str, str | float] | None:
    """Lens, exposure and pixel pitch of a session: of its bench, or of imported photographs."""
    bench = session.bench or {}
    tables = (session.devices.get("camera"), session.devices.get("lens"), bench.get("optics"))
    stated = {key: value for one in tables if isinstance(one, dict) for key, value in one.items()}
    facts: dict[str, str | float] = {}
    for name in ("lens", "focal_length_mm", "f_number", "iso", "pixel_pitch_um"):
        value = stated.get(name)
        if isinstance(value, str | int | float) and value:
            facts[name] = value
    exposures = {record.exposure_us for record in records}
    exposure_us = exposures.pop() if len(exposures) == 1 else None
    if exposure_us is not None:
        facts["exposure_s"] = exposure_us / 1e6
    return facts or None


def _text(snapshot: Mapping[str, object], key: str) -> str | None:
    value = snapshot.get(key)
    return None if value in (None, "") else str(value)


_TARGET = EdgeSelection()
_TRUSTED = 0.5  # robust weight from which an edge counts
# What JPEG takes from all edges alike, over the error of one of them: the mean error of boards of
# some 80 edges was 0.1 to 0.35 of it, at sigma 0.6 to 1.4 px and qualities of 50 to 90.
_JPEG_SHARED = 0.25
_AXES: tuple[tuple[str, Orientation], ...] = (("x", "vertical"), ("y", "horizontal"))


def psf_of_images(
    sources: Iterable[EdgeImage],
    *,
    method: Method = "all-angles",
    selection: EdgeSelection = _TARGET,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the PSF from photographs of straight edges, read one at a time.

    ``paper`` fits Gaussians to binned line spread functions and takes their medians over vertical
    and horizontal edges. Without ``selection`` the target's edges count, wherever they are.
    """
    edges: list[EdgeMeasurement] = []
    names: list[str] = []
    frames: set[tuple[int, int]] = set()
    for source in sources:
        names.append(source.name)
        frames.add(source.frame)
        edges.extend(with_sharpness(selection.measured_in(source, method), source))
        progress(len(names))
        del source  # before the next one is read
    used = [edge for edge in edges if edge.is_used]
    if not used:
        raise _no_edge_error(names, edges)
    return _psf_of_edges(edges, method, frames.pop() if len(frames) == 1 else None)


def _psf_of_edges(
    edges: Sequence[EdgeMeasurement],
    method: Method = "all-angles",
    frame: tuple[int, int] | None = None,
) -> PsfCalibration:
    """Compute the PSF from measured edges, at least one of which is usable.

    Without a ``frame``, as where photographs differ in size, no field is fitted.
    """
    seen = [edge for edge in edges if edge.is_used]
    softness = measure_softness(seen)
    blur_px2 = {} if softness is None else softness.blur_px2
    used = [without_blur(edge, blur_px2.get(capture_of(edge), 0.0)) for edge in seen]
    found = _field(used, method, frame)
    field = found if isinstance(found, FieldFit) else None
    # Over a field, places differ as well, and captures at other places with them.
    shared = None if field is not None else shared_of(used, softness)
    total = _medians(used, shared) if method == "paper" else _fit(used, shared, is_optical=False)
    focus = total.by_capture
    return PsfCalibration.of(
        total,
        _optical(used, shared),
        field=field,
        no_field_because=found if isinstance(found, str) else None,
        method=method,
        height_trend=_height_trend(used, total),
        focus=None if focus is None else FocusScatter.of(focus),
        cross_validation=cross_validate(seen, used, softness, focus, total.scatter_px),
        target_softness=None if softness is None else softness.document,
        transfer=_transfer(seen),
        transfer_2d=None if method == "paper" else _transfer_2d(used, total, blur_px2),
        picture_width_px=None if frame is None else frame[1],
        picture_height_px=None if frame is None else frame[0],
        edges=tuple(edges),
    )


def _resolved(edges: Sequence[EdgeMeasurement]) -> list[EdgeMeasurement]:
    return [edge for edge in edges if edge.optical_sigma_px is not None]


def _optical(
    edges: Sequence[EdgeMeasurement], shared: SharedByCapture | None
) -> CovarianceFit | None:
    chosen = np.flatnonzero([edge.optical_sigma_px is not None for edge in edges])
    if not chosen.size:
        return None
    known = None if shared is None else shared.some(chosen)
    return _fit(_resolved(edges), known, is_optical=True)


def _widths(edges: Sequence[EdgeMeasurement], *, is_optical: bool) -> tuple[FloatArray, FloatArray]:
    pairs = [
        (edge.optical_sigma_px or 0.0, edge.optical_sigma_err_px or 0.0)
        if is_optical
        else (edge.sigma_px, edge.sigma_err_px)
        for edge in edges
    ]
    sigma, err = np.array(pairs).T
    return sigma, np.maximum(err, LEAST_ERR_PX)


def _angles(edges: Sequence[EdgeMeasurement]) -> FloatArray:
    return np.array([edge.angle_deg for edge in edges])


def _fit(
    edges: Sequence[EdgeMeasurement], shared: SharedByCapture | None, *, is_optical: bool
) -> CovarianceFit:
    sigma, err = _widths(edges, is_optical=is_optical)
    fit = fit_covariance(_angles(edges), sigma, err, shared)
    return fit.with_relative(_lost_alike(edges, err / sigma, fit.weights))


def _lost_alike(
    edges: Sequence[EdgeMeasurement], relative: FloatArray, weights: FloatArray
) -> float:
    """Relative error of all widths from what compression does to all edges of a photograph alike.

    Some of what blocks have lost is chance from edge to edge; the rest no number of edges averages
    out. Each edge brings its own into the weighted mean.
    """
    is_jpeg = np.array(["jpeg" in edge.flags for edge in edges])
    counted = (weights if weights.any() else 1.0) / relative**2
    return _JPEG_SHARED * float((counted * relative)[is_jpeg].sum() / counted.sum())


def _medians(edges: Sequence[EdgeMeasurement], shared: SharedByCapture | None) -> CovarianceFit:
    """The paper's medians, whose errors hold what the captures share."""
    by_capture = _fit(edges, shared, is_optical=False).by_capture
    x, y = (
        None if median is None else with_shared(median, by_capture)
        for median in (_median_width(edges, "vertical"), _median_width(edges, "horizontal"))
    )
    return CovarianceFit(
        sigma_x_px=x,
        sigma_y_px=y,
        rho=None,
        covariance_px2=None,
        estimate_covariance=independent(x, y),
        scatter_px=0.0,
        weights=np.array([float(edge.orientation != "diagonal") for edge in edges]),
        by_capture=by_capture,
    )


def _median_width(edges: Sequence[EdgeMeasurement], orientation: Orientation) -> Estimate | None:
    chosen = [edge for edge in edges if edge.orientation == orientation]
    if not chosen:
        return None
    widths = np.array([edge.sigma_px for edge in chosen])
    return median_width(widths, np.array([edge.sigma_err_px for edge in chosen]))


def _field(
    edges: Sequence[EdgeMeasurement], method: Method, frame: tuple[int, int] | None
) -> FieldFit | str:
    """The PSF over the frame, or why there is none."""
    if method == "paper":
        return "the paper's method has no field"
    if frame is None:
        return "the photographs differ in size"
    rows, cols = frame
    whole = field_or_reason(_field_edges(edges, is_optical=False), cols, rows)
    resolved = _resolved(edges)
    if isinstance(whole, str) or not resolved:
        return whole
    lens = fit_psf_field(_field_edges(resolved, is_optical=True), cols, rows, is_asked=False)
    return whole if lens is None else whole.with_optical(lens)


def _field_edges(edges: Sequence[EdgeMeasurement], *, is_optical: bool) -> FieldEdges:
    sigma, err = _widths(edges, is_optical=is_optical)
    return FieldEdges(
        x_px=np.array([edge.x_px for edge in edges]),
        y_px=np.array([edge.y_px for edge in edges]),
        angle_deg=_angles(edges),
        sigma_px=sigma,
        sigma_err_px=err,
    )


def _transfer(edges: Sequence[EdgeMeasurement]) -> MeasuredTransfer:
    curves = {
        orientation: mean_transfer(
            [e.esfr for e in edges if e.orientation == orientation and e.esfr is not None]
        )
        for orientation in ("vertical", "horizontal")
    }
    return MeasuredTransfer(x=curves["vertical"], y=curves["horizontal"])


def _transfer_2d(
    edges: Sequence[EdgeMeasurement], total: CovarianceFit, softness_px2: Mapping[Hashable, float]
) -> Transfer2d | None:
    """The transfer function over both axes, without edges whose width the others contradict.

    Each edge is compared at its own focus and softness of the target.
    """
    keys = [capture_of(edge) for edge in edges]
    focus = total.by_capture
    offsets = {} if focus is None else focus.offset_px2
    numbers = capture_numbers(edges).tolist()
    trusted = [
        replace(edge.binned, blur_px2=softness_px2.get(key, 0.0) + offsets.get(number, 0.0))
        for edge, key, number, weight in zip(
            edges, keys, numbers, total.weights.tolist(), strict=True
        )
        # Where no covariance is determined, a weight of 0 says only that an edge was not needed.
        if edge.binned is not None and (weight > _TRUSTED or total.covariance_px2 is None)
    ]
    if not trusted:
        return None
    sigma, err = _widths(edges, is_optical=False)
    lost = _lost_alike(edges, err / sigma, total.weights)
    lost_px2 = 2 * lost * float(np.median(sigma**2))
    return measure_transfer_2d(
        trusted,
        hypot(shared_reach_px2(focus), lost_px2),
        knows_correlation=total.rho is not None,
    )


def _height_trend(edges: Sequence[EdgeMeasurement], total: CovarianceFit) -> HeightTrend | None:
    heights, widths, errs = [], [], []
    for edge in edges:
        expected = _expected_width(edge, total)
        if edge.height_mm is None or expected is None:
            continue
        heights.append(edge.height_mm)
        widths.append(edge.sigma_px / expected)
        errs.append(max(edge.sigma_err_px, LEAST_ERR_PX) / expected)
    trend = fit_height_trend(np.array(heights), np.array(widths), np.array(errs))
    if trend is None:
        return None
    groups = tuple(_with_medians(group, edges) for group in trend.heights)
    return trend.model_copy(update={"heights": groups})


def _with_medians(group: HeightGroup, edges: Sequence[EdgeMeasurement]) -> HeightGroup:
    """Add the median widths of its vertical and horizontal edges to a height."""
    at_height = [edge for edge in edges if edge.height_mm == group.height_mm]
    medians: dict[str, float] = {}
    for axis, orientation in _AXES:
        median = _median_width(at_height, orientation)
        if median is not None:
            medians[f"sigma_{axis}_px"] = median.value
            medians[f"sigma_{axis}_err_px"] = median.err
    return group.model_copy(update=medians)


def _expected_width(edge: EdgeMeasurement, total: CovarianceFit) -> float | None:
    """Width that the calibration as a whole predicts across this edge."""
    if total.covariance_px2 is not None:
        normal = np.array([np.cos(edge.normal_rad), np.sin(edge.normal_rad)])
        return float(np.sqrt(normal @ total.covariance_px2 @ normal))
    axis = {"vertical": total.sigma_x_px, "horizontal": total.sigma_y_px}.get(edge.orientation)
    return None if axis is None else axis.value


def _no_edge_error(
    names: list[str], edges: list[EdgeMeasurement], pitch_px: int = 1
) -> NoEdgeError:
    """Build the error that says why no edge of these photographs is usable, and the remedy."""
    where = names[0] if len(names) == 1 else f"{len(names)} images"
    if not edges:
        return NoEdgeError(
            f"{where}: no straight edge found; photograph a sharp dark-to-white edge", subject=where
        )
    flags = REJECTING_FLAGS & {flag for edge in edges for flag in edge.flags}
    remedy = {
        "star_spoke": "photograph straight edges beside the star, which standoff lens measures",
        "beside_target": "photograph the target alone, or use --target all",
        "saturated": "shorten the exposure",
        "masked": "measure an edge whose pixels are not masked",
        "too_short": f"photograph an edge at least {_least_side_px(edges, pitch_px)} px long",
        "too_noisy": "add light or average more frames",
        "uneven": "photograph an edge between two even areas, not a texture",
        "curved": "photograph a straight edge",
    }
    reasons = "; ".join(f"{flag.replace('_', ' ')}: {remedy[flag]}" for flag in sorted(flags))
    return NoEdgeError(
        f"{where}: none of the {len(edges)} edges can be used ({reasons})",
        subject=where,
        found=len(edges),
        flags=flags,
    )


def _least_side_px(edges: list[EdgeMeasurement], pitch_px: int) -> int:
    """Length of a side that can be measured at the width of the edges that are too short."""
    widths = [edge.sigma_px for edge in edges if "too_short" in edge.flags]
    width = float(np.median(widths)) if widths else 0.0
    return ceil(pitch_px * least_side_px(width / pitch_px))


COLOURS = ("red", "green", "blue")


def mosaic_plane(source: EdgeImage, place: PlanePlace) -> EdgeImage:
    """Return one colour plane of a mosaic photograph."""
    clipped, masked = (
        None if mask is None else place.plane(mask).astype(np.bool_)
        for mask in (source.clipped, source.masked)
    )
    return replace(
        source,
        image_dn=place.plane(source.image_dn),
        clipped=clipped,
        masked=masked,
        pitch_px=PITCH_PX,
        first_x_px=place.first_x_px,
        first_y_px=place.first_y_px,
        sensor_shape=source.frame,
    )


def calibrate_mosaic(
    sources: Iterable[EdgeImage],
    pattern: Pattern,
    channel: str = "green",
    *,
    method: Method = "all-angles",
    selection: EdgeSelection = _TARGET,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the PSF of every colour of mosaics, read one at a time, in pixels of the sensor.

    The values are those of ``channel``; the others are in ``channels``.
    """
    edges: dict[str, list[EdgeMeasurement]] = {colour: [] for colour in COLOURS}
    names: list[str] = []
    frames: set[tuple[int, int]] = set()
    for source in sources:
        names.append(source.name)
        frames.add(source.frame)
        coloured = replace(source, pattern=pattern)
        for place in plane_places(pattern):
            plane = mosaic_plane(source, place)
            found = selection.measured_in(plane, method)
            shown = coloured if place.colour == channel else source
            edges[place.colour].extend(with_sharpness(found, shown))
        progress(len(names))
        del source, coloured, shown, plane
    if not any(edge.is_used for edge in edges[channel]):
        raise _no_edge_error([f"{name} ({channel})" for name in names], edges[channel], PITCH_PX)
    frame = frames.pop() if len(frames) == 1 else None
    channels = {
        colour: _psf_of_edges(found, method, frame if colour == channel else None)
        for colour, found in edges.items()
        if any(edge.is_used for edge in found)
    }
    colours = {
        colour: ColourPsf.of(one.total, one.optical, edge_count=len(one.edges_used))
        for colour, one in channels.items()
    }
    return channels[channel].model_copy(update={"channels": colours})
