"""Registration of a follow-up in its reference: by matched features, then by all pixels.

SIFT features give the pose to some tenths of a pixel. A Gauss-Newton descent then compares the
follow-up with the reference *simulated at the follow-up's distance*, gain and offset free, and
brings the error to about a hundredth of a pixel.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from calibration.registration.acceptance import refuse_nearer
from calibration.registration.distorted_pose import DistortedPose
from calibration.registration.distortion_refinement import refined_distorted_pose
from calibration.registration.features import homography_pose, match_features
from calibration.registration.refinement import refined_pose, zoom_at_centre
from simulation import GaussianPsf
from simulation.arrays import AnyArray, FloatArray

_DISAGREEMENT_MAX_PX = 1.5
"""Median distance of features from the pose by pixels; features alone scatter by 0.3 px."""

_PLACE_ERR_MAX_PX = 0.25
"""Standard error of a pixel's position above which an alignment is not fit for a comparison."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Registration:
    """Pose of a follow-up in its reference.

    Parameters
    ----------
    matrix
        Shape (3, 3), last element 1: follow-up pixel centres ``(x, y, 1)`` to reference pixel
        centres.
    zoom
        Reference pixels per follow-up pixel at the follow-up's centre.
    inlier_count, match_rms_px
        Feature matches that agree with the pose, and their rms distance from it in reference px.
    correlation
        Correlation of the follow-up with the simulated one.
    residual_rms_dn
        Remaining difference between them, in the follow-up's units.
    """

    matrix: FloatArray = field(repr=False)
    zoom: float
    inlier_count: int
    match_rms_px: float
    correlation: float
    residual_rms_dn: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DistortedRegistration:
    """Pose of a follow-up in its reference, with the distortion of the lens that took both.

    Parameters
    ----------
    pose
        Position of every follow-up pixel in the reference.
    zoom
        Reference pixels per follow-up pixel at the follow-up's centre.
    place_err_px
        Standard error of a follow-up pixel's position in the reference, rms over the overlap,
        reference px.
    k1_err
        Standard error of ``pose.k1``.
    feature_matrix
        Shape (3, 3): the homography of the features alone, as it is widely used: without distortion
        and before refinement on the pixels.
    inlier_count, match_rms_px, correlation, residual_rms_dn
        As in ``Registration``; slow changes of light are removed first.
    """

    pose: DistortedPose
    zoom: float
    place_err_px: float
    k1_err: float
    feature_matrix: FloatArray = field(repr=False)
    inlier_count: int
    match_rms_px: float
    correlation: float
    residual_rms_dn: float


def register(
    reference: AnyArray,
    followup: AnyArray,
    psf: GaussianPsf | None = None,
) -> Registration:
    """Pose of ``followup`` in ``reference`` as a homography.

    Parameters
    ----------
    reference, followup
        Grey, shape ``(rows, cols)``; uint8, uint16, float32 or float64. The follow-up is the one
        from further away.
    psf
        Total PSF of the camera; without it the reference is simulated by ``bicubic``.

    Raises
    ------
    RegistrationError
        If too few features match, if the follow-up is nearer than the reference, or if the images
        overlap too little or do not agree.
    """
    matches = match_features(reference, followup)
    matrix, inlier = homography_pose(matches)
    fit = refined_pose(reference, followup, psf, matrix)
    return Registration(
        matrix=fit.matrix,
        zoom=zoom_at_centre(fit.matrix, _shape(followup)),
        inlier_count=int(inlier.sum()),
        match_rms_px=matches.rms_px(fit.matrix, inlier),
        correlation=fit.correlation,
        residual_rms_dn=fit.residual_rms_dn,
    )


def register_distorted(
    reference: AnyArray,
    followup: AnyArray,
    psf: GaussianPsf | None = None,
    expected_zoom: float | None = None,
) -> DistortedRegistration:
    """Pose of ``followup`` in ``reference``, and the radial distortion of their common lens.

    Parameters
    ----------
    reference, followup
        Grey, whole frames of one camera; if their shapes differ, no distortion is fitted.
    psf
        Total PSF of the camera; without it, one of 0.65 px is assumed.
    expected_zoom
        Approximate ratio of the distances, for images of about the same centre: resolves the
        ambiguity of a repeating pattern. If that finds no pose, features are matched everywhere.

    Raises
    ------
    RegistrationError
        If too few features match, if the follow-up is nearer than the reference, if the images
        overlap too little or do not agree, if features and pixels contradict each other, or if the
        pose is too uncertain.
    """
    if expected_zoom is not None:
        middles = [[(n - 1) / 2 for n in _shape(image)] for image in (reference, followup)]
        y_px, x_px = (r - expected_zoom * f for r, f in zip(*middles, strict=True))
        expected = np.array([[expected_zoom, 0, x_px], [0, expected_zoom, y_px], [0, 0, 1.0]])
        try:
            return _register_distorted(reference, followup, psf, expected)
        except RegistrationError:
            # The camera may have been shifted or turned.
            pass
    return _register_distorted(reference, followup, psf, None)


def _register_distorted(
    reference: AnyArray,
    followup: AnyArray,
    psf: GaussianPsf | None,
    expected: FloatArray | None,
) -> DistortedRegistration:
    matches = match_features(reference, followup, expected)
    matrix, inlier = homography_pose(matches)
    fit = refined_distorted_pose(reference, followup, psf, matrix)
    zoom = fit.pose.zoom
    refuse_nearer(zoom)
    reference_y, reference_x = fit.pose.to_reference_px(
        matches.followup_px[inlier, 1], matches.followup_px[inlier, 0]
    )
    apart_px = np.hypot(
        reference_x - matches.reference_px[inlier, 0],
        reference_y - matches.reference_px[inlier, 1],
    )
    if np.median(apart_px) > _DISAGREEMENT_MAX_PX:
        raise RegistrationError(
            f"the matched features and the pixels disagree by {np.median(apart_px):.1f} px",
            reason="contradiction",
            error_px=float(np.median(apart_px)),
        )
    if not fit.place_err_px <= _PLACE_ERR_MAX_PX:
        raise RegistrationError(
            f"the pose is uncertain by {fit.place_err_px:.2f} px, "
            f"{_PLACE_ERR_MAX_PX} px are allowed",
            reason="uncertain",
            error_px=fit.place_err_px,
        )
    return DistortedRegistration(
        pose=fit.pose,
        zoom=zoom,
        place_err_px=fit.place_err_px,
        k1_err=fit.k1_err,
        feature_matrix=matrix,
        inlier_count=int(inlier.sum()),
        match_rms_px=float(np.sqrt(np.mean(apart_px**2))),
        correlation=fit.correlation,
        residual_rms_dn=fit.residual_rms_dn,
    )


def _shape(image: NDArray[Any]) -> tuple[int, int]:
    return image.shape[0], image.shape[1]
