"""Squares and crossing edges as a sensor sees them, in closed form at points of each pixel."""

import numpy as np

from simulation.arrays import FloatArray
from tests.calibration.closed_form import pixel_edge, point_edge

NODES = 4
"""Gauss-Legendre points per axis of a pixel: exact to 1e-5 of the contrast at sigma 0.5."""


def square_cover(
    centre_px: tuple[float, float],
    side_px: float,
    turn_deg: float,
    sigma_px: float,
    shape: tuple[int, int],
) -> FloatArray:
    """How much of each pixel a blurred square about ``centre_px`` (x, y) covers, 0 to 1.

    At a point a turned square is the product of two pairs of edges; the pixel averages it.
    """
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    x -= centre_px[0]
    y -= centre_px[1]
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    cover = np.zeros(shape)
    half = side_px / 2
    for dx, wx in zip(nodes / 2, weights / 2, strict=True):
        for dy, wy in zip(nodes / 2, weights / 2, strict=True):
            u, v = c * (x + dx) + s * (y + dy), -s * (x + dx) + c * (y + dy)
            inside = point_edge(half - u, sigma_px) - point_edge(-half - u, sigma_px)
            inside *= point_edge(half - v, sigma_px) - point_edge(-half - v, sigma_px)
            cover += wx * wy * inside
    return cover


def chart(
    rows: int,
    cols: int,
    *,
    pitch_px: float = 48.0,
    side_px: float = 28.0,
    turn_deg: float = 7.0,
    sigma_px: float = 0.8,
    shear: float = 0.0,
) -> FloatArray:
    """Cover of a chart of squares, as many as fit; ``shear`` turns those further right more."""
    cover = np.zeros((rows, cols))
    reach = int(side_px)
    for top in np.arange(pitch_px / 2, rows - pitch_px / 2 + 1, pitch_px):
        for left in np.arange(pitch_px / 2, cols - pitch_px / 2 + 1, pitch_px):
            y0, x0 = int(top) - reach, int(left) - reach
            y1, x1 = max(y0, 0), max(x0, 0)
            part = cover[y1 : y0 + 2 * reach + 1, x1 : x0 + 2 * reach + 1]
            turn = turn_deg + shear * left / cols
            part += square_cover(
                (left - x1, top - y1),
                side_px,
                turn,
                sigma_px,
                (part.shape[0], part.shape[1]),
            )
    return cover


def crossing(
    normals_deg: tuple[float, float],
    offsets_px: tuple[float, float],
    sigma_px: float,
    shape: tuple[int, int] = (110, 120),
) -> tuple[FloatArray, FloatArray]:
    """Two unit edges that cross near the middle of the image, each averaged over the pixel."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    x -= (shape[1] - 1) / 2
    y -= (shape[0] - 1) / 2
    first, second = (
        pixel_edge(np.cos(n) * x + np.sin(n) * y - offset, sigma_px, n, nodes=6)
        for n, offset in zip(np.deg2rad(normals_deg), offsets_px, strict=True)
    )
    return first, second
