"""The variance that the steps of a file add, against files that were written both ways."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

import standoff
from acquisition.photographs import photograph_of, read_image
from acquisition.photographs.encoding import REC601_LUMA

SHAPE = (128, 160, 3)


def scene() -> np.ndarray:
    """Smooth colours with a little noise, in levels of 8 bits before they are rounded."""
    rng = np.random.default_rng(20)
    colours = gaussian_filter(rng.normal(size=SHAPE), (9, 9, 0)) * 400
    colours += gaussian_filter(rng.normal(size=SHAPE[:2]), 9)[..., np.newaxis] * 800 + 120
    return np.clip(colours + rng.normal(size=SHAPE), 5, 250)


def test_of_a_linear_colour_file_it_is_a_twelfth_of_each_channel_s_share(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.rint(scene()).astype(np.uint8))
    found = read_image(path, standoff.reading(encoding="linear")).file_steps.variance_dn2
    assert found is not None
    assert found.shape == SHAPE[:2]
    assert found == pytest.approx(np.square(REC601_LUMA).sum() / 12, rel=1e-6)


def test_of_an_srgb_file_it_is_what_rounding_did(tmp_path: Path) -> None:
    exact, path = scene(), tmp_path / "a.png"
    cv2.imwrite(str(path), np.rint(exact).astype(np.uint8)[..., ::-1])
    photograph = read_image(path, standoff.reading(encoding="srgb"))
    code = exact / 255
    light = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4) * 255
    errors = photograph.grey_dn - light @ np.asarray(REC601_LUMA)
    found = photograph.file_steps.variance_dn2
    assert found is not None
    # Of 20 480 independent errors the mean square is within 3 %, at three standard errors.
    assert float(np.mean(found)) == pytest.approx(float(np.mean(errors**2)), rel=0.05)


@pytest.mark.parametrize("quality", [75, 90, 98])
def test_a_jpeg_file_s_error_is_within_it_once_smoothed(tmp_path: Path, quality: int) -> None:
    plain, path = np.rint(scene()).astype(np.uint8), tmp_path / "a.jpg"
    cv2.imwrite(
        str(path),
        plain,
        [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x111111],
    )
    photograph = read_image(path, standoff.reading(encoding="linear"))
    luma = np.asarray(REC601_LUMA)
    error = gaussian_filter(photograph.grey_dn - plain[..., ::-1] @ luma, 1.0)
    found = photograph.file_steps.variance_dn2
    assert found is not None
    gain = 1 / (4 * np.pi)  # of white noise by a Gaussian of 1 px
    assert float(np.mean(error**2)) <= 1.2 * gain * float(np.mean(found))


def test_floating_point_levels_have_none() -> None:
    assert photograph_of(scene().astype(np.float32), "a").file_steps.variance_dn2 is None


@pytest.mark.parametrize("quality", [75, 90, 98])
@pytest.mark.parametrize("sampling", [0, 1, 2])
def test_a_channel_s_error_is_within_what_luma_and_chroma_lose(
    tmp_path: Path, quality: int, sampling: int
) -> None:
    plain, path = np.rint(scene()).astype(np.uint8), tmp_path / "a.jpg"
    Image.fromarray(plain).save(path, quality=quality, subsampling=sampling)
    photograph = read_image(path, standoff.reading(encoding="linear"))
    found, luma = photograph.file_steps.channel_variance_dn2, photograph.file_steps.variance_dn2
    assert found is not None
    assert luma is not None
    error = gaussian_filter(photograph.stored - plain.astype(np.float64), (1.0, 1.0, 0.0))
    gain = 1 / (4 * np.pi)  # of white noise by a Gaussian of 1 px
    for channel in range(3):
        # Chroma of half the columns loses the finest noise of the scene as well: 1.26 at most.
        assert np.mean(error[..., channel] ** 2) <= 1.3 * gain * found[..., channel].mean()
    assert found[..., 2].mean() > luma.mean()


def test_a_png_has_the_steps_of_each_channel(tmp_path: Path) -> None:
    levels = np.random.default_rng(6).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    Image.fromarray(levels).save(tmp_path / "a.png")
    photograph = read_image(tmp_path / "a.png", standoff.reading(encoding="linear"))
    found = photograph.file_steps
    assert found.channel_variance_dn2 is not None
    assert np.allclose(found.channel_variance_dn2, 1 / 12)
    assert read_image(tmp_path / "a.png").file_steps.channel_step_dn is not None
    assert photograph_of(levels[..., 0], "a").file_steps.channel_step_dn is None
