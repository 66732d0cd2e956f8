"""What the filters make of white noise and of spots, against closed forms."""

from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.changes.matching import (
    KERNEL_RADIUS_PX,
    Smoothing,
    smoothing_for,
    white_noise_gain,
)
from analysis.changes.prediction import ExpectedFilters
from analysis.changes.significance import FilterWidth

ZOOMS = st.floats(1.0, 4.0)
BLURS = st.floats(-1.5, 1.5)


@given(zoom=ZOOMS, blur_px2=BLURS)
def test_the_narrowest_filter_lets_as_much_noise_through_as_in_a_comparison(
    zoom: float, blur_px2: float
) -> None:
    filters = ExpectedFilters(zoom=zoom, smoothing=smoothing_for(blur_px2))
    taps = np.zeros((2 * KERNEL_RADIUS_PX + 1,) * 2)
    taps[KERNEL_RADIUS_PX, KERNEL_RADIUS_PX] = 1.0
    gains = white_noise_gain(taps, filters.smoothing, zoom)
    narrowest = FilterWidth(width_px=filters.smoothing.target_px)
    assert filters.noise_gain(narrowest) == pytest.approx(gains.source + gains.target)


@given(zoom=ZOOMS, blur_px2=BLURS)
def test_wider_filters_let_less_noise_through_and_count_as_strictly(
    zoom: float, blur_px2: float
) -> None:
    filters = ExpectedFilters(zoom=zoom, smoothing=smoothing_for(blur_px2))
    gains = [filters.noise_gain(width) for width in filters.widths]
    assert all(np.diff(gains) < 0)
    assert [width.allowance for width in filters.widths] == sorted(
        width.allowance for width in filters.widths
    )


def test_a_spot_in_white_noise_has_the_limit_of_the_closed_form() -> None:
    # Equal photographs: behind a first width of root 2 px noise has 1 / (4 pi), and a spot of 1 px
    # is a third as high, less what its mean distance from a pixel's centre takes.
    filters = ExpectedFilters(zoom=1.0, smoothing=Smoothing(source_px=1.0, target_px=1.0))
    by_hand = 3.0 * sqrt(1 / (4 * pi)) / (np.exp(-1 / 6 / 6) / 3)
    assert filters.limit_per_height(1.0, 3.0) == pytest.approx(by_hand, rel=1e-9)


def test_an_autocovariance_is_averaged_as_a_wider_gaussian_does() -> None:
    # White noise behind s is alike as exp(-d^2 / 4 s^2), and has 1 / 4 pi w^2 behind w.
    filters = ExpectedFilters(zoom=1.0, smoothing=Smoothing(source_px=1.3, target_px=1.3))
    lag = np.arange(-120, 121)
    alike = np.exp(-(np.add.outer(lag**2, lag**2)) / (4 * 1.3**2)) / (4 * pi * 1.3**2)
    for width in filters.widths:
        weights = filters.averaging(width, 120)
        assert weights.sum() == pytest.approx(1.0, abs=1e-3)
        # To 0.1 %: the sums stand for integrals.
        assert np.sum(weights * alike) == pytest.approx(1 / (4 * pi * width.width_px**2), rel=1e-3)
