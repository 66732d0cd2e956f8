"""Where a follow-up looks, what a caller may choose about it, and the warp at single positions."""

from dataclasses import dataclass
from math import isfinite
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from simulation.arrays import FloatArray
from simulation.choices import DEFAULT_MODEL, POSE_MODELS, PoseModel
from simulation.pose._prefilter import LocalPose
from simulation.pose._warp import (
    BlurredWarp,
    derivatives,
    ideal_points,
    lens_of,
    projection_depth,
    refuse_folding,
    survey,
)
from simulation.psf import Psf, PsfField

_SINGULAR = 1e-9
"""Least determinant of a homography between frames scaled to unit squares, relative."""

_LARGE_EXPONENT = 100
"""Of two: products of four elements beyond it may overflow; their common scale is free."""

_BORDER_POINTS = 33
"""Points along a side of a frame: a lens bends it, so its corners are not enough."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseView:
    """A homography between two frames of one camera, checked, with the camera's lens and PSF.

    ``matrix``, shape (3, 3), takes follow-up pixels ``(x, y, 1)`` to reference pixels, both without
    distortion; the third component is positive all over the follow-up. ``lens`` is as in
    `simulation.pose._warp`; ``reference`` and ``follow_up`` are ``(rows, cols)``;
    ``coefficients_px2``, shape ``(3, n)``, is the PSF's covariance as ``PsfField`` writes it.
    ``frame`` holds the centre x, y and 1 / radius of that field, and the position x, y of the
    follow-up's pixel (0, 0) in it.
    """

    matrix: FloatArray
    lens: FloatArray
    reference: tuple[int, int]
    follow_up: tuple[int, int]
    psf: Psf | PsfField
    coefficients_px2: FloatArray
    frame: FloatArray

    @classmethod
    def of(
        cls,
        homography: NDArray[np.floating[Any]],
        reference: tuple[int, int],
        size: tuple[int, int],
        psf: Psf | PsfField | None,
        origin_px: tuple[float, float] | None,
        distortion_k1: float = 0.0,
    ) -> Self:
        """Validate a caller's input; the parameters and errors are those of ``simulate_pose``."""
        width, height = _checked_size(size)
        if psf is None:
            raise ValueError("another pose needs a PSF")
        rows, cols = reference
        coefficients, frame = _polynomials(psf, (cols, rows), (width, height), origin_px)
        lens = lens_of(distortion_k1, reference, (height, width), origin_px)
        refuse_folding(distortion_k1, lens, (height, width))
        return cls(
            matrix=_checked_homography(homography, (cols, rows), (width, height), lens),
            lens=lens,
            reference=reference,
            follow_up=(height, width),
            psf=psf,
            coefficients_px2=coefficients,
            frame=frame,
        )

    @property
    def is_by_whole_pixels(self) -> bool:
        """Whether every pixel of the follow-up is a pixel of the reference as it is."""
        matrix = self.matrix / self.matrix[2, 2]
        moved = np.round(matrix[:2, 2])
        is_shift = np.allclose(matrix, [[1, 0, moved[0]], [0, 1, moved[1]], [0, 0, 1]], 0, 1e-9)
        # Distortion goes with the place in the frame, and a PSF that varies over it too.
        is_free = self.lens[0] == 0 and not isinstance(self.psf, PsfField)
        is_at_its_place = (
            not moved.any()
            and not self.frame[3:].any()
            and np.array_equal(self.lens[1:3], self.lens[3:5])
        )
        return is_shift and (is_free or is_at_its_place)

    @property
    def warp(self) -> BlurredWarp:
        """The view as the compiled functions take it."""
        return BlurredWarp(self.matrix, self.lens, self.coefficients_px2, self.frame)

    @property
    def key(self) -> tuple[object, ...]:
        """What makes two views the same, hashable."""
        arrays = (self.matrix, self.lens, self.frame)
        return (*(a.tobytes() for a in arrays), self.reference, self.follow_up, self.psf)

    def psf_near(self, x_px: float, y_px: float) -> Psf:
        """PSF at a reference position; that of the nearest pixel for one outside the frame."""
        if not isinstance(self.psf, PsfField):
            return self.psf
        x, y = np.clip([x_px, y_px], 0, [self.psf.width_px - 1, self.psf.height_px - 1]).tolist()
        return self.psf.at(x, y)

    def psf_far(self, x_px: float, y_px: float) -> Psf:
        """PSF at a follow-up position, which lies elsewhere in the camera's frame."""
        x, y = self.frame[3:].tolist()
        return self.psf_near(x_px + x, y_px + y)

    def survey(self, rows_px: FloatArray, cols_px: FloatArray) -> FloatArray:
        """Evaluate a lattice of positions in the follow-up, shape ``(rows, cols, 5)``.

        Reference x, y and the missing blur ``A Sigma A^T - Sigma``: xx, xy, yy; maybe indefinite.
        """
        return survey(self.warp, rows_px, cols_px)


def _polynomials(
    psf: Psf | PsfField,
    reference: tuple[int, int],
    follow_up: tuple[int, int],
    origin_px: tuple[float, float] | None,
) -> tuple[FloatArray, FloatArray]:
    """Coefficients and frame of a PSF; sizes are (width, height)."""
    if not isinstance(psf, PsfField):
        (xx, xy), (_, yy) = psf.covariance_px2.tolist()
        return np.array([[xx], [xy], [yy]]), np.zeros(5)
    frame = (psf.width_px, psf.height_px)
    whose = f"the PSF field belongs to frames of {frame[0]} x {frame[1]} px, but the"
    if reference != frame:
        raise ValueError(f"{whose} reference has {reference[0]} x {reference[1]} px")
    x, y = origin_px or (0.0, 0.0)
    inside = x >= 0 and y >= 0 and x + follow_up[0] <= frame[0] and y + follow_up[1] <= frame[1]
    if not inside or (origin_px is None and follow_up != frame):
        raise ValueError(
            f"{whose} follow-up has {follow_up[0]} x {follow_up[1]} px, its first pixel at "
            f"({x:g}, {y:g})"
        )
    return psf.coefficients_px2.copy(), np.array([*psf.centre_px, 1 / psf.corner_radius_px, x, y])


def _checked_homography(
    homography: NDArray[np.floating[Any]],
    reference: tuple[int, int],
    follow_up: tuple[int, int],
    lens: FloatArray,
) -> FloatArray:
    """Homography with a positive denominator all over the follow-up; sizes (width, height)."""
    matrix = np.array(homography, dtype=np.float64)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise ValueError(f"a homography must be a finite 3 x 3 matrix, got {homography!r}")
    exponent = int(np.frexp(np.abs(matrix).max())[1])
    if abs(exponent) > _LARGE_EXPONENT:
        matrix = np.ldexp(matrix, -exponent)
    scaled = (
        np.diag([1 / reference[0], 1 / reference[1], 1.0])
        @ matrix
        @ np.diag([follow_up[0], follow_up[1], 1.0])
    )
    norm = float(np.linalg.norm(scaled))
    if not (norm > 0 and abs(np.linalg.det(scaled / norm)) > _SINGULAR):
        raise ValueError("the homography is singular")
    width, height = follow_up
    x, y = (np.linspace(-0.5, size - 0.5, _BORDER_POINTS) for size in (width, height))
    along_x = np.stack(np.meshgrid(x, [-0.5, height - 0.5]), axis=-1).reshape(-1, 2)
    along_y = np.stack(np.meshgrid([-0.5, width - 0.5], y), axis=-1).reshape(-1, 2)
    border = ideal_points(lens, np.concatenate([along_x, along_y]))
    depths = projection_depth(matrix, border[:, 0], border[:, 1])
    if depths.min() < 0:
        matrix, depths = -matrix, -depths
    if not depths.min() > 1e-6 * depths.max():
        raise ValueError("the plane's horizon is inside the follow-up")
    return matrix


def _checked_size(size: tuple[int, int]) -> tuple[int, int]:
    width, height = size
    for value in (width, height):
        if not (isfinite(value) and int(value) == value and value >= 1):
            raise ValueError(f"size must be (width, height) in whole pixels, got {size}")
    return int(width), int(height)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOptions:
    """Model, noise, threads, and where the follow-up lies in the lens's frame.

    ``noise_ratio`` is the variance of the reference's noise over that of the scene, for ``lmmse``.
    ``threads`` share the work; the result is the same to the last bit. ``origin_px`` is the
    position ``(x, y)`` of the follow-up's pixel (0, 0) in the camera's frame, if it is a part of
    that frame; by default it is the whole frame, and it matters only for a PSF field and a
    distortion. ``distortion_k1`` is the radial distortion of the lens that took both: an ideal
    point at the radius r from the reference's centre, 1 at its corner, is seen at ``r (1 + k1
    r^2)``. The homography is then that of the ideal points.
    """

    model: PoseModel = DEFAULT_MODEL
    noise_ratio: float = 0.0
    threads: int = 1
    origin_px: tuple[float, float] | None = None
    distortion_k1: float = 0.0

    def model_of(self, view: PoseView) -> PoseModel:
        """Return the model for a view: ``matched`` where pixels are the reference's own."""
        return "matched" if view.is_by_whole_pixels else self.model

    def __post_init__(self) -> None:
        if self.model not in POSE_MODELS:
            raise ValueError(f"model must be one of {', '.join(POSE_MODELS)}, got {self.model!r}")
        if not (self.noise_ratio >= 0 and isfinite(self.noise_ratio)):
            raise ValueError(f"noise_ratio must not be negative, got {self.noise_ratio}")
        if self.threads < 1:
            raise ValueError(f"threads must be at least 1, got {self.threads}")


DEFAULT_OPTIONS = PoseOptions()


_DECIMALS = 6
"""Of the derivatives, for which kernels are cached."""

_BEYOND = 1.25
"""Where a view shows nothing, the derivative's limit over its largest value where it does."""

_FAR_PX = 1e8
"""Positions further away are those of no point that the lens shows."""


def poses_at_followup(view: PoseView, points_px: FloatArray) -> tuple[LocalPose, ...]:
    """Local poses at follow-up positions, shape (n, 2), order (x, y)."""
    positions, slopes = derivatives(view.matrix, view.lens, points_px)
    return _local_poses(view, positions, points_px, slopes)


def poses_at_reference(
    view: PoseView, points_px: FloatArray, largest: float
) -> tuple[LocalPose, ...]:
    """Local poses at reference positions, shape (n, 2), order (x, y).

    Where the view shows nothing, the derivative follows its formula as far as 1.25 times
    ``largest``, its largest singular value where something is seen.
    """
    inverse = np.asarray(np.linalg.inv(view.matrix), dtype=np.float64)
    turned = view.lens[[0, 3, 4, 1, 2]]
    followup, back = derivatives(inverse, turned, points_px)
    height, width = view.follow_up
    is_far = ~(np.abs(followup).max(axis=1) < _FAR_PX)
    followup = np.clip(
        np.nan_to_num(followup, nan=0.0), 0.0, [max(width - 1, 0), max(height - 1, 0)]
    )
    determinant = back[:, 0, 0] * back[:, 1, 1] - back[:, 0, 1] * back[:, 1, 0]
    is_far |= ~(np.abs(determinant) > 1e-12)
    back[is_far] = np.linalg.inv(derivatives(view.matrix, view.lens, followup)[1][is_far])
    slopes = np.asarray(np.linalg.inv(back), dtype=np.float64)
    excess = np.linalg.norm(slopes, 2, axis=(1, 2)) / (_BEYOND * largest)
    slopes /= np.maximum(excess, 1.0)[:, None, None]
    return _local_poses(view, points_px, followup, slopes)


def _local_poses(
    view: PoseView, reference_px: FloatArray, followup_px: FloatArray, slopes: FloatArray
) -> tuple[LocalPose, ...]:
    found = []
    for position, own, slope in zip(reference_px, followup_px, slopes, strict=True):
        near, far = view.psf_near(*position.tolist()), view.psf_far(*own.tolist())
        kept = without_sharpening(slope, near.covariance_px2, far.covariance_px2)
        a, b, c, d = np.round(kept, _DECIMALS).ravel().tolist()
        found.append(LocalPose(near=near, far=far, slopes=(a, b, c, d)))
    return tuple(found)


def without_sharpening(slopes: FloatArray, near_px2: FloatArray, far_px2: FloatArray) -> FloatArray:
    """Derivatives of warps whose follow-up is nowhere sharper than the reference.

    ``slopes`` are derivatives A, shape (..., 2, 2); the covariances of the two PSFs are each in its
    own pixels. A itself if nothing is sharper; else A' with the rotation of A, and with ``A'
    Sigma_far A'^T`` that of A less the part by which it falls short of ``Sigma_near``.
    """
    missing = slopes @ far_px2 @ np.swapaxes(slopes, -1, -2) - near_px2
    values, vectors = np.linalg.eigh(missing)
    restored = (vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    root = _matrix_root(far_px2)
    left, _, right = np.linalg.svd(slopes @ root)
    softer = _matrix_root(near_px2 + restored) @ left @ right @ np.linalg.inv(root)
    return np.where(values[..., :1, None] >= 0, slopes, softer)


def _matrix_root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2))
