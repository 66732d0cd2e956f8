"""From photographs of edges to the PSF of the camera: the whole measurement, without files."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.choices import CalibrationMethod
from calibration.edges import (
    PITCH_PX,
    REJECTING_FLAGS,
    EdgeImage,
    EdgeMeasurement,
    MeasuredTransfer,
    Method,
    Pattern,
    PlanePlace,
    Region,
    mean_transfer,
    measure_edges,
    plane_places,
)
from calibration.errors import NoEdgeError
from calibration.psf.covariance import (
    CovarianceFit,
    Estimate,
    fit_covariance,
    median_width,
)
from calibration.psf.field import FieldEdges, FieldFit, fit_psf_field
from calibration.psf.height_trend import HeightTrend, fit_height_trend

__all__ = [
    "COLOURS",
    "REJECTING_FLAGS",
    "CalibrationMethod",
    "EdgeImage",
    "EdgeMeasurement",
    "Method",
    "PairWidths",
    "PsfCalibration",
    "Region",
    "calibrate_mosaic",
    "calibrate_psf",
    "measure_edges",
    "plane_source",
    "psf_of_edges",
    "why_no_edge",
]

_LEAST_ERR_PX = 1e-9  # noise-free edges have no error, but need a finite weight


@dataclass(frozen=True, slots=True, kw_only=True)
class PairWidths:
    """Total PSF that one pair of photographs at two distances tells."""

    near: str
    far: str
    zoom: float
    sigma_x_px: float
    sigma_x_err_px: float
    sigma_y_px: float
    sigma_y_err_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PsfCalibration:
    """The PSF of a camera: total and optical, None for what the edges do not determine.

    Total is optics and pixel together, what equation (1) of the paper calls Sigma. ``field``
    and ``optical_field`` are None where one PSF holds for the whole frame, as far as the edges
    tell. ``channels`` holds the calibrations of the colours of a mosaic by name. ``pairs`` is what
    a calibration by two distances rests on, ``softness_px2`` the variance that the scene adds on
    average where a single image was all there was.
    """

    sigma_x_px: Estimate | None
    sigma_y_px: Estimate | None
    rho: Estimate | None
    covariance_px2: NDArray[np.float64] | None
    optical_sigma_x_px: Estimate | None
    optical_sigma_y_px: Estimate | None
    optical_rho: Estimate | None
    optical_covariance_px2: NDArray[np.float64] | None
    method: CalibrationMethod = "all-angles"
    edges: tuple[EdgeMeasurement, ...] = ()
    field: FieldFit | None = None
    optical_field: FieldFit | None = None
    height_trend: HeightTrend | None = None
    transfer: MeasuredTransfer | None = None
    channels: "dict[str, PsfCalibration] | None" = None
    pairs: tuple[PairWidths, ...] = ()
    softness_px2: float | None = None

    @property
    def edges_used(self) -> tuple[EdgeMeasurement, ...]:
        """The edges that count."""
        return tuple(edge for edge in self.edges if edge.is_used)


def calibrate_psf(
    sources: Iterable[EdgeImage],
    *,
    method: Method = "all-angles",
    region: Callable[[EdgeImage], Region | None] = lambda _: None,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the PSF from photographs of straight edges.

    Parameters
    ----------
    sources
        The photographs, read one at a time.
    method
        ``paper`` is the paper's own way: medians over vertical and horizontal edges of
        Gaussians fitted to binned line spread functions.
    region
        Gives the part of each photograph that is used; None for all of it.
    progress
        Called with the number of photographs done.

    Raises
    ------
    NoEdgeError
        If no edge is found, or none that may count; the message says why.
    """
    edges: list[EdgeMeasurement] = []
    names: list[str] = []
    frames: set[tuple[int, int]] = set()
    for done, source in enumerate(sources, start=1):
        names.append(source.name)
        frames.add(source.frame)
        edges.extend(measure_edges(source, region(source), method))
        progress(done)
    used = [edge for edge in edges if edge.is_used]
    if not used:
        raise NoEdgeError(why_no_edge(names, edges))
    return psf_of_edges(edges, method, frames.pop() if len(frames) == 1 else None)


def psf_of_edges(
    edges: Sequence[EdgeMeasurement],
    method: Method = "all-angles",
    frame: tuple[int, int] | None = None,
) -> PsfCalibration:
    """Work out the PSF from measured edges, one of which at least counts.

    Parameters
    ----------
    edges
        All edges; those that do not count are kept in the list.
    method
        How they were measured.
    frame
        Rows and columns of the photographs; None where they differ, and there is no field.
    """
    used = [edge for edge in edges if edge.is_used]
    total = _medians(used) if method == "paper" else _fit(used, is_optical=False)
    optical = None
    if resolved := [edge for edge in used if edge.fit.optical_sigma_px is not None]:
        optical = _fit(resolved, is_optical=True)
    calibration = PsfCalibration(
        sigma_x_px=total.sigma_x_px,
        sigma_y_px=total.sigma_y_px,
        rho=total.rho,
        covariance_px2=total.covariance_px2,
        optical_sigma_x_px=optical.sigma_x_px if optical else None,
        optical_sigma_y_px=optical.sigma_y_px if optical else None,
        optical_rho=optical.rho if optical else None,
        optical_covariance_px2=optical.covariance_px2 if optical else None,
        method=method,
        edges=tuple(edges),
        height_trend=_height_trend(used, total),
        transfer=_transfer(used),
    )
    if method == "paper" or frame is None:
        return calibration
    rows, cols = frame
    whole = fit_psf_field(_field_edges(used, is_optical=False), cols, rows)
    if whole is None:
        return calibration
    lens = None
    if resolved:
        lens = fit_psf_field(_field_edges(resolved, is_optical=True), cols, rows, is_asked=False)
    return replace(calibration, field=whole, optical_field=lens)


def _widths(
    edges: Sequence[EdgeMeasurement], *, is_optical: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    pairs = [
        (edge.fit.optical_sigma_px or 0.0, edge.fit.optical_sigma_err_px or 0.0)
        if is_optical
        else (edge.fit.sigma_px, edge.fit.sigma_err_px)
        for edge in edges
    ]
    sigma, err = np.array(pairs).T
    return sigma, np.maximum(err, _LEAST_ERR_PX)


def _angles(edges: Sequence[EdgeMeasurement]) -> NDArray[np.float64]:
    return np.array([edge.fit.angle_deg for edge in edges])


def _fit(edges: Sequence[EdgeMeasurement], *, is_optical: bool) -> CovarianceFit:
    return fit_covariance(_angles(edges), *_widths(edges, is_optical=is_optical))


def _medians(edges: Sequence[EdgeMeasurement]) -> CovarianceFit:
    medians = {}
    for orientation in ("vertical", "horizontal"):
        chosen = [edge for edge in edges if edge.orientation == orientation]
        medians[orientation] = median_width(*_widths(chosen, is_optical=False)) if chosen else None
    return CovarianceFit(
        sigma_x_px=medians["vertical"],
        sigma_y_px=medians["horizontal"],
        rho=None,
        covariance_px2=None,
        scatter_px=0.0,
        weights=np.array([float(edge.orientation != "diagonal") for edge in edges]),
    )


def _field_edges(edges: Sequence[EdgeMeasurement], *, is_optical: bool) -> FieldEdges:
    sigma, err = _widths(edges, is_optical=is_optical)
    return FieldEdges(
        x_px=np.array([edge.fit.x_px for edge in edges]),
        y_px=np.array([edge.fit.y_px for edge in edges]),
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


def _height_trend(edges: Sequence[EdgeMeasurement], total: CovarianceFit) -> HeightTrend | None:
    heights, widths, errs = [], [], []
    for edge in edges:
        expected = _expected_width(edge, total)
        if edge.height_mm is None or expected is None:
            continue
        heights.append(edge.height_mm)
        widths.append(edge.fit.sigma_px / expected)
        errs.append(max(edge.fit.sigma_err_px, _LEAST_ERR_PX) / expected)
    return fit_height_trend(np.array(heights), np.array(widths), np.array(errs))


def _expected_width(edge: EdgeMeasurement, total: CovarianceFit) -> float | None:
    """Width of the whole calibration across this edge's direction."""
    if total.covariance_px2 is not None:
        normal = np.array([np.cos(edge.fit.normal_rad), np.sin(edge.fit.normal_rad)])
        return float(np.sqrt(normal @ total.covariance_px2 @ normal))
    axis = {"vertical": total.sigma_x_px, "horizontal": total.sigma_y_px}.get(edge.orientation)
    return None if axis is None else axis.value


def why_no_edge(names: list[str], edges: list[EdgeMeasurement]) -> str:
    """Return the line that says why none of the edges of these photographs counts."""
    where = names[0] if len(names) == 1 else f"{len(names)} images"
    if not edges:
        return f"{where}: no straight edge found; photograph a sharp edge of dark on white"
    faults = sorted({flag for edge in edges for flag in edge.flags if flag in REJECTING_FLAGS})
    remedy = {
        "saturated": "shorten the exposure",
        "too_short": "photograph an edge of at least 20 px",
        "too_noisy": "add light or average more frames",
    }
    reasons = "; ".join(f"{flag.replace('_', ' ')}: {remedy[flag]}" for flag in faults)
    return f"{where}: none of the {len(edges)} edges can be used ({reasons})"


COLOURS = ("red", "green", "blue")


def plane_source(source: EdgeImage, place: PlanePlace) -> EdgeImage:
    """Return one colour plane of a photograph that is a mosaic."""
    clipped = source.clipped
    return replace(
        source,
        image_dn=place.plane(source.image_dn),
        clipped=None if clipped is None else place.plane(clipped).astype(np.bool_),
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
    region: Callable[[EdgeImage], Region | None] = lambda _: None,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the PSF of every colour of a mosaic, in pixels of the sensor.

    Parameters
    ----------
    sources
        The mosaics, read one at a time.
    pattern
        Colours of the mosaic.
    channel
        The colour whose values are returned; the others stand in ``channels``.
    method, region, progress
        As in ``calibrate_psf``.

    Raises
    ------
    NoEdgeError
        If that colour has no edge that may count.
    """
    edges: dict[str, list[EdgeMeasurement]] = {colour: [] for colour in COLOURS}
    names: list[str] = []
    frames: set[tuple[int, int]] = set()
    for done, source in enumerate(sources, start=1):
        names.append(source.name)
        frames.add(source.frame)
        chosen = region(source)
        for place in plane_places(pattern):
            plane = plane_source(source, place)
            edges[place.colour].extend(measure_edges(plane, chosen, method))
        progress(done)
    if not any(edge.is_used for edge in edges[channel]):
        raise NoEdgeError(why_no_edge([f"{name} ({channel})" for name in names], edges[channel]))
    frame = frames.pop() if len(frames) == 1 else None
    channels = {
        colour: psf_of_edges(found, method, frame if colour == channel else None)
        for colour, found in edges.items()
        if any(edge.is_used for edge in found)
    }
    return replace(channels[channel], channels=channels)
