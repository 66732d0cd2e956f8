"""The renderer against closed forms; it must be more exact than anything that it judges."""

from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from hil_mocks.truth.render import CameraPose, Lens, PinholeCamera, Renderer
from hil_mocks.truth.scenes import Coordinates, Edge, Placed, Rectangle, Uniform, ZonePlate

WIDTH, HEIGHT = 96, 64
STEP = Edge(low=0.0, high=1.0)


def renderer(
    sigma_x_px: float = 0.55,
    sigma_y_px: float = 0.55,
    rho: float = 0.0,
    gain: float = 0.0,
    k1: float = 0.0,
    shape: tuple[int, int] = (HEIGHT, WIDTH),
    focus_distance_mm: float | None = None,
) -> Renderer:
    return Renderer(
        PinholeCamera(
            width_px=shape[1], height_px=shape[0], focal_length_mm=8.0, pixel_pitch_um=8.3, k1=k1
        ),
        Lens(
            sigma_x_px=sigma_x_px,
            sigma_y_px=sigma_y_px,
            rho=rho,
            corner_sigma_gain=gain,
            focal_length_mm=8.0,
            f_number=4.0,
            pixel_pitch_um=8.3,
            focus_distance_mm=focus_distance_mm,
        ),
    )


def pixel_square_of_a_step(
    distance_px: NDArray[np.float64],
    normal_x: NDArray[np.float64] | float,
    normal_y: NDArray[np.float64] | float,
    sigma_px: NDArray[np.float64] | float,
) -> NDArray[np.float64]:
    """Mean over the pixel square of Phi(distance / sigma), by Gauss-Legendre quadrature.

    20 nodes a side integrate a step of sigma 0.2 px to better than 1e-8.
    """
    nodes, weights = np.polynomial.legendre.leggauss(20)
    total = np.zeros_like(distance_px)
    for (u, wu), (v, wv) in product(zip(nodes, weights, strict=True), repeat=2):
        offset_px = (u * normal_x + v * normal_y) / 2
        total += wu * wv / 4 * ndtr((distance_px + offset_px) / sigma_px)
    return np.asarray(total)


@dataclass(frozen=True)
class Wave:
    """A sinusoid, of which every blur is known."""

    freq_x_cy_per_mm: float
    freq_y_cy_per_mm: float

    def phase(self, x_mm: Coordinates, y_mm: Coordinates) -> NDArray[np.float64]:
        cycles = self.freq_x_cy_per_mm * x_mm + self.freq_y_cy_per_mm * y_mm
        return np.asarray(2 * np.pi * cycles + 0.7)

    def reflectance(
        self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float
    ) -> NDArray[np.float64]:
        freq2 = self.freq_x_cy_per_mm**2 + self.freq_y_cy_per_mm**2
        left = np.exp(-2 * np.pi**2 * sigma_mm**2 * freq2)
        return np.asarray(0.5 + 0.5 * left * np.cos(self.phase(x_mm, y_mm)))


@pytest.mark.parametrize("angle_deg", [0.0, 5.0, 33.0, 45.0, 90.0, 120.0, 178.0])
@pytest.mark.parametrize(
    ("sigma_x_px", "sigma_y_px", "rho"),
    [(0.55, 0.55, 0.0), (0.2, 0.25, 0.0), (0.8, 0.45, 0.6), (2.0, 1.2, -0.3), (3.0, 2.0, 0.2)],
)
def test_an_edge_is_the_gaussian_step_integrated_over_the_pixel_square(
    angle_deg: float, sigma_x_px: float, sigma_y_px: float, rho: float
) -> None:
    camera_and_lens = renderer(sigma_x_px, sigma_y_px, rho)
    pose = CameraPose(height_mm=200.0, offset_x_mm=0.07, offset_y_mm=-0.04)
    image = camera_and_lens.irradiance(Placed(scene=STEP, angle_deg=angle_deg), pose)
    normal = np.array([-np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))])
    row, col = np.mgrid[:HEIGHT, :WIDTH]
    scale = camera_and_lens.camera.scale_px_per_mm(200.0)
    distance_px = (col - 47.5 + 0.07 * scale) * normal[0] + (row - 31.5 - 0.04 * scale) * normal[1]
    sigma_px = float(np.sqrt(normal @ camera_and_lens.lens.covariance_px2(200.0) @ normal))
    near = np.abs(distance_px) < 6 * sigma_px + 1
    expected = pixel_square_of_a_step(distance_px[near], normal[0], normal[1], sigma_px)
    # Measured 1.4e-6, of float32.
    np.testing.assert_allclose(image[near], expected, atol=5e-6)
    np.testing.assert_allclose(image[~near], distance_px[~near] > 0, atol=5e-6)


@pytest.mark.parametrize("height_mm", [200.0, 437.0])
@pytest.mark.parametrize(
    ("fx", "fy"), [(0.05, 0.02), (0.3, 0.0), (0.0, 0.5), (0.41, -0.36), (0.8, 0.3)]
)
def test_a_wave_has_the_amplitude_of_lens_and_pixel_even_beyond_nyquist(
    fx: float, fy: float, height_mm: float
) -> None:
    camera_and_lens = renderer(0.6, 0.4, 0.3)
    scale = camera_and_lens.camera.scale_px_per_mm(height_mm)
    image = camera_and_lens.irradiance(
        Wave(fx * scale, fy * scale), CameraPose(height_mm=height_mm)
    )
    row, col = np.mgrid[:HEIGHT, :WIDTH]
    freq = np.array([fx, fy])
    transfer = np.exp(-2 * np.pi**2 * freq @ camera_and_lens.lens.covariance_px2(height_mm) @ freq)
    transfer *= np.sinc(fx) * np.sinc(fy)
    phase = 2 * np.pi * (fx * (col - 47.5) + fy * (row - 31.5)) + 0.7
    np.testing.assert_allclose(image, 0.5 + 0.5 * transfer * np.cos(phase), atol=1e-5)


def test_a_wave_loses_amplitude_to_the_corner_as_the_lens_does() -> None:
    camera_and_lens = renderer(0.55, 0.55, gain=0.4)
    scale = camera_and_lens.camera.scale_px_per_mm(200.0)
    image = camera_and_lens.irradiance(Wave(0.3 * scale, 0.1 * scale), CameraPose(height_mm=200.0))
    row, col = np.mgrid[:HEIGHT, :WIDTH]
    radius2 = ((col - 47.5) ** 2 + (row - 31.5) ** 2) / (47.5**2 + 31.5**2)
    sigma2_px2 = (0.55 * (1 + 0.4 * radius2)) ** 2
    transfer = np.exp(-2 * np.pi**2 * sigma2_px2 * 0.1) * np.sinc(0.3) * np.sinc(0.1)
    phase = 2 * np.pi * (0.3 * (col - 47.5) + 0.1 * (row - 31.5)) + 0.7
    # 3e-5: the interpolation between widths.
    np.testing.assert_allclose(image, 0.5 + 0.5 * transfer * np.cos(phase), atol=3e-5)


@pytest.mark.slow
@pytest.mark.parametrize("angle_deg", [10.0, 80.0, 135.0])
@pytest.mark.parametrize(
    ("tilt_deg", "k1"), [(0.0, -0.03), (0.0, 0.03), (15.0, 0.0), (25.0, -0.02), (45.0, 0.0)]
)
def test_perspective_and_distortion_do_not_touch_the_blur_on_the_sensor(
    tilt_deg: float, k1: float, angle_deg: float
) -> None:
    camera_and_lens = renderer(0.6, 0.5, 0.2, k1=k1, shape=(200, 260))
    look_back_mm = -100.0 * np.tan(np.radians(tilt_deg))
    pose = CameraPose(height_mm=100.0, offset_x_mm=look_back_mm, tilt_x_deg=tilt_deg, roll_deg=3.0)
    scene = Placed(scene=STEP, angle_deg=angle_deg)
    image = camera_and_lens.irradiance(scene, pose)
    normal_mm = np.array([-np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))])

    def distance_mm(x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        x_mm, y_mm = camera_and_lens.camera.to_plane_mm(x_px, y_px, pose)
        return np.asarray(normal_mm[0] * x_mm + normal_mm[1] * y_mm)

    row, col = np.mgrid[:200, :260].astype(np.float64)
    slope_x = (distance_mm(col + 0.01, row) - distance_mm(col - 0.01, row)) / 0.02
    slope_y = (distance_mm(col, row + 0.01) - distance_mm(col, row - 0.01)) / 0.02
    slope = np.hypot(slope_x, slope_y)
    normal_x, normal_y = slope_x / slope, slope_y / slope
    # Second order in the distance: the scale changes between the pixel and the edge.
    distance_px = distance_mm(col, row) / slope
    here = np.abs(distance_px) < 2.5
    foot_x, foot_y = col - distance_px * normal_x, row - distance_px * normal_y
    distance_px += distance_mm(foot_x, foot_y) / slope
    covariance = camera_and_lens.lens.covariance_px2(100.0)
    sigma_px = np.sqrt(
        covariance[0, 0] * normal_x**2
        + 2 * covariance[0, 1] * normal_x * normal_y
        + covariance[1, 1] * normal_y**2
    )
    expected = pixel_square_of_a_step(
        distance_px[here], normal_x[here], normal_y[here], sigma_px[here]
    )
    assert here.sum() > 500
    # The change of scale within the blur itself is second order too.
    np.testing.assert_allclose(image[here], expected, atol=7e-5)  # measured 5.5e-5


def test_a_camera_that_nearly_sees_the_horizon_is_refused() -> None:
    with pytest.raises(ValueError):
        renderer().irradiance(STEP, CameraPose(height_mm=200.0, tilt_x_deg=80.0))


def test_defocus_widens_an_edge_by_the_variance_of_its_disc() -> None:
    blurred = renderer(focus_distance_mm=260.0)
    variance_px2 = 0.55**2 + blurred.lens.defocus_variance_px2(200.0)
    sharp_lens = renderer(np.sqrt(variance_px2), np.sqrt(variance_px2))
    scene, pose = Placed(scene=STEP, angle_deg=20.0), CameraPose(height_mm=200.0)
    np.testing.assert_allclose(
        blurred.irradiance(scene, pose), sharp_lens.irradiance(scene, pose), atol=5e-6
    )
    assert variance_px2 > 2 * 0.55**2


def test_a_flat_scene_stays_flat_whatever_the_optics() -> None:
    camera_and_lens = renderer(0.7, 0.5, 0.3, gain=0.3, k1=-0.03)
    image = camera_and_lens.irradiance(
        Uniform(level=0.7), CameraPose(height_mm=200.0, tilt_x_deg=10.0)
    )
    np.testing.assert_allclose(image, 0.7, atol=2e-6)


def test_rows_run_down_and_columns_to_the_right() -> None:
    # A small square right of and above the axis: (x, y) = (6, -3) mm.
    scene = Placed(scene=Rectangle(width_mm=1.0, height_mm=1.0, contrast=1.0), x_mm=6.0, y_mm=-3.0)
    camera_and_lens = renderer()
    image = camera_and_lens.irradiance(scene, CameraPose(height_mm=200.0))
    scale = camera_and_lens.camera.scale_px_per_mm(200.0)
    total = float(image.sum())
    row, col = np.mgrid[:HEIGHT, :WIDTH]
    assert (image * col).sum() / total == pytest.approx(47.5 + 6 * scale, abs=1e-3)
    assert (image * row).sum() / total == pytest.approx(31.5 - 3 * scale, abs=1e-3)
    assert total == pytest.approx(scale**2, rel=1e-5)  # the light of one square millimetre


def test_a_target_seen_from_twice_the_distance_is_sampled_half_as_densely() -> None:
    # A wide blob is rendered without any loss: near pixel c + 2 k is far pixel c + k.
    scene = ZonePlate(amplitude=1.0, window_mm=5.0, freq_cy_per_mm=0.02)
    camera_and_lens = renderer(0.3, 0.3, shape=(65, 97))
    near = camera_and_lens.irradiance(scene, CameraPose(height_mm=200.0))
    far = camera_and_lens.irradiance(scene, CameraPose(height_mm=400.0))
    # The far blur is 2 px of the near picture, of a blob of 24 px: 2 % in the square.
    np.testing.assert_allclose(near[::2, ::2], far[16:49, 24:73], atol=0.01)


def test_the_border_sees_the_scene_beyond_it_and_not_the_other_side() -> None:
    scene = Placed(scene=STEP, angle_deg=90.0)
    small, large = renderer(1.5, 1.5), renderer(1.5, 1.5, shape=(HEIGHT + 40, WIDTH + 40))
    pose = CameraPose(height_mm=200.0)
    np.testing.assert_allclose(
        small.irradiance(scene, pose), large.irradiance(scene, pose)[20:-20, 20:-20], atol=5e-6
    )
