"""Epipolar geometry once more, by all pixels: what is left across the lines is not parallax.

Matched features place the lines to some tenths of a pixel. Across them nothing can move in a rigid
scene, so that slopes and residuals of all pixels tell how the plane and the epipole err.
"""

import numpy as np

from calibration.parallax._epipolar import EpipolarGeometry
from calibration.parallax._matching import AlignedViews
from calibration.parallax._refinement import SmoothedViews
from simulation.arrays import BoolArray, Float32Array

_SAMPLES = 200_000
_PRIOR_PX = 1.0
"""Standard deviation of what the features leave."""

_CORRELATED = 10.0
"""Pixels that say the same: residuals are of smoothed photographs."""


def corrected_geometry(
    geometry: EpipolarGeometry, views: AlignedViews, parallax_px: Float32Array, matched: BoolArray
) -> EpipolarGeometry:
    """The geometry that leaves least across its lines.

    ``views``: in their own light, aligned by the geometry. ``parallax_px``: where ``matched``.
    """
    seen = SmoothedViews.of(views).residuals(parallax_px, matched)
    rows, cols = np.nonzero(seen.counts)
    step = max(len(rows) // _SAMPLES, 1)
    rows, cols = rows[::step], cols[::step]
    if not len(rows):
        return geometry
    height, width = parallax_px.shape
    # Coordinates of order 1, so that all parameters are displacements in pixels at a border.
    size = max(height, width) / 2
    x, y = (cols - (width - 1) / 2) / size, (rows - (height - 1) / 2) / size
    u, v = (one[rows, cols].astype(np.float64) for one in (views.to_x, views.to_y))
    right_x, right_y = -v, u
    one = np.ones_like(x)
    homogeneous = np.stack([x, y, one])
    moved = [
        *(right_x * part for part in homogeneous),
        *(right_y * part for part in homogeneous),
        *(-(right_x * x + right_y * y) * part for part in homogeneous[:2]),
    ]
    tangents = np.linalg.svd(geometry.epipole[None])[2][1:]
    turned = []
    for tangent in tangents:
        away = geometry.epipole[0] - geometry.epipole[2] * cols
        down = geometry.epipole[1] - geometry.epipole[2] * rows
        length = np.maximum(np.hypot(away, down), 1e-12)
        side = right_x * (tangent[0] - tangent[2] * cols) + right_y * (
            tangent[1] - tangent[2] * rows
        )
        sign = 1.0 if geometry.epipole[2] >= 0 else -1.0
        turned.append(sign * parallax_px[rows, cols] * side / length)
    scales = [max(float(np.sqrt(np.mean(part**2))), 1e-12) for part in turned]
    basis = np.stack([*moved, *(part / scale for part, scale in zip(turned, scales, strict=True))])
    slope, left, weight = (
        image[rows, cols].astype(np.float64) for image in (seen.across, seen.left, seen.weight)
    )
    design = basis * slope
    normal = (design * weight) @ design.T * step / _CORRELATED + np.eye(10) / _PRIOR_PX**2
    found = np.linalg.solve(normal, design @ (weight * left) * step / _CORRELATED)
    plane = np.array([[*found[:3]], [*found[3:6]], [*found[6:8], 0.0]])
    plane /= size
    to_unit = np.array(
        [[1 / size, 0, -(width - 1) / 2 / size], [0, 1 / size, -(height - 1) / 2 / size], [0, 0, 1]]
    )
    change = np.eye(3) + np.linalg.inv(to_unit) @ plane @ to_unit
    epipole = geometry.epipole + sum(
        part / scale * tangent
        for part, scale, tangent in zip(found[8:], scales, tangents, strict=True)
    )
    return geometry.with_(change, epipole / np.linalg.norm(epipole))
