"""What is in the picture is told from noise: on paper there is nothing to focus on."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from acquisition.focus import has_detail

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
