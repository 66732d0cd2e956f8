"""Filters of several widths: their noise, chance and power, against simulation and closed forms."""

from dataclasses import replace
from math import exp, pi, sqrt

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.special import ndtr

from analysis.changes import FilterWidth, detection_power, height_for, significance_threshold
from analysis.changes._colour import Bounds
from analysis.changes._levels import DetectionLevel, LimitMaps, detection_levels, detection_limit
from analysis.changes._regions import (
    connected_regions,
    discovery_threshold,
    link_levels,
    pixels_of,
    q_values,
)
from analysis.changes._significance import equally_strict, exceeded_share, expected_peaks, response
from simulation.arrays import FloatArray
from tests.analysis.changes.compared_fields import (
    at_rest,
    comparison,
    listed,
    smoothed_noise,
    smoothed_spot,
)

SHAPE = (200, 260)
SAME = at_rest(SHAPE)


def levels_of(field: FloatArray, **how: object) -> tuple[DetectionLevel, ...]:
    return detection_levels(comparison(field, **how), 1e-6)  # type: ignore[arg-type]


def spread_over(level: DetectionLevel) -> float:
    """Scatter of a level's places over its standard deviation, without the allowance."""
    return float(level.significance[level.valid].std()) * level.filter_width.allowance


@pytest.mark.parametrize("smoothing", [1.0, 1.4])
def test_white_noise_scatters_as_each_level_says(smoothing: float) -> None:
    rng = np.random.default_rng(8)
    square = np.zeros(4)
    for _ in range(12):
        levels = levels_of(smoothed_noise(rng, SHAPE, smoothing), smoothing_px=smoothing)
        assert [level.width_px for level in levels] == pytest.approx(
            [smoothing * sqrt(2) * 2**number for number in range(len(levels))]
        )
        square[: len(levels)] += [spread_over(level) ** 2 for level in levels]
    # Independent places: 12 x 52,000 / (4 pi w^2), of which sqrt(2 n) is the error; 3.5 of them,
    # and 2 % for a scatter that each frame measures itself.
    for level, found in zip(levels, np.sqrt(square / 12), strict=False):
        places = 12 * SHAPE[0] * SHAPE[1] / (4 * pi * level.width_px**2)
        assert found == pytest.approx(1.0, abs=3.5 / sqrt(2 * places) + 0.02)


def test_noise_that_varies_over_the_frame_and_ends_at_a_mask_scatters_as_said() -> None:
    rng = np.random.default_rng(9)
    sd = np.linspace(1.0, 5.0, SHAPE[1])[None] * np.ones(SHAPE)
    valid = np.ones(SHAPE, dtype=np.bool_)
    valid[:, 150:158] = False
    valid[60:90, 20:80] = False
    square, count = np.zeros(4), 20
    for _ in range(count):
        field = sd * smoothed_noise(rng, SHAPE, 1.0)
        levels = levels_of(field, sd_dn=sd, valid=valid)
        square += [spread_over(level) ** 2 for level in levels]
    for level, found in zip(levels, np.sqrt(square / count), strict=True):
        places = count * valid.sum() / (4 * pi * level.width_px**2)
        assert found == pytest.approx(1.0, abs=3.5 / sqrt(2 * places) + 0.03)


def test_noise_of_which_an_end_of_the_scale_hides_one_sign_is_no_change_behind_any_width() -> None:
    # What is surely there of each pixel, summed up, was 4 standard deviations behind the widest
    # filter; and half of the places have no scatter, which made all others significant.
    rng = np.random.default_rng(10)
    may_be_more, may_be_less = np.zeros((2, *SHAPE), dtype=np.bool_)
    may_be_less[:, 130:] = True
    for _ in range(6):
        field = smoothed_noise(rng, SHAPE, 1.0)
        exact = field.astype(np.float32)
        bounds = Bounds.of(exact, np.ones_like(exact), may_be_more, may_be_less)
        assert bounds is not None
        compared = replace(comparison(bounds.surely().astype(np.float64)), bounds=bounds)
        for level, same in zip(detection_levels(compared, 1e-6), levels_of(field), strict=True):
            # Of the independent places of half a frame, sqrt(2 n) is the error; 3.5 of them.
            places = SHAPE[0] * SHAPE[1] / (8 * pi * level.width_px**2)
            own, its = (one.sd_dn.mean() / one.filter_width.allowance for one in (level, same))
            assert own == pytest.approx(its, rel=3.5 / sqrt(2 * places))
            found = level.significance[:, 160 // level.step_px :]
            assert found.max() <= 0
            assert found.min() > -5
            # The negative half of a normal distribution has a mean of -0.4.
            assert found.mean() == pytest.approx(-0.4, abs=0.25)


def test_a_difference_of_one_level_stays_itself_behind_every_width_and_mask() -> None:
    valid = np.random.default_rng(2).uniform(size=SHAPE) < 0.9
    for level in levels_of(np.full(SHAPE, 3.0), valid=valid):
        assert level.difference_dn[level.valid] == pytest.approx(3.0, rel=1e-5)


@pytest.mark.parametrize(
    ("threshold", "count"), [(2.5, 60), pytest.param(3.5, 400, marks=pytest.mark.slow)]
)
def test_chance_exceeds_a_threshold_behind_any_width_as_often_as_computed(
    threshold: float, count: int
) -> None:
    """Simulated: white noise, whose agreement between widths is in no formula here."""
    rng = np.random.default_rng(21)
    widths = [FilterWidth(width_px=2.0**k, spread_err=0.0) for k in range(4)]
    shape, exceeded = (128, 128), []
    freq = np.fft.fftfreq(shape[0])[:, None] ** 2 + np.fft.rfftfreq(shape[1])[None] ** 2
    for _ in range(count):
        series = np.fft.rfft2(rng.standard_normal(shape))
        behind = [
            np.fft.irfft2(series * np.exp(-2 * (pi * w.width_px) ** 2 * freq), s=shape)
            * (2 * sqrt(pi) * w.width_px)
            for w in widths
        ]
        exceeded.append(np.mean(np.max(np.abs(behind), axis=0) > threshold))
    found, error = float(np.mean(exceeded)), float(np.std(exceeded) / sqrt(count))
    assert exceeded_share(threshold, widths) == pytest.approx(found, abs=3.5 * error + 0.03 * found)


@pytest.mark.slow
@given(share=st.floats(1e-9, 1e-3), errors=st.lists(st.floats(0.0, 0.1), min_size=1, max_size=4))
def test_one_threshold_gives_each_width_the_same_chance(share: float, errors: list[float]) -> None:
    widths = equally_strict(
        [FilterWidth(width_px=2.0**k, spread_err=err) for k, err in enumerate(errors)], share
    )
    threshold = significance_threshold(share, widths)
    assert exceeded_share(threshold, widths) == pytest.approx(share, rel=1e-6)
    shares = [width.exceeded_share(threshold) for width in widths]
    assert shares == pytest.approx([shares[0]] * len(shares), rel=0.2)
    assert widths[0].allowance == pytest.approx(1.0)
    assert share / len(widths) * 0.99 < shares[0] <= share * (1 + 1e-6)


@pytest.mark.parametrize("sigma", [1.0, 1.5, 3.0, 6.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_spot_of_any_width_is_one_change_of_its_size(sigma: float, sign: int) -> None:
    # 12 standard deviations of the filter matched to it: A sigma sqrt(pi) = 12 in white noise.
    amplitude = sign * 12 / (sigma * sqrt(pi))
    found = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        place = (100 + rng.uniform(-1, 1), 130 + rng.uniform(-1, 1))
        field = smoothed_spot(SHAPE, place, amplitude, sigma, 1.0)
        field += smoothed_noise(rng, SHAPE, 1.0) / (2 * sqrt(pi))
        changes = listed(comparison(field, 1 / (2 * sqrt(pi))), SAME, 5.5)
        assert len(changes) == 1
        assert np.hypot(changes[0].y_px - place[0], changes[0].x_px - place[1]) < 0.5 + sigma / 3
        assert changes[0].spot_sigma_px is not None
        found += abs(changes[0].spot_sigma_px / sigma - 1) < 0.3
    assert found >= 3  # of 4; a standard error is 8 to 13 %


@given(seed=st.integers(0, 2**32 - 1), height=st.floats(20.0, 3000.0))
@settings(max_examples=10, deadline=None)
def test_however_strong_a_change_no_wider_filter_finds_it_again(seed: int, height: float) -> None:
    rng = np.random.default_rng(seed)
    place, sigma = tuple(rng.uniform(80, 120, 2).tolist()), float(rng.uniform(0.6, 4.0))
    field = smoothed_spot(SHAPE, (place[0], place[1]), height / sigma, sigma, 1.0)
    field += smoothed_noise(rng, SHAPE, 1.0) / (2 * sqrt(pi))
    found = link_levels(levels_of(field, sd_dn=1 / (2 * sqrt(pi))), 6.0)
    assert len(found.regions) == 1
    y, x = np.nonzero(pixels_of(found.regions, SHAPE))
    # Where the spot itself has left the noise: a wide filter's skirt would reach 30 px.
    assert np.hypot(y - place[0], x - place[1]).max() < 4.2 * sqrt(sigma**2 + 1) + 2


def test_a_weak_wide_change_beside_a_strong_narrow_one_is_found() -> None:
    field = smoothed_spot(SHAPE, (100.0, 100.0), 60.0, 1.2, 1.0)
    field += smoothed_spot(SHAPE, (100.0, 126.0), 1.2, 7.0, 1.0)
    changes = listed(comparison(field, 1 / (2 * sqrt(pi))), SAME, 5.5)
    assert [round(one.x_px / 2) for one in changes] == [50, 63]


def test_pieces_of_a_wide_change_behind_the_narrowest_filter_are_that_change() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    rng = np.random.default_rng(1)
    field = smoothed_spot(SHAPE, (100.0, 130.0), 2.2, 7.0, 1.0)
    field += smoothed_noise(rng, SHAPE, 1.0) / (2 * sqrt(pi))
    levels = levels_of(field, sd_dn=1 / (2 * sqrt(pi)))
    pieces = levels[0].significance[np.hypot(y - 100, x - 130) < 14]
    assert pieces.max() > 5.5  # the narrowest filter alone has pieces of it
    (region,) = link_levels(levels, 5.5).regions
    assert region.level >= 2


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32 - 1),
    holes=st.integers(1, 40),
    size=st.integers(1, 12),
    height=st.floats(3.0, 300.0),
)
@settings(max_examples=15, deadline=None)
def test_masks_full_of_holes_have_a_list_of_places_that_were_compared(
    seed: int, holes: int, size: int, height: float
) -> None:
    rng = np.random.default_rng(seed)
    valid = np.ones((96, 110), dtype=np.bool_)
    for row, col in rng.integers(0, 90, (holes, 2)):
        valid[row : row + size, col : col + size] = False
    field = smoothed_noise(rng, valid.shape, 1.0)
    for place in rng.uniform(10, 86, (4, 2)).tolist():
        spot = (place[0], place[1])
        field += smoothed_spot(valid.shape, spot, height, float(rng.uniform(0.5, 8.0)), 1.0)
    compared = comparison(field, valid=valid)
    found = link_levels(detection_levels(compared, 1e-6), 5.0)
    assert not pixels_of(found.regions, valid.shape)[~valid].any()
    for region in found.regions:
        assert len(region.rows)
        assert valid[region.row, region.col]
    for change in listed(compared, SAME, 5.0):
        assert change.amplitude_err_dn > 0
        assert change.spot_sigma_px is not None


@given(rate=st.floats(1e-9, 0.5))
def test_the_threshold_allows_for_a_spread_that_is_not_known_exactly(rate: float) -> None:
    threshold = significance_threshold(rate, (FilterWidth(width_px=1.0),))
    # A tail is fuller where the spread is not known exactly.
    nodes, weights = np.polynomial.hermite_e.hermegauss(15)
    exact = 2 * ndtr(-threshold / (1 + 0.03 * nodes)) @ weights / weights.sum()
    assert exact == pytest.approx(rate, rel=1e-6)
    assert threshold > -1e-9
    if rate < 1e-3:
        assert 2 * ndtr(-threshold) < rate


LIMIT_SHAPE = (192, 192)
NOISE_SD = 1 / (2 * sqrt(pi))
"""Of white noise of 1 DN behind the smoothing of 1 px."""


@pytest.mark.slow
@given(power=st.floats(0.01, 0.999), threshold=st.floats(3.0, 9.0))
def test_a_spot_of_that_height_is_found_as_often_as_asked(power: float, threshold: float) -> None:
    if float(detection_power(np.array(0.0), threshold)) > power:
        return
    height = height_for(power, threshold)
    assert float(detection_power(np.array(height), threshold)) == pytest.approx(power, abs=1e-9)


def test_power_rises_with_the_height_and_falls_with_the_threshold() -> None:
    heights = np.linspace(0, 12, 60)
    for threshold in (4.0, 5.3, 6.5):
        power = detection_power(heights, threshold)
        assert (np.diff(power) >= 0).all()
        assert (np.diff(power)[power[:-1] < 0.999] > 0).all()
        assert (power >= detection_power(heights, threshold + 0.1)).all()


def test_the_response_is_that_of_two_gaussians_in_a_row() -> None:
    # A spot of 2 px behind 1.5 px: 4 / 6.25 at its very peak, a little less at the nearest pixel.
    found = float(response(np.array(2.0), FilterWidth(width_px=1.5)))
    assert found == pytest.approx(4 / 6.25 * np.exp(-1 / 6 / 12.5), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [1.0, 1.5, 3.0, 6.0])
def test_as_many_spots_are_found_as_predicted(sigma: float) -> None:
    """Searched in simulated noise, at the places where the limit is stated."""
    rng = np.random.default_rng(int(10 * sigma))
    trials, threshold = 100, 5.3
    noise = smoothed_noise(rng, LIMIT_SHAPE, 1.0) * NOISE_SD
    levels = detection_levels(comparison(noise, NOISE_SD), 1e-6)
    maps = LimitMaps.of(comparison(np.zeros(LIMIT_SHAPE), NOISE_SD), levels, threshold, 1.0)
    limit = float(np.median(maps.limit_dn(sigma)))
    for factor in (0.75, 1.0):
        power = float(detection_power(np.array(factor * height_for(0.95, threshold)), threshold))
        found = 0
        for _ in range(trials):
            place = (96 + rng.uniform(-4, 4), 96 + rng.uniform(-4, 4))
            field = smoothed_spot(LIMIT_SHAPE, place, factor * limit, sigma, 1.0)
            field += smoothed_noise(rng, LIMIT_SHAPE, 1.0) * NOISE_SD
            seen = link_levels(detection_levels(comparison(field, NOISE_SD), 1e-6), threshold)
            found += any(
                one.significance > 0 and np.hypot(one.row - place[0], one.col - place[1]) < 8
                for one in seen.regions
            )
        # 3.3 standard errors, and .08 for what the closed form leaves out.
        error = 3.3 * sqrt(power * (1 - power) / trials)
        assert found / trials == pytest.approx(power, abs=error + 0.08)


def test_limits_are_stated_over_what_was_compared() -> None:
    sd = np.full(LIMIT_SHAPE, NOISE_SD)
    sd[:, :24] *= 3.0
    valid = np.ones(LIMIT_SHAPE, dtype=np.bool_)
    valid[:30] = False
    compared = comparison(
        smoothed_noise(np.random.default_rng(3), LIMIT_SHAPE, 1.0) * sd, sd, valid=valid
    )
    levels = detection_levels(compared, 1e-6)
    maps = LimitMaps.of(compared, levels, 5.0, 1.0)
    found = detection_limit(maps, 2.0, contrast_dn=4.0)
    assert [spot.spot_sigma_px for spot in found.spots] == [1.0, 1.5, 2.0, 3.0, 6.0]
    assert np.isinf(maps.limit_dn(2.0)[:30]).all()
    limit = maps.limit_dn(2.0)[valid]
    assert found.mapped.median_dn == pytest.approx(float(np.median(limit)))
    assert found.mapped.worst_dn == pytest.approx(float(limit.max()))
    assert found.mapped.reached_fraction == pytest.approx(float(np.mean(limit <= 4.0)))
    assert found.mapped.worst_dn > 2.5 * found.mapped.median_dn
    medians = [spot.median_dn for spot in found.spots]
    assert medians == sorted(medians, reverse=True)  # what is wider needs less


@pytest.mark.slow
@given(scale=st.floats(0.01, 100.0))
@settings(max_examples=20, deadline=None)
def test_limits_scale_with_the_light(scale: float) -> None:
    field = smoothed_noise(np.random.default_rng(4), LIMIT_SHAPE, 1.0)
    limits = [
        detection_limit(
            LimitMaps.of(compared, detection_levels(compared, 1e-6), 5.0, 1.0), 1.5, None
        ).mapped
        for compared in (comparison(field), comparison(scale * field, scale))
    ]
    assert limits[1].median_dn == pytest.approx(scale * limits[0].median_dn, rel=1e-4)
    assert limits[1].reached_fraction is None


def test_on_the_reference_grid_a_spot_is_as_wide_as_the_follow_up_shows_it() -> None:
    # The follow-up has two pixels to one of the grid: 3 px of it are 1.5 px there.
    field = smoothed_noise(np.random.default_rng(5), LIMIT_SHAPE, 1.0)
    far, near = comparison(field), comparison(field, is_on_followup=False)
    levels = detection_levels(far, 1e-6)
    one = LimitMaps.of(far, levels, 5.0, 1.0).limit_dn(1.5)
    other = LimitMaps.of(near, levels, 5.0, 2.0).limit_dn(3.0)
    assert other == pytest.approx(one)


def test_regions_of_opposite_signs_are_apart_and_corners_connect() -> None:
    field = np.zeros((6, 8))
    field[1, 1], field[2, 2], field[2, 3] = 6.0, 7.0, -9.0
    field[4, 6] = 5.0  # not beyond the threshold
    found = connected_regions(field, 5.0)
    assert [(one.row, one.col, one.significance) for one in found] == [(2, 3, -9), (2, 2, 7)]
    assert [len(one.rows) for one in found] == [1, 2]


@pytest.mark.parametrize(("smoothing", "step"), [(1.0, 1), (1.5, 1), (4.0, 2), (8.0, 4)])
def test_as_many_peaks_as_simulated_fields_have(smoothing: float, step: int) -> None:
    known = FilterWidth(width_px=smoothing, step_px=step, spread_err=0.0)
    rng = np.random.default_rng(3)
    counted = sum(
        len(connected_regions(smoothed_noise(rng, (512, 512), smoothing)[::step, ::step], 3.5))
        for _ in range(16)
    )
    area = 16 * 512**2
    # 5 % for peaks that run together, 3.5 standard errors of the count.
    expected = float(expected_peaks(np.array(3.5), area, (known,)))
    assert counted == pytest.approx(expected, rel=0.05, abs=3.5 * expected**0.5)


def test_wide_smoothing_leaves_the_euler_characteristic() -> None:
    wide = FilterWidth(width_px=50.0, spread_err=0.0)
    # Adler's density u exp(-u^2/2) / ((2 pi)^1.5 2 s^2), for both signs; pixels miss nothing.
    expected = 2 * 1e6 * 4.0 * exp(-8.0) / ((2 * pi) ** 1.5 * 2 * 50.0**2)
    assert float(expected_peaks(np.array(4.0), 10**6, (wide,))) == pytest.approx(expected, rel=1e-3)


def test_q_values_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    by_chance = np.array([0.001, 0.03, 0.02, 0.4, 9.0])
    monkeypatch.setattr("analysis.changes._regions.expected_peaks", lambda *_: by_chance)
    # Over ranks: .001, .015, .00667, .1, 1.8; each the least from it on, and at most 1.
    found = q_values(np.zeros(5), 1000, ())
    assert found == pytest.approx([0.001, 0.02 / 3, 0.02 / 3, 0.1, 1.0])
    assert q_values(np.zeros(0), 1000, ()).size == 0


@pytest.mark.slow
def test_the_false_share_is_as_asked() -> None:
    rng = np.random.default_rng(11)
    places = [(y, x) for y in range(16, 150, 24) for x in range(16, 150, 24)]
    truth = np.zeros((160, 160))
    for y, x in places:
        truth += smoothed_spot(truth.shape, (y, x), 7.0, 1.5, 1.0)
    near = truth > 0.3
    false = listed = 0
    for _ in range(30):
        field = truth + smoothed_noise(rng, truth.shape, 1.0)
        levels = detection_levels(comparison(field), 1e-6)
        found = link_levels(levels, discovery_threshold(levels, 0.2)).regions
        listed += len(found)
        false += sum(not near[one.row, one.col] for one in found)
    # No more than asked; less, since so many spots raise the scatter that wide filters measure, and
    # what chance adds beside a spot is taken for a part of it. 1,000 are listed.
    assert 0.03 < false / listed < 0.2
    assert listed > 30 * len(places) / 2


@pytest.mark.slow
def test_an_unchanged_frame_lists_something_as_often_as_asked() -> None:
    rng = np.random.default_rng(4)
    frames = 60
    found = 0
    for _ in range(frames):
        field = smoothed_noise(rng, (96, 96), 1.0)
        levels = detection_levels(comparison(field), 1e-6)
        found += bool(link_levels(levels, discovery_threshold(levels, 0.2)).regions)
    assert found <= 22  # of 60 at 0.2: 12, once in 1,000 times more than 22


@pytest.mark.parametrize("rate", [0.0, 1.0, -0.1, float("nan")])
def test_a_share_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        discovery_threshold(detection_levels(comparison(np.zeros((8, 8))), 1e-6), rate)
