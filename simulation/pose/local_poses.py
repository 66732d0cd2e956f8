"""The warp at single positions of a view, as prefilters take it."""

import numpy as np

from simulation.arrays import FloatArray
from simulation.pose.missing_blur import derivatives
from simulation.pose.prefilter import LocalPose
from simulation.pose.view import PoseView

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
    """Derivative of the warp whose follow-up is nowhere sharper than the reference.

    Parameters
    ----------
    slopes
        The derivative A, shape (2, 2).
    near_px2, far_px2
        Covariances of the two PSFs, each in its own pixels.

    Returns
    -------
    ndarray of shape (2, 2)
        A itself if nothing is sharper. Else A' with the rotation of A, and with
        ``A' Sigma_far A'^T`` that of A less the part by which it falls short of ``Sigma_near``.
    """
    values, vectors = np.linalg.eigh(slopes @ far_px2 @ slopes.T - near_px2)
    if values[0] >= 0:
        return slopes
    blurred = near_px2 + (vectors * np.maximum(values, 0.0)) @ vectors.T
    root = _root(far_px2)
    left, _, right = np.linalg.svd(slopes @ root)
    return np.asarray(_root(blurred) @ left @ right @ np.linalg.inv(root))


def _root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)
