"""Edges as they are measured, made from nothing but their widths."""

from math import sqrt

import numpy as np

from calibration.edges import EdgeMeasurement, orientation_of

ERR_PX = 0.004
FOCAL_PX, PUPIL_MM = 964.0, 12.5
SIDE_MM = 10.0


def edge(
    *,
    sigma_px: float = 0.7,
    angle_deg: float = 5.0,
    capture: int | None = 0,
    image: str = "edge.tif",
    height_mm: float | None = None,
    place_px: tuple[float, float] = (100.0, 100.0),
    length_px: float = 40.0,
) -> EdgeMeasurement:
    """One edge without its pixels."""
    return EdgeMeasurement(
        image=image,
        capture=capture,
        height_mm=height_mm,
        x_px=place_px[0],
        y_px=place_px[1],
        angle_deg=angle_deg % 180.0,
        orientation=orientation_of(angle_deg % 180.0),
        length_px=length_px,
        snr=100.0,
        sigma_px=sigma_px,
        sigma_err_px=ERR_PX,
        optical_sigma_px=sqrt(max(sigma_px**2 - 1 / 12, 1e-4)),
        optical_sigma_err_px=ERR_PX,
        mtf50_cy_per_px=0.3,
        chi2_reduced=1.0,
        flags=(),
    )


def square(
    variance_px2: float,
    height_mm: float,
    capture: int,
    rng: np.random.Generator,
    *,
    read_mm: float | None = None,
) -> list[EdgeMeasurement]:
    """The four sides of a square of 10 mm, seen from a height by a pinhole."""
    turn = float(rng.uniform(0.0, 90.0))
    side_px = SIDE_MM * FOCAL_PX / (height_mm + PUPIL_MM)
    sides = []
    for k in range(4):
        normal = np.deg2rad(turn + 90.0 * k)
        place = 0.5 * side_px * np.array([np.cos(normal), np.sin(normal)])
        sides.append(
            edge(
                sigma_px=sqrt(variance_px2) + float(rng.normal(0.0, ERR_PX)),
                angle_deg=turn + 90.0 * k + 90.0,
                capture=capture,
                height_mm=height_mm if read_mm is None else read_mm,
                place_px=(100.0 + float(place[0]), 100.0 + float(place[1])),
                length_px=side_px - 9.0,
            )
        )
    return sides


def series(
    rng: np.random.Generator,
    *,
    camera_px2: float = 0.5,
    blur_mm: float = 0.0,
    heights_mm: tuple[float, ...] = (180.0, 220.0, 270.0, 330.0, 400.0),
) -> list[EdgeMeasurement]:
    """Squares from several heights, of a target of this blur."""
    edges = []
    for capture, height_mm in enumerate(heights_mm):
        scale = FOCAL_PX / (height_mm + PUPIL_MM)
        edges += square(camera_px2 + (blur_mm * scale) ** 2, height_mm, capture, rng)
    return edges
