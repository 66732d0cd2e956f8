"""What the light adds to the picture: fall-off to the corners and the glare of a lamp."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from hil_mocks.pinhole import CameraPose, PinholeCamera

__all__ = ["Illumination"]

LAMP_X_MM, LAMP_Y_MM, LAMP_HEIGHT_MM = 130.0, -70.0, 450.0
"""The lamp above the plane; its mirror image moves on the print when the camera moves."""

GLARE_SIGMA_MM = 9.0
"""Width of the highlight on satin paper."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Illumination:
    """Even light on the plane, seen through a vignetting lens and with a highlight.

    Parameters
    ----------
    vignetting
        Relative fall-off at the image corner; in between as the fourth power of a cosine.
    gloss
        Peak of the highlight, relative to white paper.
    """

    vignetting: float
    gloss: float

    def lit(
        self, image: NDArray[np.float32], camera: PinholeCamera, pose: CameraPose
    ) -> NDArray[np.float32]:
        """The picture of an evenly lit scene, with vignetting and highlight."""
        if not (self.vignetting or self.gloss):
            return image
        x_px = np.arange(image.shape[1], dtype=np.float64)[None, :]
        y_px = np.arange(image.shape[0], dtype=np.float64)[:, None]
        lit = image.astype(np.float64)
        if self.gloss:
            lit += self._glare(*camera.to_plane_mm(x_px, y_px, pose), camera, pose)
        tangent2 = 1 / sqrt(1 - self.vignetting) - 1
        lit /= (1 + tangent2 * camera.relative_radius(x_px, y_px) ** 2) ** 2
        return lit.astype(np.float32)

    def _glare(
        self,
        x_mm: NDArray[np.float64],
        y_mm: NDArray[np.float64],
        camera: PinholeCamera,
        pose: CameraPose,
    ) -> NDArray[np.float64]:
        """The highlight about the point where the plane mirrors the lamp into the pupil."""
        distance_mm = camera.distance_mm(pose.height_mm)
        share = distance_mm / (distance_mm + LAMP_HEIGHT_MM)
        across_mm = x_mm - pose.offset_x_mm - share * (LAMP_X_MM - pose.offset_x_mm)
        down_mm = y_mm - pose.offset_y_mm - share * (LAMP_Y_MM - pose.offset_y_mm)
        return np.asarray(
            self.gloss * np.exp(-(across_mm**2 + down_mm**2) / (2 * GLARE_SIGMA_MM**2))
        )
