"""What is in the picture is told from noise: on paper there is nothing to focus on."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from acquisition.focus import has_detail, shows_nothing, texture_share

SHAPE = (96, 128)
LEVEL_DN = 1000.0


def noise(seed: int, size_dn: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.random.default_rng(seed).normal(0, size_dn, SHAPE)


@pytest.mark.parametrize("size_dn", [0.0, 0.2, 3.0, 60.0])
def test_noise_alone_is_no_detail(size_dn: float) -> None:
    # Five standard deviations, twice: once in a million.
    assert not any(
        has_detail(np.rint(LEVEL_DN + noise(seed, size_dn)).astype(np.uint16))
        for seed in range(100)
    )


def test_light_that_falls_off_is_no_detail() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    light = LEVEL_DN * (1 - 0.5 * ((y / SHAPE[0]) ** 2 + (x / SHAPE[1]) ** 2))
    assert not has_detail(np.rint(light + noise(1, 2.0)))
    assert not has_detail(np.rint(light))


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("sigma_px", [0.5, 2.0, 5.0])
def test_an_edge_is_detail_whichever_way_it_runs(sigma_px: float, turned: bool) -> None:
    image = LEVEL_DN * (1 + 0.5 * ndtr((np.arange(SHAPE[1]) - 60.3) / sigma_px)) + noise(2, 20.0)
    assert has_detail(image.T if turned else image)


def test_texture_fainter_than_the_noise_is_detail() -> None:
    smooth = gaussian_filter(noise(3, 1.0), 2.0)
    assert has_detail(LEVEL_DN + noise(4, 10.0) + 8.0 * smooth / smooth.std())


def test_too_small_a_picture_has_none() -> None:
    assert not has_detail(np.eye(15))


@pytest.mark.parametrize("gains", [(1.0, 1.0), (0.5, 0.8)])
def test_plain_paper_under_a_colour_camera_shows_nothing_and_an_edge_something(
    gains: tuple[float, float],
) -> None:
    mosaic = np.ones((1200, 1600))
    mosaic[::2, 1::2], mosaic[1::2, ::2] = gains
    rng = np.random.default_rng(8)
    paper = LEVEL_DN * mosaic + rng.normal(0, 5.0, mosaic.shape)
    edge = LEVEL_DN * mosaic * (1 + 0.5 * ndtr((np.arange(1600) - 805.0) / 20.0))
    assert shows_nothing(np.rint(paper).astype(np.uint16))
    assert not shows_nothing(np.rint(edge + rng.normal(0, 5.0, edge.shape)).astype(np.uint16))


def test_a_region_too_small_to_tell_is_not_said_to_show_nothing() -> None:
    assert not shows_nothing(np.full((31, 200), 100, np.uint16))


@pytest.mark.parametrize("sigma_px", [5.0, 10.0, 20.0])
def test_an_edge_far_out_of_focus_is_something_to_focus_on(sigma_px: float) -> None:
    profile = LEVEL_DN * (1 + 0.5 * ndtr((np.arange(780) - 405.3) / sigma_px))
    image_dn = profile + np.random.default_rng(9).normal(0, 5.0, (580, 780))
    assert not shows_nothing(np.rint(image_dn).astype(np.uint16))


@pytest.mark.slow
def test_a_dull_highlight_on_paper_is_nothing_to_focus_on() -> None:
    y, x = np.mgrid[:580, :780]
    highlight = 0.2 * np.exp(-0.5 * ((x - 300.0) ** 2 + (y - 250.0) ** 2) / 150.0**2)
    for seed in range(20):
        noise_dn = np.random.default_rng(seed).normal(0, 10.0, x.shape)
        assert shows_nothing(np.rint(2500 * (1 + highlight) + noise_dn).astype(np.uint16))


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
