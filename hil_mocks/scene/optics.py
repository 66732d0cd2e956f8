"""Blur of the lens: a Gaussian on the sensor that grows to the corner and with defocus."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PIXEL_VARIANCE_PX2 = 1.0 / 12.0
"""Variance of a unit square along either axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """The optical point spread function: a covariance in px^2, order (x, y).

    Parameters
    ----------
    sigma_x_px, sigma_y_px, rho
        Widths and correlation in focus, at the image centre, excluding the pixel square.
    corner_sigma_gain
        Relative growth of sigma to the corner: ``Sigma(r) = Sigma(0) (1 + gain r^2)^2`` with
        ``r`` = 1 at the image corner.
    focal_length_mm, f_number, pixel_pitch_um
        Parameters of the blur disc of a defocused lens.
    focus_distance_mm
        Distance in focus; None refocuses at every height.
    """

    sigma_x_px: float
    sigma_y_px: float
    rho: float
    corner_sigma_gain: float
    focal_length_mm: float
    f_number: float
    pixel_pitch_um: float
    focus_distance_mm: float | None = None

    def __post_init__(self) -> None:
        if self.focus_distance_mm is not None and self.focus_distance_mm <= self.focal_length_mm:
            raise ValueError(
                f"focus_distance_mm must be beyond the focal length, got {self.focus_distance_mm}"
            )

    @property
    def in_focus_covariance_px2(self) -> NDArray[np.float64]:
        """Covariance at the image centre in focus, shape (2, 2)."""
        xy = self.rho * self.sigma_x_px * self.sigma_y_px
        return np.array([[self.sigma_x_px**2, xy], [xy, self.sigma_y_px**2]])

    def blur_disc_px(self, distance_mm: float) -> float:
        """Diameter of the blur disc of a point at ``distance_mm``, by the thin lens equation.

        References
        ----------
        Hecht, Optics, 5th ed. 2017, section 5.2: an aperture f/N, focused at s, blurs an object
        at d to ``(f / N) f |d - s| / (d (s - f))``.
        """
        if self.focus_distance_mm is None:
            return 0.0
        f, s, d = self.focal_length_mm, self.focus_distance_mm, distance_mm
        disc_mm = f / self.f_number * f * abs(d - s) / (d * (s - f))
        return disc_mm / (self.pixel_pitch_um * 1e-3)

    def defocus_variance_px2(self, distance_mm: float) -> float:
        """Variance of the blur disc along either axis: diameter^2 / 16."""
        return self.blur_disc_px(distance_mm) ** 2 / 16

    def growth(self, relative_radius: NDArray[np.float64]) -> NDArray[np.float64]:
        """Factor on the in-focus covariance at a radius that is 1 at the image corner."""
        return np.asarray((1 + self.corner_sigma_gain * relative_radius**2) ** 2)

    def covariance_px2(
        self, distance_mm: float, relative_radius: float = 0.0
    ) -> NDArray[np.float64]:
        """Optical covariance with defocus at a radius that is 1 at the corner, shape (2, 2)."""
        growth = float(self.growth(np.asarray(relative_radius)))
        return growth * self.in_focus_covariance_px2 + self.defocus_variance_px2(
            distance_mm
        ) * np.eye(2)
