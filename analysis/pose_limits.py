"""Allowed movement: how far away, how tilted and how far aside a follow-up may be taken."""

from collections.abc import Callable
from dataclasses import dataclass

from analysis.detectability_curves import DetectabilityCurve
from analysis.errors import AnalysisError
from analysis.viewing_camera import ViewingCamera
from analysis.worst_zoom import worst_zoom

__all__ = ["PoseLimits", "contrast_found_at", "pose_limits", "shift_overlap"]

_TILT_LIMIT_DEG = 75.0
_BISECTIONS = 40

_TILTS_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0)
_SHIFTS = (0.05, 0.1, 0.2, 0.3, 0.5)


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
