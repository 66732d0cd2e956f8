"""Pairs of points that a pose must agree with: matched features, and an operator's hints.

Matched image features: pairs of points that a pose must agree with. Features are looked for in the
locally normalised image: a shadow, a vignette or little contrast changes nothing.
"""

import csv
from dataclasses import dataclass, replace
from io import StringIO
from math import isfinite, nan
from typing import Any, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from calibration.registration._distorted_pose import FeatureMatches, mirrored_matrix
from simulation.arguments import ArgumentError, check_fields
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray
from simulation.by_value import ByValue
from simulation.compiled import compiled
from simulation.pose import homography_fault, project, projection_depth

Look = Literal["quick", "plain", "closer"]
_FEATURES: dict[Look, int] = {"quick": 1000, "plain": 4000, "closer": 4000}
_CONTRAST_THRESHOLD = 0.02
"""Of SIFT, half of its default: a retina or a lesion has twice as many features with it."""

_NORMALISED_PART = 1 / 7
"""Of the longer side: the window of the normalisation."""
_NORMALISED_SIGMA_PX = 1.0
"""Smoothing before the normalisation: without it half of the features of noisy images are noise."""

_NORMALISED_DN = 40.0
_NOISE_PER_LAPLACIAN = 1 / np.sqrt(20.0)
_CONTRAST_FLOOR = 0.02
_WORKED_ON_PX: dict[Look, float] = {"quick": 0.3e6, "plain": 1.0e6, "closer": 3.0e6}
"""Pixels above which an image is reduced first, by how closely it is looked at."""

_RATIO_TEST = 0.8  # D. Lowe, "Distinctive image features from scale-invariant keypoints", 2004
_MATCH_TOLERANCE_PX = 3.0
_INLIERS_MIN = 12
_REACH = 0.08
"""How far from its expected position to look for a feature, relative to the longer side."""

_LONELY_DISTANCE_MAX = 200.0
"""Distance of descriptors (of length 512) up to which a match without a rival is accepted."""

_MATCHED_AT_ONCE = 512
"""Features of the follow-up compared with all of the reference: what they need is bounded so."""

_ROLES = {"reference": "the reference", "followup": "the follow-up", None: "it"}


@dataclass(frozen=True, slots=True, eq=False)
class ImageFeatures:
    """SIFT features of an image: points ``(x, y)``, scales and directions (n, 2), descriptors."""

    points_px: FloatArray
    descriptors: Float32Array
    frames: FloatArray
    shape: tuple[int, ...]

    def matched_with(self, followup: Self, expected: FloatArray | None = None) -> FeatureMatches:
        """Pair the features of a reference with a follow-up's, as ``match_features`` does."""
        mask = None
        if expected is not None:
            x, y = project(expected, *followup.points_px.T)
            own_x, own_y = self.points_px.T
            away_px = np.hypot(x[:, None] - own_x, y[:, None] - own_y)
            mask = (away_px < _REACH * max(self.shape)).astype(np.uint8)
        pairs = self.pairs_with(followup, _RATIO_TEST, mask)
        if len(pairs) < _INLIERS_MIN:
            raise RegistrationError(
                f"only {len(pairs)} features of the images match",
                reason="no_matches",
                count=len(pairs),
            )
        return FeatureMatches(followup.points_px[pairs[:, 0]], self.points_px[pairs[:, 1]])

    def mirrored(self) -> Self:
        """Return the features of the image with its columns reversed, without looking for them.

        A descriptor has 4 x 4 cells of 8 directions: along the feature's own nothing changes.
        """
        cells = self.descriptors.reshape(-1, 4, 4, 8)[:, ::-1]
        descriptors = cells[..., -np.arange(8) % 8].reshape(-1, 128)
        points, frames = self.points_px.copy(), self.frames.copy()
        points[:, 0] = self.shape[1] - 1 - points[:, 0]
        frames[:, 1] = np.pi - frames[:, 1]
        return type(self)(points, np.ascontiguousarray(descriptors), frames, self.shape)

    def some(self, most: int) -> Self:
        """Return at most about so many of the features, evenly chosen."""
        chosen = np.s_[:: max(len(self.points_px) // most, 1)]
        return type(self)(
            self.points_px[chosen], self.descriptors[chosen], self.frames[chosen], self.shape
        )

    def pairs_with(
        self, followup: Self, ratio: float, mask: NDArray[np.uint8] | None = None
    ) -> NDArray[np.int64]:
        """Numbers of matching features, follow-up's and reference's, shape (n, 2), best first."""
        return self.nearest_to(followup, mask).within(ratio)

    def nearest_to(
        self, followup: Self, mask: NDArray[np.uint8] | None = None
    ) -> "NearestFeatures":
        """The two nearest features of each of the follow-up's, where the mask allows."""
        if min(len(self.points_px), len(followup.points_px)) < 2:
            return NearestFeatures(np.zeros((0, 2), np.int64), np.zeros((0, 2), np.float32))
        numbers, squares = [], []
        own = np.square(self.descriptors).sum(axis=1)
        for first in range(0, len(followup.points_px), _MATCHED_AT_ONCE):
            part = np.s_[first : first + _MATCHED_AT_ONCE]
            # Components are whole numbers up to 255, so that float32 holds the products exactly.
            products = followup.descriptors[part] @ self.descriptors.T
            number, square = _two_nearest(products, own, None if mask is None else mask[part])
            numbers.append(number)
            squares.append(square + np.square(followup.descriptors[part]).sum(axis=1)[:, None])
        return NearestFeatures(np.concatenate(numbers), np.sqrt(np.concatenate(squares)))


@dataclass(frozen=True, slots=True, eq=False)
class NearestFeatures:
    """Candidates of matches, which are chosen by the ratio test of Lowe (2004), section 7.1.

    Of each of the follow-up's features the numbers of the two nearest of the reference's and their
    distances, shape (n, 2) each; -1 and infinity where there are fewer.
    """

    numbers: NDArray[np.int64]
    distances: Float32Array

    def within(self, ratio: float) -> NDArray[np.int64]:
        """Numbers of matching features, follow-up's and reference's, shape (n, 2), best first."""
        first, second = self.distances.T.astype(np.float64)
        is_lonely = np.isinf(second)
        most = np.where(is_lonely, _LONELY_DISTANCE_MAX, ratio * second)
        found = np.flatnonzero(first < most)
        ambiguity = first[found] / np.maximum(second[found], 1e-9)
        ambiguity[is_lonely[found]] = 1.0
        found = found[np.argsort(ambiguity, kind="stable")]
        return np.column_stack([found, self.numbers[found, 0]])


@compiled(nogil=True)
def _two_nearest(
    products: Float32Array, squares: Float32Array, mask: NDArray[np.uint8] | None
) -> tuple[NDArray[np.int64], Float32Array]:
    """Of each row the two columns of least ``squares - 2 products``, and these, where allowed."""
    rows, cols = products.shape
    numbers = np.full((rows, 2), -1)
    least = np.full((rows, 2), np.float32(np.inf))
    for i in range(rows):
        for j in range(cols):
            at = squares[j] - 2 * products[i, j]
            if at < least[i, 1] and (mask is None or mask[i, j]):
                if at < least[i, 0]:
                    least[i, 1], numbers[i, 1] = least[i, 0], numbers[i, 0]
                    least[i, 0], numbers[i, 0] = at, j
                else:
                    least[i, 1], numbers[i, 1] = at, j
    return numbers, least


def match_features(
    reference: AnyArray,
    followup: AnyArray,
    expected: FloatArray | None = None,
) -> FeatureMatches:
    """SIFT features that both photographs share, only near an ``expected`` map if there is one."""
    near, far = find_features(reference, "reference"), find_features(followup, "followup")
    return near.matched_with(far, expected)


def find_features(
    image: AnyArray, role: Literal["reference", "followup"] | None = None
) -> ImageFeatures:
    """SIFT features of a grey image; ``role`` names the image in errors."""
    values = np.asarray(image, dtype=np.float32)
    if values.ndim != 2 or values.size == 0 or not np.isfinite(values).all():
        raise ValueError(f"alignment needs grey images with finite values, got shape {image.shape}")
    found = features_of(values)
    if len(found.points_px) < _INLIERS_MIN:
        raise RegistrationError(
            f"{_ROLES[role]} has only {len(found.points_px)} features to align by; "
            "photograph something with more detail",
            reason="no_detail",
            at_fault=role,
            count=len(found.points_px),
        )
    return found


def features_of(
    levels: Float32Array, usable: BoolArray | None = None, look: Look = "plain"
) -> ImageFeatures:
    """SIFT features of a grey image of finite levels, on its usable pixels; there may be none.

    A quick look tells most poses, in less time. A closer look takes the levels as they
    are, at a higher resolution: the finest details, where perspective or haze leaves nothing else
    in common.
    """
    shape = levels.shape
    factor = max(round(np.sqrt(levels.size / _WORKED_ON_PX[look])), 1)
    if factor > 1:
        rows, cols = (n // factor for n in shape)
        part = np.s_[: rows * factor, : cols * factor]
        levels = np.asarray(
            cv2.resize(levels[part], (cols, rows), interpolation=cv2.INTER_AREA), dtype=np.float32
        )
        if usable is not None:
            usable = cv2.resize(usable[part].astype(np.uint8), (cols, rows)).astype(np.bool_)
    # Without precise upscaling every keypoint is shifted by 0.25 px towards the origin.
    sift = cv2.SIFT.create(
        nfeatures=_FEATURES[look],
        contrastThreshold=_CONTRAST_THRESHOLD,
        enable_precise_upscale=True,
    )
    mask = None if usable is None else usable.astype(np.uint8)
    image = _bytes(levels) if look == "closer" else _normalised_bytes(levels)
    found, descriptors = sift.detectAndCompute(image, mask)
    points = np.array([one.pt for one in found], dtype=np.float64).reshape(-1, 2)
    frames = np.array([(one.size, np.deg2rad(one.angle)) for one in found], dtype=np.float64)
    return ImageFeatures(
        (points + 0.5) * factor - 0.5,
        _described(descriptors, len(found)),
        frames.reshape(-1, 2) * (factor, 1),
        shape,
    )


def _described(descriptors: object, count: int) -> Float32Array:
    # If it finds nothing, OpenCV returns None.
    if count == 0:
        return np.zeros((0, 128), dtype=np.float32)
    return np.asarray(descriptors, dtype=np.float32)


def homography_pose(
    matches: FeatureMatches, inliers_min: int = _INLIERS_MIN
) -> tuple[FloatArray, BoolArray]:
    """Homography, shape (3, 3), from follow-up to reference, and its matches, if enough agree."""
    found, inlier = _magsac(matches)
    count = int(np.count_nonzero(inlier))
    if count < inliers_min:
        raise RegistrationError(
            f"only {count} feature matches agree on a pose", reason="no_common_pose", count=count
        )
    depth = projection_depth(found, *matches.followup_px[inlier].T)
    # Local area and orientation are det / depth^3. A scene seen from its front is not mirrored.
    if not np.all(np.linalg.det(found) * depth > 0):
        raise RegistrationError(
            "the features agree only on a pose that is not possible for a camera (mirrored or "
            "beyond the horizon)",
            reason="inside_out",
        )
    return found, inlier


def _magsac(matches: FeatureMatches) -> tuple[FloatArray, BoolArray]:
    """What OpenCV finds, and its matches: none if it returns nothing.

    It raises an error of its own where a sample that it refines has no solution.
    """
    none = np.zeros(len(matches.followup_px), dtype=np.bool_)
    try:
        found, mask = cv2.findHomography(
            matches.followup_px, matches.reference_px, cv2.USAC_MAGSAC, _MATCH_TOLERANCE_PX
        )
    except cv2.error:
        return np.eye(3), none
    if np.shape(found) != (3, 3):
        return np.eye(3), none
    return np.asarray(found, dtype=np.float64), mask.ravel().astype(np.bool_)


def _bytes(levels: Float32Array) -> NDArray[np.uint8]:
    low, high = float(levels.min()), float(levels.max())
    scaled = (levels - low) * (255.0 / (high - low or 1.0)) + 0.5
    return np.asarray(scaled, dtype=np.float32).astype(np.uint8)


def _normalised_bytes(levels: Float32Array) -> NDArray[np.uint8]:
    """Levels less their local mean, over their local contrast, from 0 to 255."""
    smooth = cv2.GaussianBlur(levels, (0, 0), _NORMALISED_SIGMA_PX)
    window_px = 2 * round(_NORMALISED_PART * max(levels.shape) / 2) + 1
    deviation = smooth - _mean(smooth, window_px)
    noise = float(np.median(np.abs(cv2.Laplacian(smooth, cv2.CV_32F)))) / 0.6745
    # Flat regions hold noise and rounding only: they are not raised to full contrast.
    floor = (_NOISE_PER_LAPLACIAN * noise) ** 2 + (_CONTRAST_FLOOR * float(smooth.std())) ** 2
    contrast = np.sqrt(_mean(deviation * deviation, window_px) + (floor or 1.0))
    scaled = 128.5 + _NORMALISED_DN * deviation / contrast
    return np.asarray(np.clip(scaled, 0.0, 255.0), dtype=np.float32).astype(np.uint8)


def _mean(values: NDArray[Any], window_px: int) -> Float32Array:
    """Twice over a square: nearly a Gaussian."""
    size = (window_px, window_px)
    return np.asarray(cv2.blur(cv2.blur(values, size), size), dtype=np.float32)


POINT_COLUMNS = ("followup_x_px", "followup_y_px", "reference_x_px", "reference_y_px")
FEWEST_POINTS = 4
"""A homography has eight unknowns, and each pair of points gives two equations."""

_MOST_POINTS = 100_000


def parse_points(text: str) -> FeatureMatches:
    """Return the four or more pairs of points of a table, whose columns stand in any order."""
    try:
        table = csv.DictReader(StringIO(text, newline=""), strict=True)
        present = [column.strip() for column in table.fieldnames or ()]
        missing = [column for column in POINT_COLUMNS if column not in present]
        if missing:
            raise ValueError(
                f"no column {missing[0]}; the first line must be {','.join(POINT_COLUMNS)}"
            )
        table.fieldnames = present
        rows = [
            [_number(row[column], column, f"line {table.line_num}") for column in POINT_COLUMNS]
            for row in _few(table)
        ]
    except csv.Error as error:
        raise ValueError(f"not a table of values with commas: {error}") from error
    points = np.array(rows, dtype=np.float64).reshape(-1, len(POINT_COLUMNS))
    for part in (points[:, :2], points[:, 2:]):
        count = len(np.unique(part, axis=0))
        if count < FEWEST_POINTS:
            raise ValueError(
                f"{count} distinct pairs of points; mark at least {FEWEST_POINTS}, well apart and "
                "not on one line"
            )
    return FeatureMatches(points[:, :2], points[:, 2:])


def _few(table: "csv.DictReader[str]") -> list[dict[str, str | None]]:
    rows: list[dict[str, str | None]] = []
    for row in table:
        if len(rows) == _MOST_POINTS:
            raise ValueError(f"more than {_MOST_POINTS} pairs of points")
        rows.append(row)
    return rows


def _number(text: str | None, column: str, where: str) -> float:
    written = (text or "").strip()
    try:
        value = float(written)
    except ValueError:
        value = nan
    if not isfinite(value):
        said = f"{written[:40]!r} is no number" if written else "is missing"
        raise ValueError(f"{where}: {column} {said}")
    return value


POINTS_MIN = 4
"""Pairs of points that determine a homography."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RegistrationHints(ByValue):
    """What is known of a pose before two photographs are aligned; None for what is not known.

    Parameters
    ----------
    zoom
        Approximate ratio of the distances, follow-up over reference, accurate to about 15 %.
    matrix
        Approximate homography, shape (3, 3), from follow-up pixels ``(x, y, 1)`` to reference
        pixels. It is refined; if that fails it is used as given, and the result has a warning.
    points
        At least 4 pairs of points, no three on a line, accurate to a few pixels. The homography
        through them is refined; if that fails it is used as it is, and the result has a warning.
    left_out
        Mask of the follow-up pixels that do not count, shape ``(rows, cols)`` of the follow-up.
    mirrored
        Whether one of the two shows the scene as in a mirror. A homography given as a hint must
        then be that of the follow-up as it is, with a negative determinant.

    Raises
    ------
    ArgumentError
        If a value has the wrong type or is out of range.

    Examples
    --------
    >>> hints = standoff.RegistrationHints(zoom=1.2)
    >>> round(standoff.register("before.tif", "after.tif", hints=hints).zoom, 2)
    1.19
    """

    zoom: float | None = None
    matrix: FloatArray | None = None
    points: FeatureMatches | None = None
    left_out: BoolArray | None = None
    mirrored: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        if self.matrix is not None:
            fault = homography_fault(self.matrix)
            if fault is not None:
                raise ArgumentError(fault, argument="matrix")
        if self.left_out is not None and self.left_out.ndim != 2:
            raise ArgumentError(
                f"expected shape (rows, cols), got {self.left_out.shape}", argument="left_out"
            )
        if self.points is not None and len(self.points.followup_px) < POINTS_MIN:
            raise ArgumentError(
                f"{POINTS_MIN} pairs are needed, got {len(self.points.followup_px)}",
                argument="points",
            )

    @property
    def is_of_pose(self) -> bool:
        """Whether the hints concern the pose, and not only pixels to leave out."""
        return self.mirrored or any(
            one is not None for one in (self.zoom, self.matrix, self.points)
        )

    def with_columns_reversed(self, shape: tuple[int, int]) -> Self:
        """Return the hints for the mirror image of a follow-up of ``(rows, cols)``."""
        matrix, points, left_out = self.matrix, self.points, self.left_out
        if matrix is not None:
            matrix = mirrored_matrix(matrix, shape)
        if points is not None:
            reversed_px = points.followup_px * (-1, 1) + (shape[1] - 1, 0)
            points = FeatureMatches(reversed_px, points.reference_px)
        if left_out is not None:
            left_out = np.ascontiguousarray(left_out[:, ::-1])
        return replace(
            self, matrix=matrix, points=points, left_out=left_out, mirrored=not self.mirrored
        )


def leaving_out(
    hints: RegistrationHints | None, left_out: BoolArray | None
) -> RegistrationHints | None:
    """Return the hints, with further follow-up pixels left out."""
    if left_out is None:
        return hints
    hints = hints or RegistrationHints()
    if hints.left_out is not None and hints.left_out.shape == left_out.shape:
        left_out = left_out | hints.left_out
    return replace(hints, left_out=left_out)
