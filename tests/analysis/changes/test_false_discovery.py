"""Peaks by chance and the share of false ones, against simulated fields and worked examples."""

from math import exp, pi

import numpy as np
import pytest

from analysis.changes.levels import detection_levels
from analysis.changes.regions import connected_regions, discovery_threshold, link_levels, q_values
from analysis.changes.significance import FilterWidth, expected_peaks
from tests.analysis.changes.compared_fields import comparison, smoothed_noise, smoothed_spot


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
    monkeypatch.setattr("analysis.changes.regions.expected_peaks", lambda *_: by_chance)
    # Over ranks: .001, .015, .00667, .1, 1.8; each the least from it on, and at most 1.
    found = q_values(np.zeros(5), 1000, ())
    assert found == pytest.approx([0.001, 0.02 / 3, 0.02 / 3, 0.1, 1.0])
    assert q_values(np.zeros(0), 1000, ()).size == 0


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
