"""The exact light on each pixel, and its level: pose, lens blur, pixel square, light, sensor.

The scene is sampled ``K`` times per pixel after a Gaussian blur that it computes in closed form,
so nothing aliases there; the rest of the lens's blur and the pixel's square are products with
their exact transfers in the Fourier domain; the result is read at the pixel centres. The
decision record ``docs/decisions/0001-how-the-bench-renders.md`` gives the reasons, and
``benchmarks/speed/render.py`` the speed.
"""

from dataclasses import dataclass
from functools import cached_property
from math import atan, atan2, ceil, cos, degrees, e, factorial, hypot, radians, sin, sqrt

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.special import ndtr

from hil_mocks.truth._images import FoldedSpectrum
from hil_mocks.truth.scenes import Scene, SceneWithRelief

Coordinates = NDArray[np.float64]

MIN_K1 = -0.14
"""The image folds over at a distorted radius of 2 / sqrt(27 |k1|), which must be off-frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPose:
    """Position of the camera above the plane, and its rotation.

    The tilts make the optical axis meet the plane further along +x, or along +y: with
    ``(tilt_x, tilt_y) = t (cos b, sin b)`` it leans by the angle t in the direction b.
    """

    height_mm: float  # on the stage's scale
    offset_x_mm: float = 0.0  # of the entrance pupil, in plane coordinates
    offset_y_mm: float = 0.0
    roll_deg: float = 0.0  # about the optical axis, from +x towards +y
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis and the plane's normal."""
        return hypot(self.tilt_x_deg, self.tilt_y_deg)

    def rotation(self) -> NDArray[np.float64]:
        """Camera axes (x, y, forward) as columns in plane axes (x, y, down), shape (3, 3)."""
        bearing_deg = degrees(atan2(self.tilt_y_deg, self.tilt_x_deg))
        return leaning_rotation(self.tilt_deg, bearing_deg, self.roll_deg)


def leaning_rotation(tilt_deg: float, bearing_deg: float, roll_deg: float) -> NDArray[np.float64]:
    """Axes of a camera that leans towards a bearing and is turned about its own axis, (3, 3)."""
    lean, about = radians(tilt_deg), _turn(radians(bearing_deg))
    inclined = np.array(
        [[cos(lean), 0.0, sin(lean)], [0.0, 1.0, 0.0], [-sin(lean), 0.0, cos(lean)]]
    )
    return np.asarray(about @ inclined @ about.T @ _turn(radians(roll_deg)))


def plane_rays(rotation: NDArray[np.float64], pupil: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rays of a camera to points of the plane at depth 1 before the origin, shape (3, 3)."""
    rays = (1 - pupil[2]) * rotation + np.outer(pupil, rotation[2])
    rays[2] = rotation[2]
    return np.asarray(rays)


def _turn(angle_rad: float) -> NDArray[np.float64]:
    c, s = cos(angle_rad), sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class PinholeCamera:
    """Sensor, focal length and distortion: the geometry that stays when the stage moves.

    The principal point is the middle of the image, ``((width - 1) / 2, (height - 1) / 2)``.
    An ideal point at a radius ``r`` from it, in units of the corner's radius, is seen at
    ``r (1 + k1 r^2)``: positive ``k1`` is pincushion, negative barrel, as in OpenCV. ValueError if
    ``k1`` is so negative that the image folds over near its corners.
    """

    width_px: int
    height_px: int
    focal_length_mm: float
    pixel_pitch_um: float
    pupil_offset_mm: float = 0.0
    k1: float = 0.0

    def __post_init__(self) -> None:
        if not self.k1 > MIN_K1:
            raise ValueError(f"k1 must be above {MIN_K1}, got {self.k1}")

    @cached_property
    def centre_px(self) -> NDArray[np.float64]:
        """Principal point (x, y)."""
        return np.array([(self.width_px - 1) / 2, (self.height_px - 1) / 2])

    @cached_property
    def corner_radius_px(self) -> float:
        """Distance of the corner pixels' centres from the principal point."""
        return float(np.hypot(*self.centre_px))

    @property
    def focal_length_px(self) -> float:
        """Focal length in pixels."""
        return self.focal_length_mm / (self.pixel_pitch_um * 1e-3)

    def distance_mm(self, height_mm: float) -> float:
        """Distance from the entrance pupil to the plane; ValueError if that is not above it."""
        distance_mm = height_mm + self.pupil_offset_mm
        if not distance_mm > 0:
            raise ValueError(f"the entrance pupil must be above the plane, got {distance_mm} mm")
        return distance_mm

    def scale_px_per_mm(self, height_mm: float) -> float:
        """Pixels per millimetre on the plane, for an upright camera at the image centre."""
        return self.focal_length_px / self.distance_mm(height_mm)

    def homography_to_px(self, pose: CameraPose) -> NDArray[np.float64]:
        """Matrix from plane points (x_mm, y_mm, 1) to ideal pixels, without distortion."""
        intrinsic = np.array(
            [
                [self.focal_length_px, 0.0, self.centre_px[0]],
                [0.0, self.focal_length_px, self.centre_px[1]],
                [0.0, 0.0, 1.0],
            ]
        )
        pupil = [pose.offset_x_mm, pose.offset_y_mm, -self.distance_mm(pose.height_mm)]
        to_camera = pose.rotation().T
        matrix = intrinsic @ np.column_stack(
            [to_camera[:, 0], to_camera[:, 1], -to_camera @ np.array(pupil)]
        )
        return np.asarray(matrix / matrix[2, 2])

    def relative_radius(self, x_px: Coordinates, y_px: Coordinates) -> NDArray[np.float64]:
        """Distance from the principal point, 1 at the image corner."""
        radius_px = np.hypot(x_px - self.centre_px[0], y_px - self.centre_px[1])
        return np.asarray(radius_px / self.corner_radius_px)

    def to_plane_mm(
        self, x_px: Coordinates, y_px: Coordinates, pose: CameraPose
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Plane coordinates (x_mm, y_mm) that are seen at the pixel coordinates."""
        if self.k1:
            x_px, y_px = self._scaled(x_px, y_px, inverse=True)
        h = np.linalg.inv(self.homography_to_px(pose))
        weight = h[2, 0] * x_px + h[2, 1] * y_px + h[2, 2] if pose.tilt_deg else h[2, 2]
        x_mm = (h[0, 0] * x_px + h[0, 1] * y_px + h[0, 2]) / weight
        y_mm = (h[1, 0] * x_px + h[1, 1] * y_px + h[1, 2]) / weight
        return x_mm, y_mm

    def to_pixel(
        self, x_mm: Coordinates, y_mm: Coordinates, pose: CameraPose
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixel coordinates (x_px, y_px) at which the plane points are seen."""
        h = self.homography_to_px(pose)
        weight = h[2, 0] * x_mm + h[2, 1] * y_mm + h[2, 2]
        x_px = (h[0, 0] * x_mm + h[0, 1] * y_mm + h[0, 2]) / weight
        y_px = (h[1, 0] * x_mm + h[1, 1] * y_mm + h[1, 2]) / weight
        return self._scaled(x_px, y_px, inverse=False) if self.k1 else (x_px, y_px)

    def _scaled(
        self, x_px: Coordinates, y_px: Coordinates, *, inverse: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        dx, dy = x_px - self.centre_px[0], y_px - self.centre_px[1]
        radius = np.hypot(dx, dy) / self.corner_radius_px + np.finfo(np.float64).tiny
        moved = undistort(radius, self.k1) if inverse else distort(radius, self.k1)
        factor = moved / radius
        return self.centre_px[0] + factor * dx, self.centre_px[1] + factor * dy


def distort(radius: Coordinates, k1: float) -> NDArray[np.float64]:
    """Radius seen for an ideal radius: ``r (1 + k1 r^2)``."""
    return radius * (1 + k1 * radius**2)


def undistort(radius: Coordinates, k1: float) -> NDArray[np.float64]:
    """Ideal radius for a seen one: the root of the cubic, in closed form.

    For barrel distortion a radius beyond the fold has no ideal one and takes that of the fold.
    Press et al., Numerical Recipes, 3rd ed. 2007, section 5.6 (trigonometric form); the hyperbolic
    form for one real root follows from the same triple-angle identity.
    """
    if k1 == 0:
        return np.array(radius, dtype=np.float64)
    unit = np.sqrt(3 * abs(k1))
    if k1 > 0:
        return np.asarray(2 / unit * np.sinh(np.arcsinh(1.5 * unit * radius) / 3))
    return np.asarray(2 / unit * np.sin(np.arcsin(np.minimum(1.5 * unit * radius, 1.0)) / 3))


PIXEL_VARIANCE_PX2 = 1.0 / 12.0
"""Variance of a unit square along either axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """The optical point spread function: a covariance in px^2, order (x, y), without the pixel.

    ``Sigma(r) = Sigma(0) (1 + corner_sigma_gain r^2)^2`` in focus, with ``r`` = 1 at the image
    corner; to this a disc is added where ``focus_distance_mm`` is not None, which refocuses at
    every height.
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

        Hecht, Optics, 5th ed. 2017, section 5.2: an aperture f/N, focused at s, blurs an object at
        d to ``(f / N) f |d - s| / (d (s - f))``.
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
    """Light on the plane, seen through a vignetting lens and with a highlight; all relative."""

    vignetting: float  # fall-off at the image corner, by the fourth power of a cosine
    gloss: float  # peak of the highlight, over white paper
    shadow: float = 0.0  # loss of light on the dark side of a soft shadow on the plane
    dimming_per_100mm: float = 0.0  # loss for every 100 mm of height: the stand shades

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


PIXEL_FORMATS = ("Mono8", "Mono12", "Mono12Packed")
"""Formats that the simulated camera delivers, unpacked as by a driver."""

ADC_MAX_DN = 4095
"""Largest level of the 12-bit converter."""

MONO8_SHIFT = 4
"""Mono8 is the upper 8 of the 12 bits, truncated and not rounded, as in GigE cameras."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """A sensor by the linear model of EMVA 1288: electrons, then noise, then digital numbers.

    EMVA Standard 1288, release 4.0 linear, 2021, section 2. All DN are at 12 bits.
    """

    white_e_per_us: float  # of a pixel on white paper, before vignetting
    gain_e_per_dn: float  # at 0 dB
    read_noise_e: float  # of the dark noise, without the rounding of the converter
    full_well_e: float  # at which a pixel is full
    black_level_dn: float  # the same at every gain

    def gain_at_e_per_dn(self, gain_db: float) -> float:
        """Electrons per 12-bit DN at a gain: 20 dB make the signal ten times larger."""
        return float(self.gain_e_per_dn / 10 ** (gain_db / 20))

    def electrons(self, irradiance: NDArray[np.float32], exposure_us: float) -> NDArray[np.float32]:
        """Expected electrons for light relative to white paper; negative light counts as 0."""
        return np.maximum(irradiance, 0) * np.float32(self.white_e_per_us * exposure_us)

    def expected_dn(
        self, irradiance: NDArray[np.float32], exposure_us: float, gain_db: float, pixel_format: str
    ) -> NDArray[np.float64]:
        """Mean level without noise and rounding, clipped as by the converter.

        In Mono8 the mean loss by truncation, 7.5 / 16, is subtracted.
        """
        electrons = np.minimum(self.electrons(irradiance, exposure_us), self.full_well_e)
        gain = self.gain_at_e_per_dn(gain_db)
        level_dn = np.minimum(self.black_level_dn + electrons.astype(np.float64) / gain, ADC_MAX_DN)
        if pixel_format == "Mono8":
            step = 2**MONO8_SHIFT
            level_dn = (level_dn - (step - 1) / 2) / step
        return np.asarray(level_dn)

    def variance_dn2(self, level_dn: float, gain_db: float) -> float:
        """Temporal variance of a 12-bit level below saturation, rounding (1/12) included."""
        gain = self.gain_at_e_per_dn(gain_db)
        return (level_dn - self.black_level_dn) / gain + (self.read_noise_e / gain) ** 2 + 1 / 12

    def expose(
        self,
        electrons: NDArray[np.float32] | NDArray[np.float64],
        gain_db: float,
        pixel_format: str,
        rng: np.random.Generator,
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """One frame in DN of the pixel format, for the expected electrons of each pixel."""
        collected = rng.poisson(electrons).astype(np.float32)
        np.minimum(collected, np.float32(self.full_well_e), out=collected)
        if self.read_noise_e > 0:
            dark = rng.standard_normal(electrons.shape, dtype=np.float32)
            dark *= np.float32(self.read_noise_e)
            collected += dark
        collected *= np.float32(1 / self.gain_at_e_per_dn(gain_db))
        collected += np.float32(self.black_level_dn)
        np.rint(collected, out=collected)
        np.clip(collected, 0, ADC_MAX_DN, out=collected)
        level_dn = collected.astype(np.uint16)
        if pixel_format == "Mono8":
            return (level_dn >> MONO8_SHIFT).astype(np.uint8)
        return level_dn


ALIAS_EXPONENT = 0.6
"""``s0^2 (1 - s0^2 / sigma^2) K^2``: folded frequencies are below exp(-2 pi^2 0.6) = 7e-6."""

PAD_SIGMAS = 5.0
TILE_PX = 64

GROWTH_NODE_ERROR = 1e-4
"""Bound on the error of the interpolation over the width of the PSF, relative to full scale."""

CORRECTION_NODE_ERROR = 1e-2
"""The same for the correction of the sampling blur, itself a few per cent at most."""

STEEPEST_VIEW_DEG = 75.0
"""Angle from the plane's normal up to which perspective is uniform enough over one pixel."""

DEPARTURE_PX2 = 0.04
"""Largest local departure of the sampling blur from its mean that is corrected for."""

FIRST_ORDER_PX2 = 0.008
"""Up to this departure a first-order correction is enough."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sampling:
    """Sampling density of the scene, and the blur that it is sampled with."""

    per_px: int
    sigma_px: float
    sigma_mm: float
    departure_px2: NDArray[np.float32] | None
    """Blur on the sensor minus ``sigma_px^2 I``: (xx, xy, yy), each (rows, cols)."""


class Renderer:
    """Renders a scene as seen by a pinhole camera with a blurring lens and square pixels.

    The optical PSF is taken as constant within the blur of one pixel.
    """

    def __init__(self, camera: PinholeCamera, lens: Lens) -> None:
        self.camera = camera
        self.lens = lens
        x_px = np.arange(camera.width_px, dtype=np.float64)[None, :]
        y_px = np.arange(camera.height_px, dtype=np.float64)[:, None]
        self._growth = lens.growth(camera.relative_radius(x_px, y_px)).astype(np.float32)

    def irradiance(self, scene: Scene, pose: CameraPose) -> NDArray[np.float32]:
        """Mean light on each pixel, shape (rows, cols); 1 is white paper.

        ValueError if the camera is tilted so far that it nearly sees the plane's horizon.
        """
        half_view_deg = degrees(atan(self.camera.corner_radius_px / self.camera.focal_length_px))
        if pose.tilt_deg + half_view_deg > STEEPEST_VIEW_DEG:
            raise ValueError(
                f"a tilt of {pose.tilt_deg:.1f} degrees is too much: the corners of the frame look "
                f"{half_view_deg:.1f} degrees further, and the limit is {STEEPEST_VIEW_DEG:g}"
            )
        distance_mm = self.camera.distance_mm(pose.height_mm)
        if isinstance(scene, SceneWithRelief):
            scene = scene.seen_from(pose.offset_x_mm, pose.offset_y_mm, distance_mm)
        defocus_px2 = self.lens.defocus_variance_px2(distance_mm)
        lens_px2 = self.lens.in_focus_covariance_px2
        smallest_px2 = float(np.linalg.eigvalsh(lens_px2)[0]) + defocus_px2
        largest_px2 = (
            float(np.linalg.eigvalsh(lens_px2)[1]) * float(self._growth.max()) + defocus_px2
        )
        sampling = self._sampling(pose, smallest_px2)
        pad = ceil(PAD_SIGMAS * sqrt(largest_px2) + 1)
        rows, cols = (
            scipy.fft.next_fast_len(n + 2 * pad, real=True)
            for n in (self.camera.height_px, self.camera.width_px)
        )
        samples = self._sample(scene, pose, sampling, (rows, cols), pad)
        spectrum = FoldedSpectrum(samples, sampling.per_px)
        window = (
            slice(pad, pad + self.camera.height_px),
            slice(pad, pad + self.camera.width_px),
        )
        remainder_px2 = (defocus_px2 - sampling.sigma_px**2) * np.eye(2)

        def over_growth(error: float, orders: tuple[int, int]) -> NDArray[np.float32]:
            nodes = _growth_nodes(float(self._growth.max()), error)
            total = np.zeros(self._growth.shape, dtype=np.float32)
            for index, growth in enumerate(nodes):
                part = spectrum.image(growth * lens_px2 + remainder_px2, orders)
                total += _lagrange(nodes, index, self._growth) * part[window]
            return total

        image = over_growth(GROWTH_NODE_ERROR, (0, 0))
        if sampling.departure_px2 is not None:
            for orders, share in _unblurring(sampling.departure_px2).items():
                image += share * over_growth(CORRECTION_NODE_ERROR, orders)
        return image

    def _sampling(self, pose: CameraPose, smallest_px2: float) -> _Sampling:
        """Choose the sampling blur, so that what is left for the Fourier domain is positive."""
        scale_px_per_mm = self.camera.scale_px_per_mm(pose.height_mm)
        if not (self.camera.k1 or pose.tilt_deg):
            blur_px2 = smallest_px2 / 2
            return _Sampling(
                per_px=_samples_per_px(blur_px2, smallest_px2),
                sigma_px=sqrt(blur_px2),
                sigma_mm=sqrt(blur_px2) / scale_px_per_mm,
                departure_px2=None,
            )
        xx, xy, yy = self._unit_blur(pose)
        unit = float(np.min([xx, yy]) + np.max([xx, yy])) / 2
        least = float(((xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)).min()) / unit
        departure = np.stack([xx / unit - 1, xy / unit, yy / unit - 1])
        blur_px2 = min(smallest_px2 / 2, DEPARTURE_PX2 / float(np.abs(departure).max()))
        return _Sampling(
            per_px=_samples_per_px(blur_px2 * least, smallest_px2),
            sigma_px=sqrt(blur_px2),
            sigma_mm=sqrt(blur_px2 / unit),
            departure_px2=(departure * blur_px2).astype(np.float32),
        )

    def _unit_blur(self, pose: CameraPose) -> NDArray[np.float64]:
        """Covariance on the sensor of a unit blur on the plane: px^2/mm^2, (3, rows, cols)."""
        x_px = np.arange(self.camera.width_px, dtype=np.float64)[None, :]
        y_px = np.arange(self.camera.height_px, dtype=np.float64)[:, None]
        right, left = (self.camera.to_plane_mm(x_px + step, y_px, pose) for step in (0.5, -0.5))
        below, above = (self.camera.to_plane_mm(x_px, y_px + step, pose) for step in (0.5, -0.5))
        # Columns of d plane / d pixel, and from them inverse(J) inverse(J)^T.
        (a, c), (b, d) = np.subtract(right, left), np.subtract(below, above)
        determinant2 = (a * d - b * c) ** 2
        return np.asarray(np.stack([b * b + d * d, -(a * b + c * d), a * a + c * c]) / determinant2)

    def _sample(
        self,
        scene: Scene,
        pose: CameraPose,
        sampling: _Sampling,
        shape: tuple[int, int],
        pad: int,
    ) -> NDArray[np.float32]:
        """Scene samples, ``per_px`` per pixel; sample 0 is at pixel ``-pad``."""
        rows, cols = shape[0] * sampling.per_px, shape[1] * sampling.per_px
        samples = np.empty((rows, cols), dtype=np.float32)
        x_px = np.arange(cols) / sampling.per_px - pad
        y_px = np.arange(rows) / sampling.per_px - pad
        tile = TILE_PX * sampling.per_px
        for top in range(0, rows, tile):
            for left in range(0, cols, tile):
                here = np.s_[top : top + tile, left : left + tile]
                x_mm, y_mm = self.camera.to_plane_mm(x_px[None, here[1]], y_px[here[0], None], pose)
                samples[here] = scene.reflectance(x_mm, y_mm, sampling.sigma_mm)
        return samples


def _unblurring(departure_px2: NDArray[np.float32]) -> dict[tuple[int, int], NDArray[np.float32]]:
    """Weights of the derivatives in the series of a deconvolution with a narrow Gaussian.

    ``exp(-D / 2)`` of ``D = xx d^2/dx^2 + 2 xy d^2/dxdy + yy d^2/dy^2``, keyed by the orders
    along x and y.
    """
    xx, xy, yy = departure_px2
    weights = {(2, 0): -xx / 2, (1, 1): -xy, (0, 2): -yy / 2}
    if np.abs(departure_px2).max() > FIRST_ORDER_PX2:
        weights |= {
            (4, 0): xx**2 / 8,
            (3, 1): xx * xy / 2,
            (2, 2): xy**2 / 2 + xx * yy / 4,
            (1, 3): xy * yy / 2,
            (0, 4): yy**2 / 8,
        }
    return weights


def _samples_per_px(blur_px2: float, smallest_px2: float) -> int:
    """Samples per pixel that keep folded frequencies below the limit of `ALIAS_EXPONENT`."""
    return ceil(sqrt(ALIAS_EXPONENT / (blur_px2 * (1 - blur_px2 / smallest_px2))))


def _growth_nodes(largest: float, error: float) -> NDArray[np.float64]:
    """Chebyshev nodes in [1, largest] for the factor on the in-focus covariance.

    A transfer ``exp(-a w)`` is interpolated in ``w`` with an error below
    ``2 (h / 2)^n (n / e)^n / n!`` for any ``a``, with ``h`` half the interval.
    """
    half = (largest - 1) / 2
    count = 1
    while half > 0 and 2 * (half / 2 * count / e) ** count / factorial(count) > error:
        count += 1
    angle = np.pi * (np.arange(count) + 0.5) / count
    return 1 + half * (1 - np.cos(angle))


def _lagrange(
    nodes: NDArray[np.float64], index: int, at: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Lagrange polynomial that is 1 at ``nodes[index]`` and 0 at the others."""
    share = np.ones_like(at)
    for other in np.delete(nodes, index):
        share *= (at - np.float32(other)) / np.float32(nodes[index] - other)
    return share
