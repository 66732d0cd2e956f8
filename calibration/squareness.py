"""Is the camera square to the target? From one pair of captures, without stage or scale."""

from dataclasses import dataclass
from math import degrees, hypot, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.board import DEFAULT_BOARD
from calibration.errors import GeometryError, RegistrationError
from calibration.geometry_series import GeometryCapture, adjust_captures
from calibration.plane_view import PlaneLens
from calibration.series_geometry import LensPrior

__all__ = ["Squareness", "pair_squareness"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Squareness:
    """Inclination of the optical axis against the target's normal, in degrees.

    ``tilt_x_deg`` is positive where the axis meets the target further along the image's +x than
    the perpendicular does. ``zoom`` is the ratio of the distances.
    """

    tilt_x_deg: float
    tilt_y_deg: float
    tilt_x_err_deg: float
    tilt_y_err_deg: float
    zoom: float
    zoom_err: float

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis and the target's normal."""
        return hypot(self.tilt_x_deg, self.tilt_y_deg)

    @property
    def tilt_err_deg(self) -> float:
        """Standard error of ``tilt_deg``; near zero it is that of a component."""
        if self.tilt_deg == 0:
            return hypot(self.tilt_x_err_deg, self.tilt_y_err_deg) / sqrt(2)
        return (
            hypot(self.tilt_x_deg * self.tilt_x_err_deg, self.tilt_y_deg * self.tilt_y_err_deg)
            / self.tilt_deg
        )


def pair_squareness(
    near: NDArray[np.floating[Any]],
    far: NDArray[np.floating[Any]],
    focal_length_px: float,
    prior: LensPrior | None = None,
) -> Squareness:
    """Tilt from two photographs of one textured target at two distances.

    Parameters
    ----------
    near, far
        Grey, of one shape ``(rows, cols)``; the zoom-out between them should be 1.2 or more.
    focal_length_px
        Focal length; the tilt is as right as it is.
    prior
        What is known of the lens; a lens without distortion lets one pair tell more.

    Raises
    ------
    RegistrationError
        If the photographs do not match.
    """
    if near.shape != far.shape:
        raise ValueError(f"photographs of one size are compared, got {near.shape} and {far.shape}")
    captures = [
        GeometryCapture(
            name=name,
            kind="texture",
            target="",
            orientation_deg=0.0,
            height_mm=0.0,
            image=image,
        )
        for name, image in (("near", near), ("far", far))
    ]
    lens = PlaneLens(
        width_px=near.shape[1], height_px=near.shape[0], focal_length_px=focal_length_px
    )
    try:
        found = adjust_captures(captures, lens, DEFAULT_BOARD, {}, prior=prior).adjustment
    except GeometryError as error:
        raise RegistrationError(str(error)) from error
    columns = found.layout.shared_columns(0)[-2:]
    tilt_errs = np.sqrt(np.diag(found.covariance))[columns]
    distance = found.layout.pose_columns(1)[0]
    zoom = found.poses[1].distance
    return Squareness(
        tilt_x_deg=degrees(found.lenses[0].tilt_x_rad),
        tilt_y_deg=degrees(found.lenses[0].tilt_y_rad),
        tilt_x_err_deg=degrees(float(tilt_errs[0])),
        tilt_y_err_deg=degrees(float(tilt_errs[1])),
        zoom=zoom,
        zoom_err=zoom * sqrt(float(found.covariance[distance, distance])),
    )
