"""Photographs as cosines of their blocks: Parseval's theorem, and pixels that do not count."""

import numpy as np
import pytest

from calibration.blind._cosine_blocks import UsedBlocks


def test_cosines_of_whole_blocks_keep_their_power() -> None:
    rng = np.random.default_rng(5)
    used = np.ones((24, 32), dtype=np.bool_)
    used[3, 5] = False  # one block is not whole
    image = rng.normal(size=used.shape)
    blocks = UsedBlocks(used, 1.0)
    assert blocks.count == 11
    power = float(np.sum(image**2) - np.sum(image[:8, :8] ** 2))
    assert np.sum(blocks.cosines(image) ** 2) == pytest.approx(power)


def test_what_is_not_used_of_a_block_counts_as_nothing() -> None:
    rng = np.random.default_rng(6)
    used = rng.random((24, 32)) < 0.7
    used[:8, :8] = False
    image = rng.normal(size=used.shape)
    blocks = UsedBlocks(used, 0.3)
    assert blocks.count == 11
    spoilt = np.where(used, image, 1e6)
    np.testing.assert_array_equal(blocks.cosines(image), blocks.cosines(spoilt))
    power = float(np.sum(image[used] ** 2))
    assert np.sum(blocks.cosines(image) ** 2) == pytest.approx(power)
