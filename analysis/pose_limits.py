"""Allowed movement: how far away, how tilted and how far aside a follow-up may be taken."""

from collections.abc import Callable
from dataclasses import dataclass
from math import atan2, cos, degrees, radians, sin

import numpy as np
from numpy.typing import NDArray

from analysis.detectability_curves import DetectabilityCurve
from analysis.errors import AnalysisError
from analysis.local_sampling import local_sampling

__all__ = [
    "PoseLimits",
    "ViewingCamera",
    "contrast_found_at",
    "pose_limits",
    "shift_overlap",
    "worst_zoom",
]

FloatArray = NDArray[np.float64]

_TILT_LIMIT_DEG = 75.0
_STEP_PX = 16
_BISECTIONS = 40

_TILTS_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0)
_SHIFTS = (0.05, 0.1, 0.2, 0.3, 0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewingCamera:
    """A camera without distortion that looks at a plane.

    Raises
    ------
    ValueError
        If the focal length or the size is not positive.
    """

    focal_length_px: float
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        if not (self.focal_length_px > 0 and np.isfinite(self.focal_length_px)):
            raise ValueError(f"focal_length_px must be positive, got {self.focal_length_px}")
        if self.width_px < 16 or self.height_px < 16:
            raise ValueError(
                f"a frame of at least 16 x 16 px is needed, got {self.width_px} x {self.height_px}"
            )

    @property
    def size(self) -> tuple[int, int]:
        """``(width, height)`` in px."""
        return self.width_px, self.height_px

    def directions_deg(self, *, is_reference_tilted: bool) -> tuple[float, ...]:
        """Directions of a lean among which the worst is looked for: axes and diagonals.

        The frame is symmetric, so that a quarter of them will do for an upright reference; for a
        tilted one the worst lies beside them, and as many in between are tried.
        """
        diagonal = degrees(atan2(self.height_px, self.width_px))
        if not is_reference_tilted:
            return 0.0, diagonal, 90.0
        quarter = tuple(
            start + share * (end - start)
            for start, end in ((0.0, diagonal), (diagonal, 90.0))
            for share in (0.0, 1 / 3, 2 / 3, 1.0)
        )
        around = {sign * angle % 360 for angle in quarter for sign in (1, -1)}
        return tuple(sorted(around | {(angle + 180) % 360 for angle in around}))

    def plane_to_px(
        self, distance: float, tilt_deg: float, direction_deg: float = 0.0
    ) -> FloatArray:
        """Homography from the plane to pixels; the camera always looks at the plane's origin.

        Parameters
        ----------
        distance
            From the origin, in any unit; the plane's coordinates have the same.
        tilt_deg
            Angle between the axis and the plane's normal.
        direction_deg
            Where the axis leans, from the rows' x towards the columns' y.
        """
        t, b = radians(tilt_deg), radians(direction_deg)
        about = np.array([[cos(b), -sin(b), 0.0], [sin(b), cos(b), 0.0], [0.0, 0.0, 1.0]])
        leaning = np.array([[cos(t), 0.0, sin(t)], [0.0, 1.0, 0.0], [-sin(t), 0.0, cos(t)]])
        rotation = (about @ leaning @ about.T).T
        forward = rotation[2]
        centre = -distance * forward
        camera = np.array(
            [
                [self.focal_length_px, 0.0, (self.width_px - 1) / 2],
                [0.0, self.focal_length_px, (self.height_px - 1) / 2],
                [0.0, 0.0, 1.0],
            ]
        )
        seen = np.column_stack([rotation[:, 0], rotation[:, 1], -rotation @ centre])
        return np.asarray(camera @ seen)

    def followup_to_reference(
        self,
        zoom: float,
        tilt_deg: float,
        reference_tilt_deg: float = 0.0,
        direction_deg: float = 0.0,
    ) -> FloatArray:
        """Homography of a follow-up from ``zoom`` times the reference's distance.

        The reference leans along x, the follow-up in ``direction_deg`` from there.
        """
        near = self.plane_to_px(1.0, reference_tilt_deg)
        far = self.plane_to_px(zoom, tilt_deg, direction_deg)
        matrix = near @ np.linalg.inv(far)
        return np.asarray(matrix / matrix[2, 2])


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseLimits:
    """Movement that keeps d' at the threshold or above, everywhere in the overlap.

    Parameters
    ----------
    zoom
        Largest ratio of the distances for a straight move back, without any tilt.
    is_zoom_beyond_curve
        d' is above the threshold up to the curve's end: the true limit is larger.
    tilt_deg
        Largest tilt at equal distances, up to 75 degrees, in the direction asked for or in
        whichever is the worst; None if there is none.
    zoom_by_tilt
        Tilt in degrees and the largest ratio of the distances with it, None if there is none.
    overlap_by_shift
        Sideways movement as a share of the field of view's width, and the share of the frame
        that remains; the sampling does not change.
    """

    zoom: float
    is_zoom_beyond_curve: bool
    tilt_deg: float | None
    zoom_by_tilt: tuple[tuple[float, float | None], ...]
    overlap_by_shift: tuple[tuple[float, float], ...]


def pose_limits(
    curve: DetectabilityCurve,
    min_d_prime: float,
    camera: ViewingCamera,
    reference_tilt_deg: float = 0.0,
    direction_deg: float | None = None,
) -> PoseLimits:
    """Find the movement that a threshold of d' allows.

    Parameters
    ----------
    curve
        d' against zoom.
    min_d_prime
        Threshold.
    camera
        Takes both images and looks at the same point of the plane in both.
    reference_tilt_deg
        Tilt of the reference, along x.
    direction_deg
        Where the follow-up leans, from there; None for the worst direction.

    Raises
    ------
    AnalysisError
        If d' is below the threshold even at equal poses.
    """
    allowed = curve.largest_zoom(min_d_prime)
    if allowed is None:
        raise AnalysisError(
            f"d' is {curve.dprime[0]:.3g} at zoom {curve.zoom[0]:g} already, below "
            f"{min_d_prime:g}: lower --min-dprime, average more frames or look for a larger "
            "contrast"
        )
    # A follow-up that leans like its reference is the easiest; in any direction, an upright one.
    start = 0.0 if direction_deg is None else abs(reference_tilt_deg)
    tilt_deg = _largest(
        lambda tilt: worst_zoom(camera, 1.0, tilt, reference_tilt_deg, direction_deg),
        start,
        _TILT_LIMIT_DEG,
        allowed,
    )
    by_tilt = []
    for tilt in sorted({*_TILTS_DEG, abs(reference_tilt_deg)}):

        def zoom_needed(zoom: float, tilt: float = tilt) -> float:
            return worst_zoom(camera, zoom, tilt, reference_tilt_deg, direction_deg)

        by_tilt.append((tilt, _largest(zoom_needed, 1.0, allowed, allowed)))
    return PoseLimits(
        zoom=allowed,
        is_zoom_beyond_curve=min(curve.dprime) >= min_d_prime,
        tilt_deg=tilt_deg,
        zoom_by_tilt=tuple(by_tilt),
        overlap_by_shift=tuple((share, shift_overlap(share)) for share in _SHIFTS),
    )


def shift_overlap(share: float) -> float:
    """Share of the frame that both images see after a shift by a share of its width."""
    return max(1.0 - abs(share), 0.0)


def worst_zoom(
    camera: ViewingCamera,
    zoom: float,
    tilt_deg: float,
    reference_tilt_deg: float = 0.0,
    direction_deg: float | None = None,
) -> float:
    """Largest local zoom in the overlap, infinite where the horizon comes into the frame.

    ``direction_deg`` is where the follow-up leans, from the reference's lean (x where that is
    upright); None for the worst direction.
    """
    if direction_deg is not None:
        directions: tuple[float, ...] = (direction_deg,)
    elif tilt_deg == 0:
        directions = (0.0,)
    else:
        directions = camera.directions_deg(is_reference_tilted=reference_tilt_deg != 0)
    return max(
        _worst_zoom(camera, camera.followup_to_reference(zoom, tilt_deg, reference_tilt_deg, b))
        for b in directions
    )


def _worst_zoom(camera: ViewingCamera, matrix: FloatArray) -> float:
    try:
        sampling = local_sampling(matrix, camera.size, camera.size, _STEP_PX)
    except ValueError:
        return float("inf")
    seen = sampling.worst_zoom[sampling.inside]
    return float(seen.max()) if seen.size else float("inf")


def contrast_found_at(
    curve: DetectabilityCurve,
    min_d_prime: float,
    camera: ViewingCamera,
    zoom: float,
    tilt_deg: float = 0.0,
    reference_tilt_deg: float = 0.0,
    direction_deg: float | None = None,
) -> float:
    """Least contrast in DN that is still found at a pose, at its worst place.

    Raises
    ------
    AnalysisError
        If the pose's local zoom lies beyond the curve.
    """
    local = worst_zoom(camera, zoom, tilt_deg, reference_tilt_deg, direction_deg)
    if local > curve.zoom[-1] + 1e-9:
        raise AnalysisError(
            f"the pose's local zoom of {local:.3g} lies beyond the curve's {curve.zoom[-1]:g}; "
            "run standoff detectability with larger --zooms"
        )
    return curve.contrast_found(local, min_d_prime)


def _largest(
    local_zoom: Callable[[float], float], low: float, high: float, allowed: float
) -> float | None:
    """Largest argument up to which the local zoom stays within what is allowed."""
    slack = 1e-9
    if local_zoom(low) > allowed + slack:
        return None
    if local_zoom(high) <= allowed + slack:
        return high
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        if local_zoom(middle) <= allowed + slack:
            low = middle
        else:
            high = middle
    return low
