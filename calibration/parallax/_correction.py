"""Errors of a plane and an epipole, by what is left across the epipolar lines.

In a rigid scene nothing moves across them. To first order a change of the plane displaces a pixel
there by eight terms, one of the epipole by two in proportion to the parallax. Features and, after
them, the slopes and residuals of all pixels tell how much.
"""

from dataclasses import dataclass

import numpy as np

from calibration.parallax._refinement import SmoothedViews
from calibration.parallax._views import AlignedViews
from simulation.arrays import BoolArray, Float32Array, FloatArray

_SAMPLES = 200_000
_PRIOR_PX = 1.0
"""Standard deviation of what features leave."""

_CORRELATED = 10.0
"""Pixels that say the same: residuals are of smoothed photographs."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Correction:
    """What a plane and an epipole lack: a change (3, 3) of the plane, and a better epipole (3,)."""

    change: FloatArray
    epipole: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Places:
    """Places in a frame, with their parallax, and what changes displace them across their lines.

    ``basis``: displacements to the right of the line, by the ten terms, shape (10, n), in px of
    order 1 each.
    """

    basis: FloatArray
    to_unit: FloatArray
    tangents: FloatArray
    scales: list[float]
    epipole: FloatArray

    @classmethod
    def of(
        cls, x_px: FloatArray, y_px: FloatArray, parallax_px: FloatArray, epipole: FloatArray
    ) -> "_Places":
        """``epipole``: homogeneous, of length 1."""
        middle_x, middle_y = float(np.mean(x_px)), float(np.mean(y_px))
        size = max(float(np.ptp(x_px)), float(np.ptp(y_px)), 1.0) / 2
        x, y = (x_px - middle_x) / size, (y_px - middle_y) / size
        away, down = epipole[0] - epipole[2] * x_px, epipole[1] - epipole[2] * y_px
        length = np.maximum(np.hypot(away, down), 1e-12)
        right_x, right_y = -down / length, away / length
        places = (x, y, np.ones_like(x))
        terms = [
            *(right_x * part for part in places),
            *(right_y * part for part in places),
            *(-(right_x * x + right_y * y) * part for part in places[:2]),
        ]
        tangents = np.linalg.svd(epipole[None])[2][1:]
        scales = []
        for tangent in tangents:
            side = right_x * (tangent[0] - tangent[2] * x_px)
            side += right_y * (tangent[1] - tangent[2] * y_px)
            term = parallax_px * side / length
            scales.append(max(float(np.sqrt(np.mean(term**2))), 1e-12))
            terms.append(term / scales[-1])
        to_unit = np.array(
            [[1 / size, 0, -middle_x / size], [0, 1 / size, -middle_y / size], [0, 0, 1]]
        )
        return cls(
            basis=np.stack(terms),
            to_unit=to_unit,
            tangents=np.asarray(tangents, dtype=np.float64),
            scales=scales,
            epipole=epipole,
        )

    def correction(self, found: FloatArray) -> Correction:
        """The change that the ten terms make."""
        plane = np.array([[*found[:3]], [*found[3:6]], [*found[6:8], 0.0]]) * self.to_unit[0, 0]
        change = np.eye(3) + np.linalg.inv(self.to_unit) @ plane @ self.to_unit
        epipole = self.epipole.copy()
        for part, scale, tangent in zip(found[8:], self.scales, self.tangents, strict=True):
            epipole = epipole + part / scale * tangent
        return Correction(
            change=np.asarray(change, dtype=np.float64),
            epipole=np.asarray(epipole / np.linalg.norm(epipole), dtype=np.float64),
        )


def correction_of_features(
    own_px: FloatArray, parallax_px: FloatArray, aside_px: FloatArray, epipole: FloatArray
) -> Correction:
    """What matches (n, 2) ask for that lie aside of their lines, to the right."""
    places = _Places.of(own_px[:, 0], own_px[:, 1], parallax_px, epipole)
    weight = 1 / np.maximum(np.abs(aside_px), np.median(np.abs(aside_px)) + 1e-9)
    weight = weight / np.max(weight)
    normal = (places.basis * weight) @ places.basis.T + 1e-3 * np.eye(10)
    found = np.linalg.solve(normal, places.basis @ (weight * aside_px))
    return places.correction(np.asarray(found, dtype=np.float64))


def correction_of_pixels(
    views: AlignedViews, parallax_px: Float32Array, matched: BoolArray, epipole: FloatArray
) -> Correction | None:
    """What all pixels ask for; None where none is matched.

    ``views``: in their own light, aligned by the plane. ``parallax_px``: where ``matched``.
    """
    seen = SmoothedViews.of(views).residuals(parallax_px, matched)
    rows, cols = np.nonzero(seen.counts)
    step = max(len(rows) // _SAMPLES, 1)
    rows, cols = rows[::step], cols[::step]
    if not len(rows):
        return None
    slope, left, weight, parallax = (
        image[rows, cols].astype(np.float64)
        for image in (seen.across, seen.left, seen.weight, parallax_px)
    )
    places = _Places.of(cols.astype(np.float64), rows.astype(np.float64), parallax, epipole)
    design = places.basis * slope
    share = step / _CORRELATED
    normal = (design * weight) @ design.T * share + np.eye(10) / _PRIOR_PX**2
    found = np.linalg.solve(normal, design @ (weight * left) * share)
    return places.correction(np.asarray(found, dtype=np.float64))
