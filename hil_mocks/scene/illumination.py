"""Effects of the light on the image: fall-off to the corners, a shadow, a lamp's glare."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from hil_mocks.scene.pinhole import CameraPose, PinholeCamera

LAMP_X_MM, LAMP_Y_MM, LAMP_HEIGHT_MM = 130.0, -70.0, 450.0
"""The lamp above the plane; its mirror image moves on the print when the camera moves."""

GLARE_SIGMA_MM = 9.0
"""Width of the highlight on satin paper."""

SHADOW_SIGMA_MM = 60.0
"""Half-width of the soft border of the shadow; the border crosses the plane's origin."""

SHADOW_TOWARDS = (0.8, 0.6)
"""Unit vector (x, y) towards the dark side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Illumination:
    """Light on the plane, seen through a vignetting lens and with a highlight.

    Parameters
    ----------
    vignetting
        Relative fall-off at the image corner; it follows the fourth power of a cosine.
    gloss
        Peak of the highlight, relative to white paper.
    shadow
        Relative loss of light on the dark side of a soft shadow on the plane.
    dimming_per_100mm
        Relative loss of light for every 100 mm of height: the stand shades the plane.
    """

    vignetting: float
    gloss: float
    shadow: float = 0.0
    dimming_per_100mm: float = 0.0

    def lit(
        self, image: NDArray[np.float32], camera: PinholeCamera, pose: CameraPose
    ) -> NDArray[np.float32]:
        """Apply this light to the image of an evenly lit scene."""
        if not (self.vignetting or self.gloss or self.shadow or self.dimming_per_100mm):
            return image
        x_px = np.arange(image.shape[1], dtype=np.float64)[None, :]
        y_px = np.arange(image.shape[0], dtype=np.float64)[:, None]
        lit = image.astype(np.float64)
        lit *= (1 - self.dimming_per_100mm) ** (pose.height_mm / 100)
        if self.shadow or self.gloss:
            x_mm, y_mm = camera.to_plane_mm(x_px, y_px, pose)
            if self.shadow:
                # So soft that it does not matter whether it is applied before or after the blur.
                into_mm = SHADOW_TOWARDS[0] * x_mm + SHADOW_TOWARDS[1] * y_mm
                lit *= 1 - self.shadow * ndtr(into_mm / SHADOW_SIGMA_MM)
            if self.gloss:
                lit += self._glare(x_mm, y_mm, camera, pose)
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
