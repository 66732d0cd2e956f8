"""Positions of follow-up pixels in the reference, when the lens distorts and the scene bends."""

from dataclasses import dataclass, field, replace
from typing import Literal, Self

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from simulation.arguments import ArgumentError, check_fields
from simulation.arrays import BoolArray, Float32Array, FloatArray
from simulation.by_value import ByValue
from simulation.pose import lens_of, project, warped


@dataclass(frozen=True, slots=True, eq=False)
class FeatureMatches(ByValue):
    """Pairs of points that show the same place of the scene.

    Parameters
    ----------
    followup_px, reference_px
        Points ``(x, y)`` in either photograph, shape (n, 2) each.

    Examples
    --------
    >>> import numpy as np
    >>> followup_px = np.array([[20.0, 20.0], [300.0, 20.0], [300.0, 220.0], [20.0, 220.0]])
    >>> pose = standoff.register("before.tif", "after.tif")
    >>> seen = np.c_[followup_px, np.ones(4)] @ pose.matrix.T
    >>> points = standoff.FeatureMatches(followup_px, seen[:, :2] / seen[:, 2:])
    >>> hints = standoff.RegistrationHints(points=points)
    >>> round(standoff.register("before.tif", "after.tif", hints=hints).zoom, 2)
    1.19
    """

    followup_px: FloatArray
    reference_px: FloatArray

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("followup_px", "reference_px"):
            points = getattr(self, name)
            if points.shape != (len(self.reference_px), 2) or not np.isfinite(points).all():
                raise ArgumentError(
                    f"expected as many finite pairs as of the other, shape (n, 2), got "
                    f"{points.shape}",
                    argument=name,
                )

    def swapped(self) -> Self:
        """Return the same pairs with the roles of the two photographs exchanged."""
        return type(self)(followup_px=self.reference_px, reference_px=self.followup_px)

    def distances_px(self, matrix: FloatArray) -> FloatArray:
        """Distance in the reference between each match and its position by ``matrix``."""
        x, y = project(matrix, *self.followup_px.T)
        return np.asarray(np.hypot(x - self.reference_px[:, 0], y - self.reference_px[:, 1]))

    def rms_px(self, matrix: FloatArray, inlier: BoolArray) -> float:
        """Root mean square of ``distances_px`` over the matches that ``inlier`` marks."""
        return float(np.sqrt(np.mean(self.distances_px(matrix)[inlier] ** 2)))


_INVERSE_ROUNDS = 30
_INVERSE_TOLERANCE_PX = 1e-9


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SmoothDisplacement:
    """A uniform cubic B-spline over one of two photographs, whose pixels it displaces.

    Knots are coefficients of the displacement along y and x, shape (2, n, m), at least 4 x 4; the
    shape is the photograph's.
    """

    knots_px: FloatArray = field(repr=False)
    shape: tuple[int, int]
    photograph: Literal["reference", "followup"]

    def displaced(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where pixels at ``(y, x)`` would lie if the scene were planar, in the same shape."""
        moved_y, moved_x = self._at(y_px, x_px)
        return y_px + moved_y, x_px + moved_x

    def restored(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inverse of ``displaced``, by fixed-point iteration: the displacement varies slowly."""
        y, x = y_px, x_px
        for _ in range(_INVERSE_ROUNDS):
            moved_y, moved_x = self._at(y, x)
            last_y, last_x = y, x
            y, x = y_px - moved_y, x_px - moved_x
            if max(_largest(y - last_y), _largest(x - last_x)) < _INVERSE_TOLERANCE_PX:
                break
        return y, x

    def swapped(self) -> Self:
        """Return the same displacement with the roles of the two photographs exchanged."""
        return type(self)(
            knots_px=self.knots_px,
            shape=self.shape,
            photograph="followup" if self.photograph == "reference" else "reference",
        )

    def mirrored(self) -> Self:
        """Return the displacement of the photograph with its columns reversed."""
        signs = np.array([1.0, -1.0])[:, None, None]
        return type(self)(
            knots_px=self.knots_px[..., ::-1] * signs, shape=self.shape, photograph=self.photograph
        )

    def _at(self, y_px: FloatArray, x_px: FloatArray) -> FloatArray:
        """Displacement along y and x; constant beyond the frame."""
        places = [
            1 + np.clip((along + 0.5) / size, 0.0, 1.0) * (count - 3)
            for along, size, count in zip(
                (y_px, x_px), self.shape, self.knots_px.shape[1:], strict=True
            )
        ]
        return np.stack(
            [
                map_coordinates(knots, places, order=3, mode="nearest", prefilter=False)
                for knots in self.knots_px
            ]
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PixelParallax(ByValue):
    """Displacement of each pixel of a photograph by the depth of what it sees.

    ``displaced_px``: from where a pixel is to where it would be seen if the scene were planar,
    ``(y, x)``, shape (2, rows, cols). ``restored_px``: the way back, from there. ``is_seen``:
    pixels of which the other photograph shows the same, shape ``(rows, cols)``. ``is_seen_back``:
    the same of the other photograph's pixels, where the plane has them. ``error_px``: how far a
    pixel may be from where it is restored, a standard deviation.
    """

    displaced_px: Float32Array = field(repr=False)
    restored_px: Float32Array = field(repr=False)
    is_seen: BoolArray = field(repr=False)
    is_seen_back: BoolArray = field(repr=False)
    error_px: Float32Array = field(repr=False)
    photograph: Literal["reference", "followup"]

    def displaced(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where pixels at ``(y, x)`` would lie if the scene were planar, in the same shape."""
        moved_y, moved_x = _between_pixels(self.displaced_px, y_px, x_px)
        return y_px + moved_y, x_px + moved_x

    def restored(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where pixels lie that would be seen at ``(y, x)`` if the scene were planar."""
        moved_y, moved_x = _between_pixels(self.restored_px, y_px, x_px)
        return y_px + moved_y, x_px + moved_x

    def shows_back(self, y_px: FloatArray, x_px: FloatArray) -> BoolArray:
        """Whether the other photograph's pixels, which the plane has here, are seen in both."""
        rows, cols = self.is_seen.shape
        y, x = (np.clip(np.rint(at), -1, n) for at, n in ((y_px, rows), (x_px, cols)))
        inside = (y >= 0) & (y < rows) & (x >= 0) & (x < cols)
        row, col = np.where(inside, y, 0).astype(int), np.where(inside, x, 0).astype(int)
        return np.asarray(inside & self.is_seen_back[row, col])

    def swapped(self) -> Self:
        """Return the same parallax with the roles of the two photographs exchanged."""
        other: Literal["reference", "followup"] = (
            "followup" if self.photograph == "reference" else "reference"
        )
        return replace(self, photograph=other)

    def mirrored(self) -> Self:
        """Return the parallax of the photograph with its columns reversed."""
        signs = np.array([1.0, -1.0], dtype=np.float32)[:, None, None]
        return replace(
            self,
            displaced_px=self.displaced_px[..., ::-1] * signs,
            restored_px=self.restored_px[..., ::-1] * signs,
            is_seen=self.is_seen[:, ::-1],
            is_seen_back=self.is_seen_back[:, ::-1],
            error_px=self.error_px[:, ::-1],
        )


def _between_pixels(images: Float32Array, y_px: FloatArray, x_px: FloatArray) -> FloatArray:
    """Two images between their pixels, linearly; beyond the frame as at its border."""
    places = [np.asarray(y_px, dtype=np.float64), np.asarray(x_px, dtype=np.float64)]
    return np.stack(
        [
            map_coordinates(image, places, order=1, mode="nearest", output=np.float64)
            for image in images
        ]
    )


def _largest(values: FloatArray) -> float:
    return float(np.abs(values).max(initial=0.0))


_GRID = 21
_OVERLAP_GRID = 48


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DistortedPose(ByValue):
    """A homography between the images of an ideal lens, seen through a distorting one.

    Both images are whole frames of one camera. An ideal point at radius r from the centre of the
    frame, 1 at its corner, appears at ``r (1 + k1 r^2)``; points beyond the fold of a barrel
    distortion, of negative k1, are outside the frame. ``matrix``, shape (3, 3), last element 1,
    takes ideal follow-up pixels to ideal reference pixels. ``displacement`` is of the pixels of one
    of the two, where the scene is not quite planar; ``parallax`` of each pixel, where it has depth.
    """

    matrix: FloatArray = field(repr=False)
    k1: float
    reference_shape: tuple[int, int]
    followup_shape: tuple[int, int]
    displacement: SmoothDisplacement | None = None
    parallax: PixelParallax | None = None

    @property
    def zoom(self) -> float:
        """Reference pixels per follow-up pixel at the follow-up's centre."""
        ax, ay, dx, dy = self._steps_px
        return float(np.sqrt(abs(ax * dy - ay * dx)))

    @property
    def stretch(self) -> float:
        """Reference pixels that a step along a row or column passes there; of the two, the more."""
        ax, ay, dx, dy = self._steps_px
        return float(max(np.hypot(ax, ay), np.hypot(dx, dy)))

    @property
    def overlap(self) -> float:
        """Share of the follow-up that the reference shows, to about a thousandth."""
        rows, cols = self.followup_shape
        y, x = np.meshgrid(
            np.linspace(0.0, rows - 1.0, _OVERLAP_GRID), np.linspace(0.0, cols - 1.0, _OVERLAP_GRID)
        )
        return float(np.mean(self.shows(*self.to_reference_px(y, x), margin=0.0)))

    def shows(self, y_px: FloatArray, x_px: FloatArray, margin: float) -> BoolArray:
        """Whether positions lie in the reference, or within a share of its size around it."""
        rows, cols = self.reference_shape
        inside = (y_px >= -margin * rows) & (y_px <= rows - 1 + margin * rows)
        return inside & (x_px >= -margin * cols) & (x_px <= cols - 1 + margin * cols)

    @property
    def _steps_px(self) -> tuple[float, float, float, float]:
        """Steps in the reference, x and y each, of one pixel across and one down at the centre."""
        rows, cols = self.followup_shape
        step = np.array([-0.5, 0.5])
        middle_y, middle_x = (rows - 1) / 2, (cols - 1) / 2
        across = self.to_reference_px(np.full(2, middle_y), middle_x + step)
        down = self.to_reference_px(middle_y + step, np.full(2, middle_x))
        (ay, ax), (dy, dx) = (np.diff(across)[:, 0], np.diff(down)[:, 0])
        return float(ax), float(ay), float(dx), float(dy)

    def with_(
        self, matrix: FloatArray, k1: float, displacement: SmoothDisplacement | None = None
    ) -> Self:
        """Return the pose with another matrix, which is normalised, distortion and displacement."""
        return replace(self, matrix=matrix / matrix[2, 2], k1=k1, displacement=displacement)

    def inverse(self) -> Self:
        """Return the pose of the reference in the follow-up."""
        matrix = np.asarray(np.linalg.inv(self.matrix), dtype=np.float64)
        own, other = (_corner_px(one) for one in (self.reference_shape, self.followup_shape))
        return type(self)(
            matrix=matrix / matrix[2, 2],
            # The distortion per px is the lens's; its figure counts at the reference's corner.
            k1=self.k1 * (other / own) ** 2,
            reference_shape=self.followup_shape,
            followup_shape=self.reference_shape,
            displacement=None if self.displacement is None else self.displacement.swapped(),
            parallax=None if self.parallax is None else self.parallax.swapped(),
        )

    def mirrored(self) -> Self:
        """Return the pose of the follow-up with its columns reversed; twice, it is the same."""
        bend = self.displacement
        if bend is not None and bend.photograph == "followup":
            bend = bend.mirrored()
        depth = self.parallax
        if depth is not None and depth.photograph == "followup":
            depth = depth.mirrored()
        # Distortion is the same on both sides of the frame's centre.
        made = self.with_(mirrored_matrix(self.matrix, self.followup_shape), self.k1, bend)
        return replace(made, parallax=depth)

    def to_reference_px(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Reference coordinates ``(y, x)`` of follow-up coordinates, in the same shape."""
        bends = [one for one in (self.parallax, self.displacement) if one is not None]
        for bend in bends:
            if bend.photograph == "followup":
                y_px, x_px = bend.displaced(y_px, x_px)
        y_px, x_px = _warped(self.matrix, self._lens, y_px, x_px)
        for bend in reversed(bends):
            if bend.photograph == "reference":
                y_px, x_px = bend.restored(y_px, x_px)
        return y_px, x_px

    def to_followup_px(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Follow-up coordinates ``(y, x)`` of reference coordinates, in the same shape."""
        return self.inverse().to_reference_px(y_px, x_px)

    def distances_px(self, matches: FeatureMatches) -> FloatArray:
        """Distance in the reference between each match and its position by the pose, (n,)."""
        y, x = self.to_reference_px(matches.followup_px[:, 1], matches.followup_px[:, 0])
        return np.asarray(np.hypot(x - matches.reference_px[:, 0], y - matches.reference_px[:, 1]))

    def followup_places_px(self) -> tuple[FloatArray, FloatArray]:
        """Reference coordinates ``(y, x)`` of every follow-up pixel, shape (rows, cols) each."""
        rows, cols = self.followup_shape
        y, x = np.meshgrid(np.arange(float(rows)), np.arange(float(cols)), indexing="ij")
        return self.to_reference_px(y, x)

    @property
    def plane(self) -> Self:
        """The pose without the parallax of what stands out of the plane."""
        return replace(self, parallax=None)

    def followup_seen(self) -> BoolArray | None:
        """Follow-up pixels of which both photographs show the same; None if nothing is hidden."""
        depth = self.parallax
        if depth is None:
            return None
        if depth.photograph == "followup":
            return depth.is_seen
        return depth.shows_back(*self.plane.followup_places_px())

    def nearest_homography(self) -> FloatArray:
        """Homography, shape (3, 3), nearest to the whole pose where the reference shows it."""
        rows, cols = self.followup_shape
        y, x = (
            at.ravel()
            for at in np.meshgrid(
                np.linspace(0.0, rows - 1.0, _GRID), np.linspace(0.0, cols - 1.0, _GRID)
            )
        )
        to_y, to_x = self.to_reference_px(y, x)
        inside = (to_y >= 0) & (to_y < self.reference_shape[0])
        inside &= (to_x >= 0) & (to_x < self.reference_shape[1])
        if (self.k1 == 0 and self.displacement is None) or np.count_nonzero(inside) < 4:
            return self.matrix
        found, _ = cv2.findHomography(
            np.column_stack([x, y])[inside], np.column_stack([to_x, to_y])[inside], 0
        )
        return np.asarray(found, dtype=np.float64)

    @property
    def _lens(self) -> FloatArray:
        return lens_of(self.k1, self.reference_shape, self.followup_shape)


def mirrored_matrix(matrix: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Homography from a follow-up of ``shape`` with its columns reversed."""
    flip = np.array([[-1.0, 0.0, shape[1] - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(matrix @ flip)


def _warped(
    matrix: FloatArray, lens: FloatArray, y_px: FloatArray, x_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    points = np.column_stack([np.ravel(x_px), np.ravel(y_px)])
    x, y = warped(matrix, lens, points).T
    return y.reshape(np.shape(y_px)), x.reshape(np.shape(x_px))


def _corner_px(shape: tuple[int, int]) -> float:
    """Radius of a frame's corner as ``lens_of`` has it."""
    return max(float(np.hypot(shape[0] - 1, shape[1] - 1)) / 2, 0.5)
