"""The list of changes on fields whose spots and noise are known in closed form."""

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

import standoff
from analysis.changes._change_list import _outlined
from analysis.changes._comparison import Comparison
from analysis.changes._regions import LinkedRegion
from analysis.changes._spot_fit import SmoothedField
from simulation.arrays import FloatArray
from tests.analysis.changes.compared_fields import (
    at_rest,
    comparison,
    listed,
    smoothed_noise,
    smoothed_spot,
    spot,
)

SHAPE = (61, 83)
SAME = at_rest(SHAPE)
HALF = at_rest(SHAPE, np.array([[2.0, 0.0, 20.0], [0.0, 2.0, 10.0], [0.0, 0.0, 1.0]]))
"""The follow-up twice as far, its first pixel on the reference's (20, 10)."""


@pytest.mark.parametrize("smoothing", [1.0, 1.5])
@pytest.mark.parametrize(("sigma", "amplitude"), [(0.8, 60.0), (1.5, -40.0), (4.0, 25.0)])
def test_a_spot_without_noise_has_its_own_place_and_peak(
    sigma: float, amplitude: float, smoothing: float
) -> None:
    field = smoothed_spot(SHAPE, (30.3, 41.8), amplitude, sigma, smoothing)
    (found,) = listed(comparison(field, smoothing_px=smoothing), SAME, 5.0)
    assert (found.y_px, found.x_px) == pytest.approx((30.3, 41.8), abs=1e-3)
    # What the correction for the bias of a noisy peak makes of it is all that is different.
    corrected = amplitude / (1 + 1.5 * (found.amplitude_err_dn / amplitude) ** 2)
    assert found.amplitude_dn == pytest.approx(corrected, rel=5e-3)  # itself from the fitted peak


@pytest.mark.parametrize("amplitude", [40.0, -80.0, 400.0])
def test_the_area_of_a_spot_is_that_of_a_flat_one_with_its_peak_and_light(amplitude: float) -> None:
    field = smoothed_spot((201, 201), (100.2, 99.7), amplitude, 1.5, 1.0)
    field += smoothed_noise(np.random.default_rng(3), (201, 201), 1.0)
    found = listed(comparison(field), SAME, 5.5)[0]
    # The integral of a Gaussian is 2 pi sigma^2 times its peak; noise moves sigma the less the
    # stronger it is.
    assert found.area_px == pytest.approx(2 * pi * 1.5**2, rel=0.02 + 6 / abs(amplitude))


def flat_thing(thing: str, centre: tuple[float, float], size: float, blur: float) -> FloatArray:
    """A flat thing of level 1 by 9 x 9 points a pixel, behind a Gaussian; width ``size``."""
    y, x = ((np.arange(9.0 * n) - 4) / 9 for n in (96, 112))
    down, right = (y - centre[0])[:, None], (x - centre[1])[None, :]
    if thing == "disc":
        inside = down**2 + right**2 <= (size / 2) ** 2
    else:
        inside = (np.abs(down) <= size / 4) & (np.abs(right) <= size / 2)
    blurred = gaussian_filter(inside.astype(np.float64), 9 * blur)
    return np.asarray(blurred.reshape(96, 9, 112, 9).mean(axis=(1, 3)))


@pytest.mark.parametrize("contrast", [12.0, -60.0, 300.0])
@pytest.mark.parametrize(
    ("thing", "size"),
    [("disc", 10.0), ("disc", 28.0), ("disc", 40.0), ("bar", 14.0), ("bar", 40.0)],
)
def test_a_flat_thing_has_its_own_middle_and_area_however_much_it_stands_out(
    thing: str, size: float, contrast: float
) -> None:
    field = contrast * flat_thing(thing, (47.3, 53.8), size, 1.5)
    field += smoothed_noise(np.random.default_rng(8), field.shape, 1.0)
    pose = replace(SAME, reference_shape=field.shape, followup_shape=field.shape)
    found = listed(comparison(field), pose, 6.0)[0]
    assert (found.y_px, found.x_px) == pytest.approx((47.3, 53.8), abs=0.4)
    area_px = pi * (size / 2) ** 2 if thing == "disc" else size**2 / 2
    # Of the short side of 7 px its half contour, behind 1.5 px, is a tenth further out.
    assert found.area_px == pytest.approx(area_px, rel=0.25 if size < 20 else 0.06)


def test_the_stated_error_is_that_of_a_peak_of_free_place_and_width() -> None:
    # In white noise of sigma a pixel, var(A) = 2 sigma^2 / (pi w^2): twice that of a known width.
    sigma_noise, width, smoothing = 3.0, 2.0, 1.0
    field = smoothed_spot(SHAPE, (30.0, 40.0), 9.0, width, smoothing)
    sd = sigma_noise / (2 * sqrt(pi) * smoothing)
    (found,) = listed(comparison(field, sd), SAME, 5.0)
    assert found.amplitude_err_dn == pytest.approx(sqrt(2 / pi) * sigma_noise / width, rel=0.03)


def test_what_vanished_beside_what_appeared_is_a_change_of_its_own() -> None:
    field = smoothed_spot(SHAPE, (30.0, 36.0), 90.0, 1.2, 1.0)
    field += smoothed_spot(SHAPE, (30.0, 41.0), -70.0, 1.2, 1.0)
    found = listed(comparison(field), SAME, 5.0)
    assert [round(change.x_px, 2) for change in found] == [36.0, 41.0]
    amplitudes = [change.amplitude_dn for change in found]
    assert amplitudes == pytest.approx([90.0, -70.0], rel=5e-3)  # the correction for noise


def test_a_neighbour_takes_nothing_of_a_peak() -> None:
    field = smoothed_spot(SHAPE, (30.0, 36.0), 60.0, 1.5, 1.0)
    beside = smoothed_spot(SHAPE, (31.0, 43.0), -90.0, 1.5, 1.0)
    _, found = listed(comparison(field + beside), SAME, 5.0)
    (alone,) = listed(comparison(field), SAME, 5.0)
    assert found.amplitude_dn == pytest.approx(alone.amplitude_dn, rel=5e-3)


def test_two_spots_that_touch_are_one_change_with_the_peak_of_the_stronger() -> None:
    field = smoothed_spot(SHAPE, (30.0, 36.0), 120.0, 1.5, 1.0)
    field += smoothed_spot(SHAPE, (30.0, 41.5), 80.0, 1.5, 1.0)
    (found,) = listed(comparison(field), SAME, 5.0)
    assert 37 < found.x_px < 40.5  # between the two
    assert found.y_px == pytest.approx(30.0, abs=0.05)
    assert found.amplitude_dn == pytest.approx(120.0, rel=0.02)


def test_an_extended_change_has_the_level_of_its_strongest_place() -> None:
    y, x = (np.arange(float(n)) for n in SHAPE)
    sides = [(ndtr(y - 14.5) - ndtr(y - 44.5)), (ndtr(x - 19.5) - ndtr(x - 59.5))]
    field = 12.0 * np.multiply.outer(*sides)  # 30 x 40 px, smoothed by 1 px
    field += smoothed_noise(np.random.default_rng(3), SHAPE, 1.0)
    found = listed(comparison(field), SAME, 6.0)[0]
    assert found.area_px == pytest.approx(30 * 40, rel=0.03)  # not with its rim, .15 more
    assert found.amplitude_dn == pytest.approx(12.0, abs=1.0)
    assert (found.y_px, found.x_px) == pytest.approx((29.5, 39.5), abs=0.3)


def test_a_line_is_one_change_with_the_level_along_it() -> None:
    x = np.arange(float(SHAPE[1]))
    across = 30.0 * 1.2 / sqrt(1.2**2 + 1) * np.exp(-((x - 40.3) ** 2) / (2 * (1.2**2 + 1)))
    field = np.multiply.outer(np.exp(-((np.arange(SHAPE[0]) - 30) ** 2) / 800), across)
    (found,) = listed(comparison(field), SAME, 5.0)
    assert found.amplitude_dn == pytest.approx(30.0, rel=0.05)  # not 23, as smoothed
    assert found.x_px == pytest.approx(40.3, abs=0.3)


def test_on_either_grid_places_areas_and_signs_are_those_of_the_follow_up() -> None:
    field = smoothed_spot(SHAPE, (30.0, 40.0), 50.0, 2.0, 1.0)
    (far,) = listed(comparison(field), HALF, 5.0)
    assert (far.x_px, far.y_px) == pytest.approx((40.0, 30.0), abs=1e-3)
    assert (far.reference_x_px, far.reference_y_px) == pytest.approx((100.0, 70.0), abs=2e-3)
    (near,) = listed(comparison(field, is_on_followup=False), HALF, 5.0)
    assert (near.reference_x_px, near.reference_y_px) == pytest.approx((40.0, 30.0), abs=1e-3)
    assert (near.x_px, near.y_px) == pytest.approx((10.0, 10.0), abs=1e-3)
    # A reference pixel is a quarter of a follow-up pixel.
    assert near.area_px == pytest.approx(far.area_px / 4)
    assert near.amplitude_dn == pytest.approx(far.amplitude_dn)


def test_the_most_significant_comes_first_and_an_empty_frame_has_none() -> None:
    field = sum(
        (
            smoothed_spot(SHAPE, (30.0, x), a, 1.5, 1.0)
            for x, a in ((15, 20.0), (40, -80), (65, 50))
        ),
        start=np.zeros(SHAPE),
    )
    found = listed(comparison(field), SAME, 5.0)
    assert [round(change.x_px) for change in found] == [40, 65, 15]
    assert [change.q_value for change in found] == sorted(change.q_value for change in found)
    assert listed(comparison(np.zeros(SHAPE)), SAME, 5.0) == ()


@pytest.mark.slow
def test_errors_cover_the_truth_as_often_as_stated() -> None:
    # 10 standard deviations of the matched filter: A w sqrt(pi) = 10 sigma in white noise.
    rng = np.random.default_rng(5)
    inside, shape, sd = 0, (45, 45), 1 / (2 * sqrt(pi))
    for width in np.repeat([1.0, 1.5, 2.0, 3.0], 30):
        amplitude = 10 / (sqrt(pi) * width)
        place = tuple((22 + rng.uniform(-0.5, 0.5, 2)).tolist())
        field = smoothed_spot(shape, (place[0], place[1]), amplitude, width, 1.0)
        field += sd * smoothed_noise(rng, shape, 1.0)
        found = listed(comparison(field, sd), SAME, 4.0)[0]
        inside += abs(found.amplitude_dn - amplitude) < 1.96 * found.amplitude_err_dn
        assert np.hypot(found.y_px - place[0], found.x_px - place[1]) < 2.5
    # 114 are expected of 120; a right one has fewer than 105 once in 1,000 times.
    assert inside >= 105


def within(field: FloatArray, top: int, left: int) -> Comparison:
    """A field within a larger frame of which nothing else was compared."""
    rows, cols = field.shape
    frame, valid = np.zeros((96, 96)), np.zeros((96, 96), dtype=np.bool_)
    frame[top : top + rows, left : left + cols] = field
    valid[top : top + rows, left : left + cols] = True
    return comparison(frame, valid=valid)


def noisy_spots(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    field = smoothed_noise(rng, (64, 64), 1.0)
    for y, x in ((20, 20), (22, 44), (43, 30)):
        place = (y + rng.uniform(-2, 2), x + rng.uniform(-2, 2))
        amplitude = rng.choice([-1, 1]) * rng.uniform(10, 40)
        field += smoothed_spot((64, 64), place, amplitude, rng.uniform(1, 3), 1.0)
    return np.asarray(field)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), down=st.integers(-3, 3), right=st.integers(-3, 3))
@settings(max_examples=15, deadline=None)
def test_the_list_moves_with_the_grid(seed: int, down: int, right: int) -> None:
    down, right = 4 * down, 4 * right  # the widest filter has a sample every 4 px
    field = noisy_spots(seed)
    here = listed(within(field, 16, 16), SAME, 5.5)
    there = listed(within(field, 16 + down, 16 + right), SAME, 5.5)
    areas_px = [change.area_px for change in there]
    assert [change.area_px for change in here] == pytest.approx(areas_px, rel=1e-6)
    for one, other in zip(here, there, strict=True):
        moved = (other.y_px - down, other.x_px - right, other.amplitude_dn)
        assert moved == pytest.approx((one.y_px, one.x_px, one.amplitude_dn), abs=1e-2)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), light=st.floats(1e-3, 1e3))
@settings(max_examples=15, deadline=None)
def test_amplitudes_scale_with_the_light_and_change_sign_with_the_change(
    seed: int, light: float
) -> None:
    field = noisy_spots(seed)
    plain = listed(comparison(field), SAME, 5.0)
    scaled = listed(comparison(-light * field, light), SAME, 5.0)
    for one, other in zip(plain, scaled, strict=True):
        assert other.amplitude_dn == pytest.approx(-light * one.amplitude_dn, rel=1e-3)
        assert other.amplitude_err_dn == pytest.approx(light * one.amplitude_err_dn, rel=1e-3)
        assert other.significance == pytest.approx(one.significance)


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 12), st.integers(1, 12)),
    share=st.floats(0, 1),
    scale=st.floats(0.1, 1e3),
)
@example(seed=12, shape=(10, 12), share=0.125, scale=47.0)  # slopes whose squares underflow
@settings(max_examples=20, deadline=None)
def test_any_mask_and_any_field_have_a_list(
    seed: int, shape: tuple[int, int], share: float, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    valid = rng.uniform(size=shape) < share
    field = comparison(scale * rng.standard_normal(shape), valid=valid)
    for change in listed(field, SAME, 3.0):
        assert change.amplitude_err_dn > 0
        assert 0 <= change.q_value <= 1
        assert change.significance > 3


def test_half_hidden_by_a_mask_a_spot_keeps_its_peak() -> None:
    field = smoothed_spot(SHAPE, (30.0, 40.0), 80.0, 1.5, 1.0)
    valid = np.ones(SHAPE, dtype=np.bool_)
    valid[:, 41:] = False
    (found,) = listed(comparison(field, valid=valid), SAME, 5.0)
    assert found.amplitude_dn == pytest.approx(80.0, rel=0.01)


def test_the_smoothed_spot_of_these_tests_is_one() -> None:
    # Against a sum over pixels, fine enough to be an integral.
    plain = spot((41, 41), (20.0, 20.0), 7.0, 4.0)
    kernel = spot((41, 41), (20.0, 20.0), 1.0, 2.25)
    summed = float((plain * kernel).sum() / kernel.sum())
    smoothed = smoothed_spot((41, 41), (20.0, 20.0), 7.0, 2.0, 1.5)
    assert smoothed[20, 20] == pytest.approx(summed, rel=1e-6)


def test_a_change_that_its_field_shows_with_the_other_sign_has_the_outline_of_its_pixels() -> None:
    # As of a dark thing beside a bright one, seen through a filter wider than both.
    rows, cols = np.nonzero(np.pad(np.ones((3, 4), np.bool_), ((20, 38), (30, 49))))
    region = LinkedRegion(
        level=0, row=21, col=31, significance=-9.0, rows=rows, cols=cols, light=np.zeros(0, int)
    )
    field = SmoothedField(
        step_px=1,
        smoothing=1.0,
        difference_dn=np.full(SHAPE, 5.0, np.float32),
        sd_dn=np.ones(SHAPE, np.float32),
        valid=np.ones(SHAPE, np.bool_),
    )
    outline = _outlined(region, field)
    np.testing.assert_array_equal(outline[0], rows)
    np.testing.assert_array_equal(outline[1], cols)


def test_changes_among_clipped_pixels_have_a_place() -> None:
    rng = np.random.default_rng(1)
    scene = 1000 + 4000 * gaussian_filter(rng.standard_normal((240, 260)), 1.5)
    before, after = scene + rng.normal(0, 3, scene.shape), scene.copy()
    after[60:64, 70:74] += 300
    after[120:160, 150:190] += 200
    after += rng.normal(0, 3, scene.shape)
    near, far = (np.clip(levels, 0, 65535).astype(np.uint16) for levels in (before, after))
    found = standoff.find_changes(near, far).summary.changes
    places = [(change.y_px, change.x_px) for change in found]
    assert places[0] == pytest.approx((139.5, 169.5), abs=2)
    assert places[1] == pytest.approx((61.5, 71.5), abs=4)
    assert len(places) == 2
