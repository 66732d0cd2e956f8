import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.edges import gaussian_mtf50, pixel_mtf50
from tests.calibration.closed_form import pixel_edge


def test_the_mtf50_of_a_gaussian_by_hand() -> None:
    # exp(-2 pi^2 f^2) = 1/2 at f = sqrt(ln 2 / 2) / pi.
    assert gaussian_mtf50(1.0) == pytest.approx(0.187390625, rel=1e-8)
    assert gaussian_mtf50(0.5) == pytest.approx(2 * 0.187390625, rel=1e-8)


@pytest.mark.parametrize(
    ("normal_deg", "frequency"),
    [
        (0.0, 0.603354564),  # sinc(f) = 1/2
        (45.0, 0.626420906),  # sinc(f / sqrt 2)^2 = 1/2
        (90.0, 0.603354564),
    ],
)
def test_a_perfect_lens_leaves_the_pixel_square(normal_deg: float, frequency: float) -> None:
    assert pixel_mtf50(1e-9, np.deg2rad(normal_deg)) == pytest.approx(frequency, rel=1e-6)


@pytest.mark.parametrize("normal_deg", [0.0, 12.0, 45.0])
@pytest.mark.parametrize("sigma_px", [0.3, 0.6, 1.2])
def test_half_the_contrast_of_the_exact_edge_is_left(sigma_px: float, normal_deg: float) -> None:
    normal = float(np.deg2rad(normal_deg))
    frequency = pixel_mtf50(sigma_px, normal)
    # The transfer is the Fourier transform of the line spread function, the edge's derivative.
    distance = np.arange(-12.0, 12.0, 0.01)
    line = np.diff(pixel_edge(distance, sigma_px, normal))
    transfer = np.sum(line * np.cos(2 * np.pi * frequency * (distance[:-1] + 0.005)))
    assert transfer == pytest.approx(0.5, abs=2e-4)  # steps of 0.01 px


def test_a_wide_psf_hides_the_shape_of_the_pixel() -> None:
    total = np.sqrt(3.0**2 + 1 / 12)
    assert pixel_mtf50(3.0, 0.4) == pytest.approx(gaussian_mtf50(float(total)), rel=1e-4)


@given(sigma=st.floats(0.05, 5.0), turn=st.floats(-7.0, 7.0))
def test_mirrored_and_turned_edges_have_the_same_mtf50(sigma: float, turn: float) -> None:
    frequency = pixel_mtf50(sigma, turn)
    assert pixel_mtf50(sigma, -turn) == pytest.approx(frequency)
    assert pixel_mtf50(sigma, turn + np.pi / 2) == pytest.approx(frequency)


@given(sigma=st.floats(0.05, 5.0), factor=st.floats(1.001, 3.0), turn=st.floats(0.0, 3.2))
def test_a_wider_psf_has_a_lower_mtf50(sigma: float, factor: float, turn: float) -> None:
    assert pixel_mtf50(sigma * factor, turn) < pixel_mtf50(sigma, turn)
    assert gaussian_mtf50(sigma * factor) < gaussian_mtf50(sigma)
