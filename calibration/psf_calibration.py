"""From photographs of edges to the PSF of the camera: the whole measurement, without files."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.covariance_fit import CovarianceFit, Estimate, fit_covariance, orientation_of
from calibration.edge_detection import find_edges
from calibration.edge_fit import EdgeFit, fit_edge
from calibration.errors import NoEdgeError
from calibration.mtf import gaussian_mtf50, pixel_mtf50
from calibration.noise_model import LevelNoise

__all__ = [
    "REJECTING_FLAGS",
    "EdgeImage",
    "EdgeMeasurement",
    "PsfCalibration",
    "Region",
    "calibrate_psf",
    "measure_edges",
]

REJECTING_FLAGS = frozenset({"saturated", "too_short", "too_noisy"})
"""Flags of edges that do not count; the others are remarks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """Part of an image that is used, in px: left, top, width and height."""

    x_px: int
    y_px: int
    width_px: int
    height_px: int

    @classmethod
    def centre(cls, rows: int, cols: int) -> "Region":
        """Return the central half along both axes, which the paper's PSF stands for."""
        return cls(
            x_px=cols // 4,
            y_px=rows // 4,
            width_px=cols - 2 * (cols // 4),
            height_px=rows - 2 * (rows // 4),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeImage:
    """One photograph with edges: a plane linear in light, and what is known about it."""

    name: str
    image_dn: NDArray[np.float64]
    capture: int | None = None
    height_mm: float | None = None
    noise: LevelNoise | None = None
    saturation_dn: float | None = None
    is_jpeg: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeMeasurement:
    """The fit of one edge, and where it comes from."""

    image: str
    capture: int | None
    height_mm: float | None
    fit: EdgeFit
    flags: tuple[str, ...]

    @property
    def orientation(self) -> str:
        """Name of the edge's direction: vertical, horizontal or diagonal."""
        return orientation_of(self.fit.angle_deg)

    @property
    def is_used(self) -> bool:
        """Whether the edge counts in the PSF."""
        return not REJECTING_FLAGS & set(self.flags)

    @property
    def mtf50_cy_per_px(self) -> float:
        """Frequency of half contrast across the edge, of the fitted Gaussian with its pixel."""
        if self.fit.optical_sigma_px is None:
            return gaussian_mtf50(self.fit.sigma_px)
        return pixel_mtf50(self.fit.optical_sigma_px, self.fit.normal_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class PsfCalibration:
    """The PSF of a camera: total and optical, None for what the edges do not determine.

    Total is optics and pixel together, what equation (1) of the paper calls Sigma.
    """

    sigma_x_px: Estimate | None
    sigma_y_px: Estimate | None
    rho: Estimate | None
    covariance_px2: NDArray[np.float64] | None
    optical_sigma_x_px: Estimate | None
    optical_sigma_y_px: Estimate | None
    optical_rho: Estimate | None
    optical_covariance_px2: NDArray[np.float64] | None
    method: Literal["all-angles"] = "all-angles"
    edges: tuple[EdgeMeasurement, ...] = field(default=())

    @property
    def edges_used(self) -> tuple[EdgeMeasurement, ...]:
        """The edges that count."""
        return tuple(edge for edge in self.edges if edge.is_used)


def measure_edges(source: EdgeImage, region: Region | None = None) -> list[EdgeMeasurement]:
    """Find and fit every straight edge of one photograph.

    Parameters
    ----------
    source
        The photograph.
    region
        Only pixels inside it are used; places are given in the whole image.

    Raises
    ------
    ValueError
        If the region does not lie inside the image.
    """
    rows, cols = source.image_dn.shape
    image = source.image_dn
    left = top = 0
    if region is not None:
        left, top = region.x_px, region.y_px
        right, bottom = left + region.width_px, top + region.height_px
        if not (0 <= left < right <= cols and 0 <= top < bottom <= rows):
            raise ValueError(f"region {region} does not lie inside {source.name} ({cols}x{rows})")
        image = image[top:bottom, left:right]
    measurements = []
    for segment in find_edges(image):
        fit = fit_edge(image, segment, noise=source.noise, saturation_dn=source.saturation_dn)
        if fit is not None:
            measurements.append(_measurement(source, fit, left, top))
    return measurements


def _measurement(source: EdgeImage, fit: EdgeFit, left: int, top: int) -> EdgeMeasurement:
    moved = fit.moved(left, top)
    flags = (*fit.flags, "jpeg") if source.is_jpeg else fit.flags
    return EdgeMeasurement(
        image=source.name,
        capture=source.capture,
        height_mm=source.height_mm,
        fit=moved,
        flags=flags,
    )


def calibrate_psf(
    sources: Iterable[EdgeImage],
    *,
    region: Callable[[EdgeImage], Region | None] = lambda _: None,
    progress: Callable[[int], None] = lambda _: None,
) -> PsfCalibration:
    """Measure the PSF from photographs of straight edges.

    Parameters
    ----------
    sources
        The photographs, read one at a time.
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
    for done, source in enumerate(sources, start=1):
        names.append(source.name)
        edges.extend(measure_edges(source, region(source)))
        progress(done)
    used = [edge for edge in edges if edge.is_used]
    if not used:
        raise NoEdgeError(_why_none(names, edges))
    total = _fit(used, [(e.fit.sigma_px, e.fit.sigma_err_px) for e in used])
    resolved = [
        (e, e.fit.optical_sigma_px, e.fit.optical_sigma_err_px)
        for e in used
        if e.fit.optical_sigma_px is not None and e.fit.optical_sigma_err_px is not None
    ]
    optical = None
    if resolved:
        optical = _fit([e for e, _, _ in resolved], [(s, err) for _, s, err in resolved])
    return PsfCalibration(
        sigma_x_px=total.sigma_x_px,
        sigma_y_px=total.sigma_y_px,
        rho=total.rho,
        covariance_px2=total.covariance_px2,
        optical_sigma_x_px=optical.sigma_x_px if optical else None,
        optical_sigma_y_px=optical.sigma_y_px if optical else None,
        optical_rho=optical.rho if optical else None,
        optical_covariance_px2=optical.covariance_px2 if optical else None,
        edges=tuple(edges),
    )


def _fit(edges: list[EdgeMeasurement], widths: list[tuple[float, float]]) -> CovarianceFit:
    return fit_covariance(
        np.array([edge.fit.angle_deg for edge in edges]),
        np.array([width for width, _ in widths]),
        np.array([max(err, 1e-9) for _, err in widths]),
    )


def _why_none(names: list[str], edges: list[EdgeMeasurement]) -> str:
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
