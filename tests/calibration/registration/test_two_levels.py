"""Drawings in two levels and pages scanned to white are aligned by what they show."""

import numpy as np
import pytest

from calibration.registration import AlignedPhotograph, register
from simulation.arrays import FloatArray


def drawing(shape: tuple[int, int], seed: int = 1) -> FloatArray:
    """Black bars and squares on white, at whole pixels."""
    rng = np.random.default_rng(seed)
    made = np.full(shape, 255.0)
    for _ in range(70):
        row, col = (int(rng.integers(0, n - 8)) for n in shape)
        high, wide = (int(n) for n in rng.integers(4, 40, 2))
        made[row : row + high, col : col + wide] = 0.0
    return made


@pytest.mark.parametrize("shift", [(0, 0), (5, 3)])
def test_a_drawing_in_two_levels_is_aligned(shift: tuple[int, int]) -> None:
    down, right = shift
    whole = drawing((330, 420))
    followup = whole[down : down + 300, right : right + 400].copy()
    followup[100:112, 200:215] = 255.0 - followup[100:112, 200:215]
    found = register(whole[:300, :400], followup)
    y, x = np.mgrid[20:280:40, 20:380:40].astype(np.float64)
    at_y, at_x = found.pose.to_reference_px(y, x)
    away_px = np.hypot(at_y - y - down, at_x - x - right)
    assert away_px.max() < 0.1


def test_clipped_paper_is_left_out_as_long_as_enough_else_is_there() -> None:
    scene = np.clip(120 + 60 * np.random.default_rng(2).normal(size=(90, 120)), 0, 254)
    scene[:40] = 255.0
    photograph = AlignedPhotograph.of(scene)
    assert photograph.usable is not None
    assert not photograph.usable[:38].any()
    scene[:80] = 255.0
    assert AlignedPhotograph.of(scene).usable is None
