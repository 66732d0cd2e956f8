"""Where two poses of a camera overlap, the coarsest sampling; and the worst way to lean."""

from math import atan2, degrees

import numpy as np
from numpy.typing import NDArray

from analysis.local_sampling import sampled_places
from analysis.viewing_camera import ViewingCamera

__all__ = ["worst_zoom"]

FloatArray = NDArray[np.float64]

_DIRECTIONS = 13
_REFINED = 3
_REFINED_STEPS = 11
_REFINEMENTS = 2
_ON_THE_BORDER_PX = 1e-6


def worst_zoom(
    camera: ViewingCamera,
    zoom: float,
    tilt_deg: float,
    reference_tilt_deg: float = 0.0,
    direction_deg: float | None = None,
) -> float:
    """Largest local zoom in the overlap, infinite where the horizon comes into the frame.

    ``direction_deg`` is where the follow-up leans, from the reference's lean (x where that is
    upright); None for the worst direction, to 1e-4 of its zoom.
    """

    def along(directions_deg: FloatArray) -> FloatArray:
        return _worst_zooms(
            camera.followup_to_reference(zoom, tilt_deg, reference_tilt_deg, directions_deg),
            camera.size,
        )

    if direction_deg is not None:
        return float(along(np.array([direction_deg]))[0])
    if tilt_deg == 0:
        return float(along(np.zeros(1))[0])
    if reference_tilt_deg == 0:
        # The frame's symmetry leaves its axes and diagonals.
        diagonal_deg = degrees(atan2(camera.height_px, camera.width_px))
        return float(along(np.array([0.0, diagonal_deg, 90.0])).max())
    # Both sides of the reference's lean are alike.
    tried_deg, step_deg = np.linspace(0.0, 180.0, _DIRECTIONS, retstep=True)
    found = along(tried_deg)
    is_peak = np.concatenate([[True], found[1:] >= found[:-1]])
    is_peak &= np.concatenate([found[:-1] >= found[1:], [True]])
    peaks_deg = tried_deg[is_peak][np.argsort(found[is_peak])[-_REFINED:]]
    worst = float(found.max())
    for _ in range(_REFINEMENTS):
        beside = np.linspace(-step_deg, step_deg, _REFINED_STEPS)
        step_deg *= 2 / (_REFINED_STEPS - 1)
        tried_deg = peaks_deg[:, None] + beside
        found = along(tried_deg.ravel()).reshape(tried_deg.shape)
        peaks_deg = np.take_along_axis(tried_deg, found.argmax(axis=1)[:, None], axis=1)[:, 0]
        worst = max(worst, float(found.max()))
    return worst


def _worst_zooms(matrices: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Largest local zoom of each homography, shape (n, 3, 3), over the overlap of two frames.

    The overlap is a convex polygon, and the largest zoom lies at one of its corners: a corner of
    either frame, or where their borders cross. (Along a side the zoom may rise in between only
    where the plane is seen so aslant that the frame reaches further sideways than towards the
    horizon.)
    """
    width, height = size
    followup = _corners(0.0, 0.0, width - 1.0, height - 1.0)
    reference = _corners(-0.5, -0.5, width - 0.5, height - 0.5)
    depths = matrices[:, 2] @ followup.T
    sees_plane = np.all(depths > 0, axis=1) | np.all(depths < 0, axis=1)
    mapped = np.einsum("dij,nj->dni", np.linalg.inv(matrices), reference)
    borders = np.einsum("dji,nj->dni", matrices, _sides(reference))
    crossings = np.cross(_sides(followup)[:, None], borders[:, None])
    places = np.concatenate(
        [
            np.broadcast_to(followup, mapped.shape),
            mapped,
            crossings.reshape(len(matrices), -1, 3),
        ],
        axis=1,
    )
    # Parallel borders cross nowhere, and a place may lie in the reference camera's own plane.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        places = places / places[..., 2:]
        seen_x, seen_y, zooms, _ = sampled_places(matrices[:, None], places[..., 0], places[..., 1])
    seen = np.stack([seen_x, seen_y], axis=-1)
    is_corner = _is_within(places, followup) & _is_within(seen, reference)
    worst = np.where(is_corner, zooms, -np.inf).max(axis=1)
    return np.asarray(np.where(sees_plane & is_corner.any(axis=1), worst, np.inf))


def _corners(left: float, top: float, right: float, bottom: float) -> FloatArray:
    return np.array(
        [[left, top, 1.0], [right, top, 1.0], [right, bottom, 1.0], [left, bottom, 1.0]]
    )


def _sides(corners: FloatArray) -> FloatArray:
    return np.asarray(np.cross(corners, np.roll(corners, -1, axis=0)))


def _is_within(places: FloatArray, corners: FloatArray) -> NDArray[np.bool_]:
    least, most = corners[0, :2] - _ON_THE_BORDER_PX, corners[2, :2] + _ON_THE_BORDER_PX
    at = places[..., :2]
    return np.asarray(np.all((at >= least) & (at <= most), axis=-1))
