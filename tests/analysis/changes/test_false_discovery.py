"""Peaks by chance and the share of false ones, against simulated fields and worked examples."""

from math import exp, pi

import numpy as np
import pytest

from analysis.changes import chance
from analysis.changes.chance import expected_peaks
from analysis.changes.false_discovery import discovery_threshold, q_values
from analysis.changes.peaks import connected_peaks
from tests.analysis.changes.compared_fields import comparison, smoothed_noise, smoothed_spot


def test_regions_of_opposite_signs_are_apart_and_corners_connect() -> None:
    field = np.zeros((6, 8))
    field[1, 1], field[2, 2], field[2, 3] = 6.0, 7.0, -9.0
    field[4, 6] = 5.0  # not beyond the threshold
    found = connected_peaks(field, 5.0)
    assert found.row.tolist() == [2, 2]
    assert found.col.tolist() == [3, 2]
    assert found.significance.tolist() == [9.0, 7.0]
    assert found.area_px.tolist() == [1, 2]


@pytest.mark.parametrize("smoothing", [1.0, 1.5])
def test_as_many_peaks_as_simulated_fields_have(
    smoothing: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chance, "_SPREADS", np.ones(15))  # the field's spread is known
    rng = np.random.default_rng(3)
    found = [
        connected_peaks(smoothed_noise(rng, (512, 512), smoothing), 3.5).significance
        for _ in range(16)
    ]
    counted = len(np.concatenate(found))
    area = 16 * 512**2
    # 5 % for peaks that run together, 3.5 standard errors of the count.
    expected = float(expected_peaks(np.array(3.5), area, smoothing))
    assert counted == pytest.approx(expected, rel=0.05, abs=3.5 * expected**0.5)


def test_wide_smoothing_leaves_the_euler_characteristic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chance, "_SPREADS", np.ones(15))
    # Adler's density u exp(-u^2/2) / ((2 pi)^1.5 2 s^2), for both signs; pixels miss nothing.
    expected = 2 * 1e6 * 4.0 * exp(-8.0) / ((2 * pi) ** 1.5 * 2 * 50.0**2)
    assert float(expected_peaks(np.array(4.0), 10**6, 50.0)) == pytest.approx(expected, rel=1e-3)


def test_q_values_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    by_chance = np.array([0.001, 0.03, 0.02, 0.4, 9.0])
    monkeypatch.setattr("analysis.changes.false_discovery.expected_peaks", lambda *_: by_chance)
    # Over ranks: .001, .015, .00667, .1, 1.8; each the least from it on, and at most 1.
    found = q_values(np.zeros(5), 1000, 1.0)
    assert found == pytest.approx([0.001, 0.02 / 3, 0.02 / 3, 0.1, 1.0])
    assert q_values(np.zeros(0), 1000, 1.0).size == 0


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
        threshold = discovery_threshold(comparison(field), 0.2)
        found = connected_peaks(field, threshold)
        listed += len(found)
        false += int(np.count_nonzero(~near[found.row, found.col]))
    # The others' share of the area times 0.2, and allowance for the spread; 1,000 are listed.
    assert 0.08 < false / listed < 0.2
    assert listed > 30 * len(places) / 2


def test_an_unchanged_frame_lists_something_as_often_as_asked() -> None:
    rng = np.random.default_rng(4)
    frames = 60
    found = 0
    for _ in range(frames):
        field = smoothed_noise(rng, (96, 96), 1.0)
        found += len(connected_peaks(field, discovery_threshold(comparison(field), 0.2))) > 0
    assert found <= 22  # of 60 at 0.2: 12, once in 1,000 times more than 22


@pytest.mark.parametrize("rate", [0.0, 1.0, -0.1, float("nan")])
def test_a_share_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        discovery_threshold(comparison(np.zeros((8, 8))), rate)
