"""Clipped pixels of photographs whose light is known."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from analysis.changes.photograph_pair import clipped_at_white, unusable
from simulation.arrays import FloatArray

SHAPE = (120, 160)


def light(seed: int = 0, noise_dn: float = 1.2) -> FloatArray:
    """A ramp from 20 to 235 with noise."""
    rng = np.random.default_rng(seed)
    ramp = np.broadcast_to(np.linspace(20, 235, SHAPE[1]), SHAPE)
    return np.asarray(ramp + noise_dn * rng.standard_normal(SHAPE))


def with_gloss(levels: FloatArray) -> FloatArray:
    bright = levels.copy()
    bright[40:60, 30:50] += 400.0
    return bright


@pytest.mark.parametrize(
    ("white", "scale", "step"),
    [(255.0, 1.0, 1.0), (4095.0, 16.0, 1.0), (65520.0, 256.0, 16.0), (65535.0, 257.0, 1.0)],
    ids=["8 bits", "12 bits", "12 bits in 16", "16 bits"],
)
@pytest.mark.parametrize("is_told", [True, False])
def test_what_is_clipped_is_marked_and_nothing_else(
    white: float, scale: float, step: float, is_told: bool
) -> None:
    stored = np.clip(np.rint(with_gloss(light()) * scale / step) * step, 0, white)
    marked = unusable(stored, white if is_told else None)
    assert np.array_equal(marked, stored == white)
    assert marked[40:60, 30:50].all()


def test_a_plateau_below_white_and_of_floats_is_found() -> None:
    levels = np.minimum(with_gloss(light()), 250.25)
    assert np.array_equal(unusable(levels, 255.0), levels == 250.25)


def test_levels_that_thin_out_are_no_plateau() -> None:
    for step in (1.0, 0.25):
        assert not unusable(np.rint(light() / step) * step, 255.0).any()
    bars = np.rint(
        np.where(np.arange(SHAPE[1]) // 20 % 2, 60.0, 180.0) + 0.4 * (light() - light(1))
    )
    assert not unusable(bars, 255.0).any()


def test_single_pixels_at_white_are_left_to_the_noise() -> None:
    levels = np.rint(light())
    levels[7, 9] = 255.0
    assert not unusable(levels, 255.0).any()


@pytest.mark.parametrize("white", [1.0, 255.0, 4095.0])
def test_a_few_pixels_at_an_end_of_the_file_count_where_they_lie_together(white: float) -> None:
    # Two of 19,200 pixels are no plateau; a blob of four is clipped light all the same.
    levels = np.rint(light(noise_dn=0.4))
    levels[60:62, 70:72], levels[30, 20:22] = 255.0, 255.0
    levels[90:92, 70:72], levels[15, 120] = 0.0, 0.0
    marked = unusable(levels * (white / 255.0), None)
    expected = np.zeros_like(marked)
    expected[60:62, 70:72] = expected[90:92, 70:72] = True
    assert np.array_equal(marked, expected)
    within = np.clip(levels, 1.0, 254.0) * (white / 255.0)  # ends that no file has
    assert not unusable(within, None).any()


def test_black_counts_where_it_is_the_rule() -> None:
    levels = np.clip(np.rint(light() - 60.0), 0, None)
    marked = unusable(levels, None)
    assert marked[:, :20].all()  # light of -40 to -13
    assert not marked[:, 40:].any()
    assert not clipped_at_white(levels, None).any()
    grains = np.rint(light()) + 0.0
    grains[::6, ::6] = 0.0
    assert not unusable(grains, None).any()


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 20), st.integers(1, 20)),
    levels=st.integers(1, 300),
    white=st.none() | st.floats(-10, 300),
)
@settings(max_examples=60, deadline=None)
def test_any_photograph_has_a_mask_that_turns_with_it(
    seed: int, shape: tuple[int, int], levels: int, white: float | None
) -> None:
    image = np.random.default_rng(seed).integers(0, levels, shape).astype(np.float64)
    marked = unusable(image, white)
    assert marked.shape == shape
    assert np.array_equal(unusable(image[::-1].T, white), marked[::-1].T)
