"""Filters of several widths: their noise, their chance, and one entry for each change."""

from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from analysis.changes.levels import DetectionLevel, detection_levels
from analysis.changes.regions import link_levels, pixels_of
from analysis.changes.significance import (
    FilterWidth,
    equally_strict,
    exceeded_share,
    significance_threshold,
)
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray
from tests.analysis.changes.compared_fields import (
    comparison,
    listed,
    smoothed_noise,
    smoothed_spot,
)

SHAPE = (200, 260)
SAME = DistortedPose(matrix=np.eye(3), k1=0.0, reference_shape=SHAPE, followup_shape=SHAPE)


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


@given(
    share=st.floats(1e-9, 1e-3),
    errors=st.lists(st.floats(0.0, 0.1), min_size=1, max_size=4),
)
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
