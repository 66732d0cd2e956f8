"""Parallax surface by surface: what is displaced by whole pixels wins, what is not stays.

A plate is a part of a photograph that lies elsewhere in the other one, and noise is of each alone.
"""

from dataclasses import replace

import numpy as np
import pytest

from calibration.parallax._decision import HeldOutGain
from calibration.parallax._matching import MatchedViews, match_views
from calibration.parallax._views import AlignedViews
from simulation.arrays import Float32Array, FloatArray

FRAME = (120, 160)
PLATE, PLATE_PX = np.s_[40:72, 60:100], 5
"""A fifteenth of the frame, and how far it lies to the right in the source."""

WRONG, WRONG_PX = np.s_[80:112, 20:60], 3


def details(seed: int) -> FloatArray:
    """Standard deviation 1, smoothed as lenses do."""
    white = np.random.default_rng(seed).normal(0, 1, FRAME)
    near = sum(np.roll(white, (j, i), (0, 1)) for j in (-1, 0, 1) for i in (-1, 0, 1))
    return np.asarray(near / 3)


def views_of(target: FloatArray, source: FloatArray) -> AlignedViews:
    """Two images that show something everywhere; lines go to the right."""
    whole = np.ones(FRAME, dtype=np.bool_)
    return AlignedViews(
        target=target.astype(np.float32),
        source=source.astype(np.float32),
        is_target=whole,
        is_source=whole,
        to_x=np.ones(FRAME, dtype=np.float32),
        to_y=np.zeros(FRAME, dtype=np.float32),
    )


def table(noise: float, seed: int, *, plate: bool = True) -> AlignedViews:
    """A ground, with or without a plate on it, and noise of that standard deviation."""
    target = details(seed)
    source = target.copy()
    if plate:
        on = details(seed + 1000)[PLATE]
        rows, cols = PLATE
        target[PLATE] = on
        source[rows, cols.start + PLATE_PX : cols.stop + PLATE_PX] = on
    rng = np.random.default_rng(seed + 2000)
    return views_of(*(one + rng.normal(0, noise, FRAME) for one in (target, source)))


def held_out(views: AlignedViews) -> tuple[HeldOutGain, MatchedViews]:
    matched = match_views(views, -10, 10)
    return HeldOutGain.of(views, matched, 1), matched


@pytest.mark.parametrize("seed", range(5))
def test_a_plate_wins_that_is_a_fifteenth_of_the_frame(seed: int) -> None:
    found, _ = held_out(table(0.5, seed))
    assert found.has_depth
    assert found.may_have_depth
    assert found.loses[found.surfaces[50:62, 70:90]].mean() < 0.1


def test_it_wins_where_it_explains_less_than_a_twentieth_of_what_is_left_in_the_frame() -> None:
    """Noise of the same size as details: over the whole frame, that is what is left."""
    found, _ = held_out(table(1.0, 3))
    assert found.gain < 0.05
    assert found.has_depth


@pytest.mark.parametrize("noise", [0.0, 0.3, 1.0, 3.0])
def test_a_ground_alone_has_no_depth(noise: float) -> None:
    assert not any(held_out(table(noise, seed, plate=False))[0].has_depth for seed in range(10))


def test_noise_alone_has_no_depth() -> None:
    for seed in range(10):
        found, _ = held_out(views_of(details(seed), details(seed + 500)))
        assert not found.has_depth


def test_what_the_plane_explains_as_well_is_put_on_it_and_the_plate_stays() -> None:
    views = table(0.3, 1)
    parallax = np.zeros(FRAME, dtype=np.float32)
    parallax[PLATE], parallax[WRONG] = PLATE_PX, WRONG_PX
    matched = matched_as(parallax)
    found = HeldOutGain.of(views, matched, 1)
    kept = found.kept(matched, views)
    expected = parallax.copy()
    expected[WRONG] = 0
    np.testing.assert_array_equal(kept.target, expected)
    np.testing.assert_array_equal(kept.source, source_of(expected))


def test_where_no_surface_loses_nothing_is_changed() -> None:
    views = table(0.3, 1)
    parallax = np.zeros(FRAME, dtype=np.float32)
    parallax[PLATE] = PLATE_PX
    matched = matched_as(parallax)
    assert HeldOutGain.of(views, matched, 1).kept(matched, views) is matched


def test_a_gain_is_what_the_plane_leaves_less_what_parallax_leaves() -> None:
    """Of a plate without noise its parallax leaves nothing, but where it hides the ground."""
    views = table(0.0, 2)
    parallax = np.zeros(FRAME, dtype=np.float32)
    parallax[PLATE] = PLATE_PX
    found = HeldOutGain.of(views, matched_as(parallax), 1)
    rows, cols = PLATE
    hidden = (rows.stop - rows.start) * PLATE_PX
    plate = (rows.stop - rows.start) * (cols.stop - cols.start)
    # Smoothing by .7 px mixes what is within 2 px of an outline.
    assert found.gain == pytest.approx(plate / (plate + hidden), abs=0.08)


def test_larger_pixels_decide_the_same() -> None:
    views = table(0.3, 4)
    large = replace(
        views,
        **{
            name: np.kron(getattr(views, name), np.ones((2, 2))).astype(np.float32)
            for name in ("target", "source", "to_x", "to_y")
        },
        is_target=np.ones((240, 320), dtype=np.bool_),
        is_source=np.ones((240, 320), dtype=np.bool_),
    )
    matched = match_views(large.reduced(2), -10, 10)
    found = HeldOutGain.of(large, matched, 2)
    assert found.has_depth
    assert found.surfaces.shape == FRAME


def source_of(parallax: Float32Array) -> Float32Array:
    """The same on the source's pixels, in which everything lies to the right by its parallax."""
    found = np.zeros_like(parallax)
    for row, col in np.argwhere(parallax != 0):
        found[row, col + int(parallax[row, col])] = parallax[row, col]
    return found


def matched_as(parallax: Float32Array) -> MatchedViews:
    return MatchedViews(
        target=parallax,
        source=source_of(parallax),
        held_out=parallax,
        is_held_out=np.ones(FRAME, dtype=np.bool_),
        range_px=(-10, 10),
    )
