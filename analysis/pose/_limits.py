"""Allowed movement: how far away, how tilted and how far aside a follow-up may be taken."""

from collections.abc import Callable
from dataclasses import dataclass
from math import atan2, degrees
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from analysis.detectability import DetectabilityCurve
from analysis.errors import BeyondCurveError, NotDetectableError
from simulation.arrays import BoolArray, FloatArray
from simulation.notebook import html_table
from simulation.pose import project, projection_depth, projection_slopes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LocalSampling:
    """Reference pixels per follow-up pixel at points of the follow-up, shape (rows, cols) each.

    ``worst_zoom, best_zoom``: along the direction that is sampled most coarsely, and most densely.
    ``inside``: whether the point is within the reference.
    """

    worst_zoom: FloatArray
    best_zoom: FloatArray
    inside: BoolArray

    @property
    def anisotropy(self) -> FloatArray:
        """Worst over best zoom, at least 1."""
        return self.worst_zoom / self.best_zoom

    @property
    def overlap(self) -> float:
        """Share of the follow-up that the reference covers."""
        return float(self.inside.mean())


def local_sampling(
    matrix: FloatArray,
    followup_size: tuple[int, int],
    reference_size: tuple[int, int],
    step_px: int = 4,
) -> LocalSampling:
    """Work out the sampling at every ``step_px``-th pixel of a follow-up, its border included.

    ``matrix``: shape (3, 3): follow-up pixel centres ``(x, y, 1)`` to reference pixel centres.
    ``followup_size, reference_size``: ``(width, height)``. ``step_px``: distance between the
    points; the outermost pixels are always among them.
    """
    width, height = followup_size
    x, y = np.meshgrid(_places(width, step_px), _places(height, step_px))
    h = np.asarray(matrix, dtype=np.float64)
    depth = projection_depth(h, x, y)
    if not (np.all(depth > 0) or np.all(depth < 0)):
        raise ValueError("the horizon of the plane is within the follow-up's frame")
    ref_x, ref_y, worst, best = _sampled_places(h, x, y)
    inside = (
        (ref_x >= -0.5)
        & (ref_x <= reference_size[0] - 0.5)
        & (ref_y >= -0.5)
        & (ref_y <= reference_size[1] - 0.5)
    )
    return LocalSampling(worst_zoom=worst, best_zoom=best, inside=inside)


def _sampled_places(
    matrix: FloatArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Reference coordinates of follow-up points, and the zoom there: worst and best direction.

    ``matrix``: shape (..., 3, 3): follow-up pixel centres to reference pixel centres. ``x, y``:
    follow-up pixels, of a shape that broadcasts against the leading axes.
    """
    h = np.moveaxis(matrix, (-2, -1), (0, 1))
    ref_x, ref_y = project(h, x, y)
    # A = d p / d u, as in docs/theory-pose.md.
    a, b, c, d = projection_slopes(h, x, y)
    # Singular values of a 2 x 2 matrix: half the sum and half the difference of two lengths.
    turning, shearing = np.hypot(a + d, c - b), np.hypot(a - d, c + b)
    return ref_x, ref_y, (turning + shearing) / 2, np.abs(turning - shearing) / 2


def _places(size: int, step_px: int) -> FloatArray:
    count = max(round((size - 1) / step_px), 1) + 1
    return np.linspace(0, size - 1, count)


LARGEST_SIDE_PX = 1_000_000
"""No sensor has more; squares of larger numbers leave too few digits for an angle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowupPose:
    """Where a follow-up is taken from; its reference looks at the plane's origin.

    ``zoom``: ratio of its distance to the reference's, each along its optical axis. ``tilt_deg,
    reference_tilt_deg``: angles between the optical axis and the plane's normal; the reference is
    tilted along x. ``direction_deg``: direction of the follow-up's tilt, from that of the
    reference; None for the worst direction. ``aim_px``: pixel ``(x, y)`` of the reference that the
    middle of the follow-up shows; by default the middle of the reference.
    """

    zoom: float = 1.0
    tilt_deg: float = 0.0
    reference_tilt_deg: float = 0.0
    direction_deg: float | None = None
    aim_px: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewingCamera:
    """A camera without distortion that looks at a plane."""

    focal_length_px: float
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        if not (self.focal_length_px > 0 and np.isfinite(self.focal_length_px)):
            raise ValueError(f"focal_length_px must be positive, got {self.focal_length_px}")
        if not all(16 <= side_px <= LARGEST_SIDE_PX for side_px in self.size):
            raise ValueError(
                f"a frame of 16 to {LARGEST_SIDE_PX:,} px a side is needed, got {self.width_px} x "
                f"{self.height_px}"
            )

    @property
    def size(self) -> tuple[int, int]:
        """``(width, height)`` in px."""
        return self.width_px, self.height_px

    def _plane_to_px(
        self, distance: float, tilt_deg: float, direction_deg: ArrayLike = 0.0
    ) -> FloatArray:
        """Homography from the plane to pixels; the camera looks at the plane's origin.

        ``distance``: from the origin, in any unit; the plane's coordinates have the same.
        ``tilt_deg``: angle between the axis and the plane's normal. ``direction_deg``: where the
        axis leans, from the rows' x towards the columns' y; one angle, or many. Returns shape (...,
        3, 3), the leading axes those of ``direction_deg``.
        """
        t, b = np.radians(tilt_deg), np.radians(np.asarray(direction_deg, dtype=np.float64))
        about = np.zeros((*b.shape, 3, 3))
        about[..., 0, 0] = about[..., 1, 1] = np.cos(b)
        about[..., 1, 0] = np.sin(b)
        about[..., 0, 1] = -about[..., 1, 0]
        about[..., 2, 2] = 1.0
        leaning = np.array(
            [[np.cos(t), 0.0, np.sin(t)], [0.0, 1.0, 0.0], [-np.sin(t), 0.0, np.cos(t)]]
        )
        # Columns: the plane's axes and its origin, seen from the camera.
        seen = about @ leaning.T @ np.swapaxes(about, -1, -2)
        seen[..., :, 2] = (0.0, 0.0, distance)
        camera = np.array(
            [
                [self.focal_length_px, 0.0, (self.width_px - 1) / 2],
                [0.0, self.focal_length_px, (self.height_px - 1) / 2],
                [0.0, 0.0, 1.0],
            ]
        )
        return np.asarray(camera @ seen)

    @property
    def middle_px(self) -> tuple[float, float]:
        """Middle of the frame, ``(x, y)``: pixel centres are at integers."""
        return (self.width_px - 1) / 2, (self.height_px - 1) / 2

    def aimed_at(
        self, aim_px: tuple[float, float], reference_tilt_deg: float = 0.0
    ) -> tuple[float, float]:
        """Point of the plane that a pixel of the reference shows, in the reference's distances."""
        x, y = aim_px
        if not (-0.5 <= x <= self.width_px - 0.5 and -0.5 <= y <= self.height_px - 0.5):
            raise ValueError(
                f"the point to aim at must lie in the reference of {self.width_px} x "
                f"{self.height_px} px, got {x:g},{y:g}"
            )
        near = self._plane_to_px(1.0, reference_tilt_deg)
        place = np.linalg.solve(near, np.array([x, y, 1.0]))
        # The plane's origin has a positive third component; so has all on this side of the horizon.
        if not place[2] > 0:
            raise ValueError(f"the reference looks past the plane's horizon at {x:g},{y:g} px")
        return float(place[0] / place[2]), float(place[1] / place[2])

    def followup_to_reference(
        self,
        zoom: float,
        tilt_deg: float,
        reference_tilt_deg: float = 0.0,
        direction_deg: ArrayLike = 0.0,
        aim_px: tuple[float, float] | None = None,
    ) -> FloatArray:
        """Homography of a follow-up from ``zoom`` times the reference's distance.

        The reference leans along x, the follow-up in ``direction_deg`` from there; its middle shows
        ``aim_px`` of the reference, or the reference's own middle. Shape (..., 3, 3), the leading
        axes those of ``direction_deg``.
        """
        near = self._plane_to_px(1.0, reference_tilt_deg)
        far = self._plane_to_px(zoom, tilt_deg, direction_deg)
        if aim_px is not None:
            x, y = self.aimed_at(aim_px, reference_tilt_deg)
            far = far @ np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])
        matrix = near @ np.linalg.inv(far)
        return np.asarray(matrix / matrix[..., 2:, 2:])


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
    aim_px: tuple[float, float] | None = None,
) -> float:
    """Largest local zoom in the overlap, infinite where the horizon comes into the frame.

    ``direction_deg`` is where the follow-up leans, from the reference's lean (x where that is
    upright); None for the worst direction, to 1e-4 of its zoom. ``aim_px`` is the pixel of the
    reference that the follow-up's middle shows; None for the reference's own middle.
    """
    aim = None if aim_px == camera.middle_px else aim_px

    def along(directions_deg: FloatArray) -> FloatArray:
        return _worst_zooms(
            camera.followup_to_reference(zoom, tilt_deg, reference_tilt_deg, directions_deg, aim),
            camera.size,
        )

    if direction_deg is not None:
        return float(along(np.array([direction_deg]))[0])
    if tilt_deg == 0:
        return float(along(np.zeros(1))[0])
    if reference_tilt_deg == 0 and aim is None:
        # The frame's symmetry leaves its axes and diagonals.
        diagonal_deg = degrees(atan2(camera.height_px, camera.width_px))
        return float(along(np.array([0.0, diagonal_deg, 90.0])).max())
    # Both sides of the reference's lean are alike, unless the aim lies on one of them.
    is_halved = aim is None or aim[1] == camera.middle_px[1]
    range_deg, count = (180.0, _DIRECTIONS) if is_halved else (360.0, 2 * _DIRECTIONS - 1)
    tried_deg, step_deg = np.linspace(0.0, range_deg, count, retstep=True)
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
        [np.broadcast_to(followup, mapped.shape), mapped, crossings.reshape(len(matrices), -1, 3)],
        axis=1,
    )
    # Parallel borders cross nowhere, and a place may lie in the reference camera's own plane.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        places = places / places[..., 2:]
        seen_x, seen_y, zooms, _ = _sampled_places(
            matrices[:, None], places[..., 0], places[..., 1]
        )
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


def _is_within(places: FloatArray, corners: FloatArray) -> BoolArray:
    least, most = corners[0, :2] - _ON_THE_BORDER_PX, corners[2, :2] + _ON_THE_BORDER_PX
    at = places[..., :2]
    return np.asarray(np.all((at >= least) & (at <= most), axis=-1))


_TILT_LIMIT_DEG = 75.0
_BEYOND = 10.0  # times what is allowed, for the infinite zoom at the horizon

_FURTHER = 4.0

_TILTS_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0)
_SHIFTS = (0.05, 0.1, 0.2, 0.3, 0.5)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PoseLimits:
    """Camera movement that keeps d' at the threshold or above, everywhere in the overlap.

    Parameters
    ----------
    curve, min_d_prime
        The curve of d', and its threshold.
    zoom
        Largest ratio of the distances when the camera moves straight back, without any tilt.
    is_zoom_beyond_curve
        Whether d' is above the threshold up to the end of the curve: the true limit is then larger.
    tilt_deg
        Largest tilt at equal distances, up to 75 degrees, in the direction asked for or else in the
        worst one; None if no tilt is allowed.
    zoom_by_tilt
        Tilts in degrees, each with the largest ratio of the distances at that tilt, None if there
        is none.
    overlap_by_shift
        Sideways movements as a share of the field of view's width, each with the share of the frame
        that remains in view; they do not change the sampling.
    zoom_interval_95, tilt_interval_95_deg
        Intervals of ``zoom`` and ``tilt_deg``, from the interval of d'; an end is None where d' is
        never at the threshold, or still above it where the curve ends.
    aim_px, aimed_overlap
        Pixel ``(x, y)`` of the reference that the middle of the follow-up shows, None for its
        middle; and the share that the reference then covers of a follow-up from the same distance
        and with the same tilt.
    """

    curve: DetectabilityCurve
    min_d_prime: float
    zoom: float
    is_zoom_beyond_curve: bool
    tilt_deg: float | None
    zoom_by_tilt: tuple[tuple[float, float | None], ...]
    overlap_by_shift: tuple[tuple[float, float], ...]
    zoom_interval_95: tuple[float | None, float | None] = (None, None)
    tilt_interval_95_deg: tuple[float | None, float | None] = (None, None)
    aim_px: tuple[float, float] | None = None
    aimed_overlap: float | None = None

    def __repr__(self) -> str:
        more = " and more" if self.is_zoom_beyond_curve else ""
        tilt = "no tilt" if self.tilt_deg is None else f"tilt up to {self.tilt_deg:.1f} degrees"
        return f"<PoseLimits: zoom up to {self.zoom:.3f}{more}, {tilt}>"

    def _repr_html_(self) -> str:
        rows = [
            (f"{tilt:g}", "none" if zoom is None else f"{zoom:.3f}")
            for tilt, zoom in self.zoom_by_tilt
        ]
        return html_table(repr(self)[1:-1], ("tilt / degrees", "zoom up to"), rows)

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of d' against zoom with the threshold, and the zoom against the tilt."""
        from analysis.pose._plot import limits_figure  # matplotlib, for whoever looks

        return limits_figure(self, ax)


def limits_of_curve(
    curve: DetectabilityCurve,
    min_d_prime: float,
    camera: ViewingCamera,
    reference_tilt_deg: float = 0.0,
    direction_deg: float | None = None,
    aim_px: tuple[float, float] | None = None,
) -> PoseLimits:
    """Find the movement that a threshold of d' allows.

    ``direction_deg``: where the follow-up leans, from there; None for the worst direction.
    ``aim_px``: pixel of the reference that the middle of the follow-up shows; by default its own
    middle.
    """
    allowed = curve.largest_zoom(min_d_prime)
    if allowed is None:
        raise NotDetectableError(
            f"d' is already {curve.dprime[0]:.3g} at zoom {curve.zoom[0]:g}, below "
            f"the threshold of {min_d_prime:g}: lower --min-dprime, average more frames or look "
            "for a larger contrast",
            zoom=curve.zoom[0],
            d_prime=curve.dprime[0],
        )
    # A follow-up that leans like its reference is the easiest; in any direction, an upright one.
    start = 0.0 if direction_deg is None else abs(reference_tilt_deg)

    def largest_tilt(allowed: float | None) -> float | None:
        if allowed is None:
            return None
        return _largest(
            lambda tilt: worst_zoom(camera, 1.0, tilt, reference_tilt_deg, direction_deg, aim_px),
            start,
            _TILT_LIMIT_DEG,
            allowed,
        )

    zooms = _zoom_interval(curve, min_d_prime)
    # Aimed at where a tilted reference samples coarsely itself, a follow-up may be further away.
    furthest = allowed if aim_px is None else _FURTHER * allowed
    by_tilt = []
    for tilt in sorted({*_TILTS_DEG, abs(reference_tilt_deg)}):

        def zoom_needed(zoom: float, tilt: float = tilt) -> float:
            return worst_zoom(camera, zoom, tilt, reference_tilt_deg, direction_deg, aim_px)

        by_tilt.append((tilt, _largest(zoom_needed, 1.0, furthest, allowed)))
    return PoseLimits(
        curve=curve,
        min_d_prime=min_d_prime,
        zoom=allowed,
        is_zoom_beyond_curve=min(curve.dprime) >= min_d_prime,
        zoom_interval_95=zooms,
        tilt_deg=largest_tilt(allowed),
        tilt_interval_95_deg=(largest_tilt(zooms[0]), largest_tilt(zooms[1])),
        zoom_by_tilt=tuple(by_tilt),
        overlap_by_shift=tuple((share, shift_overlap(share)) for share in _SHIFTS),
        aim_px=aim_px,
        aimed_overlap=None if aim_px is None else _overlap(camera, reference_tilt_deg, aim_px),
    )


def _zoom_interval(
    curve: DetectabilityCurve, min_d_prime: float
) -> tuple[float | None, float | None]:
    """Zooms at which either end of the interval of d' falls below the threshold."""
    low, high = (
        curve.model_copy(update={"dprime": values})
        for values in (curve.dprime_low, curve.dprime_high)
    )
    least = low.largest_zoom(min_d_prime)
    most = high.largest_zoom(min_d_prime)
    return least, None if min(high.dprime) >= min_d_prime else most


def _overlap(
    camera: ViewingCamera, reference_tilt_deg: float, aim_px: tuple[float, float]
) -> float:
    """Share of a follow-up from the reference's distance that the reference covers."""
    matrix = camera.followup_to_reference(
        1.0, reference_tilt_deg, reference_tilt_deg, aim_px=aim_px
    )
    return local_sampling(matrix, camera.size, camera.size).overlap


def shift_overlap(share: float) -> float:
    """Share of the frame that both images see after a shift by a share of its width."""
    return max(1.0 - abs(share), 0.0)


def contrast_found_at(
    curve: DetectabilityCurve, min_d_prime: float, camera: ViewingCamera, pose: FollowupPose
) -> float:
    """Least contrast in DN that is still found at a pose, where it samples most coarsely."""
    local = worst_zoom(
        camera, pose.zoom, pose.tilt_deg, pose.reference_tilt_deg, pose.direction_deg, pose.aim_px
    )
    if local > curve.zoom[-1] + 1e-9:
        raise BeyondCurveError(
            f"the pose's local zoom of {local:.3g} is beyond the curve's last, {curve.zoom[-1]:g}; "
            "run standoff detectability with larger --zooms",
            zoom=local,
            largest_zoom=curve.zoom[-1],
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

    def surplus(argument: float) -> float:
        return min(local_zoom(argument), _BEYOND * allowed) - allowed - slack

    return float(brentq(surplus, low, high, xtol=1e-9))
