"""Photographs of edges through a lens whose PSF changes over the frame, in closed form."""

import numpy as np
from scipy.special import ndtr

from calibration.edges import EdgeImage
from simulation.psf import PsfField

COLS, ROWS = 520, 390
LOW_DN, HIGH_DN = 500.0, 3300.0

# Elements xx, xy, yy over 1, u, v, u^2, uv, v^2: softer by half towards the corners, tilted there.
FIELD = PsfField(
    width_px=COLS,
    height_px=ROWS,
    coefficients_px2=np.array(
        [
            [0.62, 0.05, -0.03, 0.55, 0.00, 0.20],
            [0.03, 0.00, 0.02, 0.00, 0.18, 0.00],
            [0.50, -0.04, 0.03, 0.22, 0.00, 0.50],
        ]
    ),
)


def edge_through(
    normal_deg: float,
    offset_px: float,
    field: PsfField = FIELD,
    rng: np.random.Generator | None = None,
    noise_dn: float = 0.0,
) -> EdgeImage:
    """An edge across the whole frame; each pixel sees the total PSF of its own place."""
    y, x = np.mgrid[:ROWS, :COLS].astype(np.float64)
    nx, ny = np.cos(np.deg2rad(normal_deg)), np.sin(np.deg2rad(normal_deg))
    distance = nx * (x - (COLS - 1) / 2) + ny * (y - (ROWS - 1) / 2) - offset_px
    near = np.abs(distance) < 15
    covariance = field.covariance_px2(x[near], y[near])
    normal = np.array([nx, ny])
    sigma = np.sqrt(np.einsum("i,nij,j->n", normal, covariance, normal))
    unit = (distance > 0).astype(np.float64)
    unit[near] = ndtr(distance[near] / sigma)
    image = LOW_DN + (HIGH_DN - LOW_DN) * unit
    if rng is not None:
        image += rng.normal(size=image.shape) * noise_dn
    return EdgeImage(name=f"edge-{normal_deg:g}-{offset_px:g}.tif", image_dn=image)


def frame_of_edges(
    count_offsets: int = 3, noise_dn: float = 0.0, seed: int = 5, field: PsfField = FIELD
) -> list[EdgeImage]:
    """Edges in eight directions, at several distances from the frame's centre."""
    rng = np.random.default_rng(seed)
    return [
        edge_through(6.0 + 22.5 * k, offset, field, rng if noise_dn else None, noise_dn)
        for k in range(8)
        for offset in np.linspace(-160.0, 160.0, count_offsets)
    ]
