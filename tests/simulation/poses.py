"""Homographies that camera poses give, and what is looked at through them."""

from collections.abc import Callable
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray
from skimage import data

from simulation import GaussianPsf, PsfField
from simulation.arrays import FloatArray
from tests.simulation.closed_form import gaussian_blob

PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7)
TILTED_PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7, rho=0.3)

# scikit-image declares no types for its photographs.
load_camera: Callable[[], NDArray[np.uint8]] = data.camera
PHOTOGRAPH = load_camera().astype(np.float64)[100:300, 120:400]


def about_centre(
    linear: FloatArray, reference: tuple[int, int], size: tuple[int, int]
) -> FloatArray:
    """Affine homography that takes the follow-up's centre to the reference's; (width, height)."""
    matrix = np.eye(3)
    matrix[:2, :2] = linear
    centre, own = (np.array(s) / 2 - 0.5 for s in (reference, size))
    matrix[:2, 2] = centre - linear @ own
    return matrix


def turn(angle_deg: float) -> FloatArray:
    c, s = cos(radians(angle_deg)), sin(radians(angle_deg))
    return np.array([[c, -s], [s, c]])


def tilted(focal_px: float, size: tuple[int, int], tilt_deg: float, zoom: float) -> FloatArray:
    """Camera that leans towards +x and looks at the reference's centre from ``zoom`` times away.

    The plane lies at distance 1 of the upright reference camera.
    """
    t = radians(tilt_deg)
    rotation = np.array([[cos(t), 0, sin(t)], [0, 1, 0], [-sin(t), 0, cos(t)]])
    pupil = np.array([0, 0, 1]) - zoom * rotation[:, 2]
    rays = (1 - pupil[2]) * rotation + np.outer(pupil, rotation[2])
    on_plane = np.array([rays[0], rays[1], rotation[2]])
    intrinsic = np.array(
        [[focal_px, 0, size[0] / 2 - 0.5], [0, focal_px, size[1] / 2 - 0.5], [0, 0, 1]]
    )
    return np.asarray(intrinsic @ on_plane @ np.linalg.inv(intrinsic))


def blob(shape: tuple[int, int], centre_xy: FloatArray, covariance_xy: FloatArray) -> FloatArray:
    """Unit volume, covariance in order (x, y)."""
    return gaussian_blob(
        np.arange(shape[0]) - centre_xy[1],
        np.arange(shape[1]) - centre_xy[0],
        covariance_xy[::-1, ::-1],
    )


def constant_field(width: int, height: int, psf: GaussianPsf) -> PsfField:
    (xx, xy), (_, yy) = psf.covariance_px2
    coefficients = np.zeros((3, 6))
    coefficients[:, 0] = xx, xy, yy
    return PsfField(width_px=width, height_px=height, coefficients_px2=coefficients)
