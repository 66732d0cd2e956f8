"""Levels of photographs: noise as stated, clipping, sRGB."""

from io import BytesIO

import numpy as np
import pytest
import tifffile
from PIL import Image

from hil_mocks.benchmark_set._photographs import Condition, srgb_levels, truth_tiff


def test_a_level_varies_as_the_task_says() -> None:
    condition = Condition(name="noise", gain_e_per_dn=2.0, read_noise_e=8.0)
    levels = condition.levels(np.full((200, 200), 0.4), np.random.default_rng(1))
    mean = 64 + 0.4 * 3400
    stated = condition.facts()["noise"]
    variance = stated["variance_at_black_dn2"] + stated["variance_per_dn"] * (mean - 64)
    assert variance == pytest.approx(16 + 1 / 12 + 1360 / 2)
    assert levels.mean() == pytest.approx(mean, abs=0.6)  # 40,000 px: 0.13 DN
    assert levels.var() == pytest.approx(variance, rel=0.04)  # 0.7 %
    assert condition.variance_dn2(mean) == pytest.approx(variance)


def test_what_is_too_bright_is_the_largest_level() -> None:
    condition = Condition(name="clipped", exposure=1.4)
    levels = condition.levels(np.array([[1.2, 0.0]]), np.random.default_rng(1))
    assert levels[0, 0] == 4095
    assert condition.expected_dn(np.array([1.2, 0.0, -1.0])).tolist() == [4095, 64, 64]


def test_without_noise_a_level_is_the_rounded_expectation() -> None:
    condition = Condition(name="clean", gain_e_per_dn=None)
    assert condition.levels(np.array([[0.5001]]), np.random.default_rng(1)).tolist() == [[1764]]
    assert condition.facts()["noise"] == {"variance_at_black_dn2": 1 / 12, "variance_per_dn": 0.0}


def test_srgb_is_that_of_the_standard() -> None:
    # Black, full scale, and 18 % grey, which is 118 of 255.
    grey = round(64 + 0.18 * 4031)
    assert srgb_levels(np.array([0, 64, 4095, grey], np.uint16)).tolist() == [0, 0, 255, 118]


def test_a_jpeg_is_grey_and_8_bit_and_says_so() -> None:
    condition = Condition(name="jpeg85", gain_e_per_dn=None, jpeg_quality=85)
    stored = condition.stored(np.full((16, 16), 0.18 * 4031 / 3400), np.random.default_rng(1))
    image = Image.open(BytesIO(stored))
    assert (image.format, image.mode) == ("JPEG", "L")
    assert np.asarray(image) == pytest.approx(118, abs=1)
    assert condition.facts()["max_level"] == 255
    assert condition.suffix == ".jpg"


def test_truth_is_in_sixteenths_of_a_level_with_its_sign() -> None:
    stored = truth_tiff(np.array([[-2.0, 0.0625, 100.5]]), np.int16)
    assert tifffile.imread(BytesIO(stored)).tolist() == [[-32, 1, 1608]]
