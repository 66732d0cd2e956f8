"""Registration of a follow-up in its reference: by matched features, then by all pixels."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from calibration.registration.distorted_pose import DistortedPose
from calibration.registration.distortion_refinement import refined_distorted_pose
from calibration.registration.features import homography_pose, match_features
from calibration.registration.hints import RegistrationHints
from calibration.registration.refinement import zoom_at_centre
from simulation import GaussianPsf
from simulation.arrays import AnyArray, FloatArray

_DISAGREEMENT_MAX_PX = 1.5
_PLACE_ERR_MAX_PX = 0.25


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Registration:
    """Pose of a follow-up in its reference, nearer or further away.

    Parameters
    ----------
    pose
        Position of every follow-up pixel in the reference.
    place_err_px
        Standard error of a follow-up pixel's position in the reference, rms over the overlap,
        reference px.
    k1_err
        Standard error of ``pose.k1``; 0 where no distortion was fitted.
    feature_matrix
        Shape (3, 3): the homography that was refined, as a rule that of the matched features.
    inlier_count, match_rms_px
        Feature matches that agree with the pose, and their rms distance from it in reference px;
        both are 0 where the pose was found without features.
    correlation
        Of the two photographs at the resolution of the coarser one, slow changes of light removed.
    residual_rms_dn
        Remaining difference between them, in the units of the coarser photograph.
    warnings
        Sentences on what an operator should check.
    """

    pose: DistortedPose
    place_err_px: float
    k1_err: float
    feature_matrix: FloatArray = field(repr=False)
    inlier_count: int
    match_rms_px: float
    correlation: float
    residual_rms_dn: float
    warnings: tuple[str, ...] = ()

    @property
    def matrix(self) -> FloatArray:
        """Shape (3, 3): follow-up pixel centres ``(x, y, 1)`` to the reference's, ideal lens."""
        return self.pose.matrix

    @property
    def zoom(self) -> float:
        """Reference pixels per follow-up pixel at the follow-up's centre."""
        return self.pose.zoom


def register(
    reference: AnyArray,
    followup: AnyArray,
    psf: GaussianPsf | None = None,
    hints: RegistrationHints | None = None,
) -> Registration:
    """Pose of ``followup`` in ``reference``.

    Parameters
    ----------
    reference, followup
        Grey, shape ``(rows, cols)``; either may be the nearer one. If their shapes agree they are
        taken for whole frames of one camera, whose distortion is fitted.
    psf
        Total PSF of the camera; without it, one of 0.65 px is assumed.
    hints
        What is known beforehand.

    Raises
    ------
    RegistrationError
        If the two cannot be aligned; the message names the ways on.
    """
    hints = hints or RegistrationHints()
    expected = hints.matrix
    if hints.zoom is not None:
        middles = [[(n - 1) / 2 for n in _shape(image)] for image in (reference, followup)]
        y_px, x_px = (r - hints.zoom * f for r, f in zip(*middles, strict=True))
        expected = np.array([[hints.zoom, 0, x_px], [0, hints.zoom, y_px], [0, 0, 1.0]])
    try:
        matches = match_features(reference, followup, expected)
        matrix, inlier = homography_pose(matches)
    except RegistrationError:
        if expected is None:
            raise
        matches = match_features(reference, followup)
        matrix, inlier = homography_pose(matches)
    if zoom_at_centre(matrix, _shape(followup)) < 1:
        fit = refined_distorted_pose(
            followup, reference, psf, np.asarray(np.linalg.inv(matrix), np.float64)
        )
        pose = fit.pose.inverse()
    else:
        fit = refined_distorted_pose(reference, followup, psf, matrix)
        pose = fit.pose
    reference_y, reference_x = pose.to_reference_px(
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
    return Registration(
        pose=pose,
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
