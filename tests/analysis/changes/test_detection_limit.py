"""What would have been found: power against simulated searches, limits in closed form."""

from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.changes.levels import LimitMaps, detection_levels, detection_limit
from analysis.changes.regions import link_levels
from analysis.changes.significance import FilterWidth, detection_power, height_for, response
from tests.analysis.changes.compared_fields import comparison, smoothed_noise, smoothed_spot

SHAPE = (192, 192)
NOISE_SD = 1 / (2 * sqrt(pi))
"""Of white noise of 1 DN behind the smoothing of 1 px."""


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
    noise = smoothed_noise(rng, SHAPE, 1.0) * NOISE_SD
    levels = detection_levels(comparison(noise, NOISE_SD), 1e-6)
    maps = LimitMaps.of(comparison(np.zeros(SHAPE), NOISE_SD), levels, threshold, 1.0)
    limit = float(np.median(maps.limit_dn(sigma)))
    for factor in (0.75, 0.9, 1.0):
        power = float(detection_power(np.array(factor * height_for(0.95, threshold)), threshold))
        found = 0
        for _ in range(trials):
            place = (96 + rng.uniform(-4, 4), 96 + rng.uniform(-4, 4))
            field = smoothed_spot(SHAPE, place, factor * limit, sigma, 1.0)
            field += smoothed_noise(rng, SHAPE, 1.0) * NOISE_SD
            seen = link_levels(detection_levels(comparison(field, NOISE_SD), 1e-6), threshold)
            found += any(
                one.significance > 0 and np.hypot(one.row - place[0], one.col - place[1]) < 8
                for one in seen.regions
            )
        # 3.3 standard errors, and .08 for what the closed form leaves out.
        error = 3.3 * sqrt(power * (1 - power) / trials)
        assert found / trials == pytest.approx(power, abs=error + 0.08)


def test_limits_are_stated_over_what_was_compared() -> None:
    sd = np.full(SHAPE, NOISE_SD)
    sd[:, :24] *= 3.0
    valid = np.ones(SHAPE, dtype=np.bool_)
    valid[:30] = False
    compared = comparison(
        smoothed_noise(np.random.default_rng(3), SHAPE, 1.0) * sd, sd, valid=valid
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


@given(scale=st.floats(0.01, 100.0))
def test_limits_scale_with_the_light(scale: float) -> None:
    field = smoothed_noise(np.random.default_rng(4), SHAPE, 1.0)
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
    field = smoothed_noise(np.random.default_rng(5), SHAPE, 1.0)
    far, near = comparison(field), comparison(field, is_on_followup=False)
    levels = detection_levels(far, 1e-6)
    one = LimitMaps.of(far, levels, 5.0, 1.0).limit_dn(1.5)
    other = LimitMaps.of(near, levels, 5.0, 2.0).limit_dn(3.0)
    assert other == pytest.approx(one)
