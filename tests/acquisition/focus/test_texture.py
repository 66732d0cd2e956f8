import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from acquisition.focus import texture_share


def slanted_edge(
    angle_deg: float, sigma_px: float, shape: tuple[int, int] = (200, 260)
) -> np.ndarray:
    """An edge through the middle, its profile a Gaussian's."""
    y, x = np.indices(shape) - (np.array(shape).reshape(2, 1, 1) - 1) / 2
    angle = np.deg2rad(angle_deg)
    away = x * np.cos(angle) + y * np.sin(angle)
    return np.asarray(100.0 + 1000.0 * ndtr(away / sigma_px))


@pytest.mark.parametrize("angle_deg", [0.0, 5.0, 45.0, 88.0, 133.0])
@pytest.mark.parametrize("sigma_px", [0.6, 4.0])
def test_an_edge_across_the_picture_is_no_texture(angle_deg: float, sigma_px: float) -> None:
    # Its own pattern, that of the pixels, is not of the target.
    rng = np.random.default_rng(1)
    image_dn = slanted_edge(angle_deg, sigma_px)
    image_dn *= 1 + rng.normal(0, 0.005, image_dn.shape)
    assert texture_share(image_dn) < 0.03


def test_an_edge_that_ends_in_the_picture_changes_with_its_scale() -> None:
    image_dn = slanted_edge(5.0, 0.8)
    image_dn[:90] = 100.0
    assert texture_share(image_dn) == 1.0


def test_a_texture_is_one() -> None:
    rng = np.random.default_rng(2)
    assert texture_share(gaussian_filter(rng.normal(0, 1e3, (200, 260)), 1.0)) > 0.9
    assert texture_share(np.full((200, 260), 7)) == 1.0
    assert texture_share(rng.normal(0, 1, (20, 20))) == 1.0


def test_as_much_of_a_texture_beside_an_edge_is_found() -> None:
    rng = np.random.default_rng(3)
    drawn = gaussian_filter(rng.normal(0, 1, (200, 260)), 1.0)
    edge = slanted_edge(5.0, 1.0)
    shares = [texture_share(edge + level * drawn / drawn.std()) for level in (0.0, 5.0, 20.0)]
    assert shares[0] < 0.01 < shares[1] < shares[2]
