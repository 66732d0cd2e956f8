"""NEQ and the ideal observer, against closed forms of Gaussian lenses and white noise."""

from itertools import product
from math import erf, exp, pi, sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import i0e, i1e

from calibration.capacity import (
    Bar,
    Disc,
    GaussianSpot,
    NoisePower,
    SignalAndNoise,
    edge_location_err_px,
    edge_shift_snr,
    ideal_observer_snr,
)
from simulation.arrays import FloatArray

SIGMA_PX = 0.6


def gaussian(fx: FloatArray, fy: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-2 * pi**2 * SIGMA_PX**2 * (fx**2 + fy**2)))


def camera(signal_dn: float = 200.0, noise_dn: float = 5.0) -> SignalAndNoise:
    noise = NoisePower(variance_dn2=noise_dn**2)
    return SignalAndNoise(transfer=gaussian, noise=noise, signal_dn=signal_dn)


def test_a_counter_of_photons_has_as_many_quanta_as_it_counts() -> None:
    counted_e, gain_e_per_dn = 5000.0, 5.0
    level_dn = counted_e / gain_e_per_dn
    shot = NoisePower(variance_dn2=counted_e / gain_e_per_dn**2)
    ideal = SignalAndNoise(transfer=lambda fx, fy: np.ones_like(fx + fy), noise=shot,
                           signal_dn=level_dn)  # fmt: skip
    freq = np.array([0.0, 0.2, 0.5])
    assert ideal.neq(freq, 0 * freq) == pytest.approx(np.full(3, counted_e))
    blurred = SignalAndNoise(transfer=gaussian, noise=shot, signal_dn=level_dn)
    expected = counted_e * np.exp(-4 * pi**2 * SIGMA_PX**2 * freq**2)
    assert blurred.neq(freq, 0 * freq) == pytest.approx(expected)


def test_a_gaussian_spot_is_seen_as_its_closed_form_says() -> None:
    spot_px = 1.7
    energy = pi * spot_px**4 / (spot_px**2 + SIGMA_PX**2)
    expected = 0.1 * 200.0 / 5.0 * sqrt(energy)
    found = ideal_observer_snr(camera(), GaussianSpot(sigma_px=spot_px), contrast=0.1)
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("diameter_px", [0.7, 3.0, 11.0, 40.0])
def test_a_disc_is_seen_as_its_closed_form_says(diameter_px: float) -> None:
    # Watson, Theory of Bessel functions, 13.31: the integral of J1(a r)^2 exp(-p^2 a^2) / a.
    radius = diameter_px / 2
    ratio = radius**2 / (2 * SIGMA_PX**2)
    energy = pi * radius**2 * (1 - (i0e(ratio) + i1e(ratio)))
    found = ideal_observer_snr(camera(), Disc(diameter_px=diameter_px))
    assert found == pytest.approx(200.0 / 5.0 * sqrt(energy), rel=1e-5)


@pytest.mark.parametrize(("width_px", "length_px"), [(1.0, 1.0), (2.0, 25.0), (0.4, 60.0)])
def test_a_bar_is_seen_as_its_closed_form_says(width_px: float, length_px: float) -> None:
    def passed(size: float) -> float:
        ratio = size / (2 * SIGMA_PX)
        return size * erf(ratio) - 2 * SIGMA_PX / sqrt(pi) * (1 - exp(-(ratio**2)))

    expected = 200.0 / 5.0 * sqrt(passed(width_px) * passed(length_px))
    found = ideal_observer_snr(camera(), Bar(width_px=width_px, length_px=length_px))
    assert found == pytest.approx(expected, rel=1e-5)


def test_an_edge_is_located_as_well_as_its_closed_form_says() -> None:
    # The information of 1 px of it is contrast^2 S^2 / N times the energy of the line spread.
    energy = 1 / (2 * SIGMA_PX * sqrt(pi))
    expected = 1 / (0.5 * 200.0 / 5.0 * sqrt(80.0 * energy))
    assert edge_location_err_px(camera(), 0.5, 80.0) == pytest.approx(expected, rel=1e-6)


def test_a_small_shift_of_an_edge_is_seen_by_the_error_of_its_place() -> None:
    shift_px = 0.01
    found = edge_shift_snr(camera(), 0.5, 80.0, shift_px)
    assert found == pytest.approx(shift_px / edge_location_err_px(camera(), 0.5, 80.0), rel=1e-4)


@given(st.floats(0.2, 30.0), st.floats(1.1, 5.0))
def test_a_brighter_or_quieter_camera_sees_more_in_proportion(size: float, factor: float) -> None:
    disc = Disc(diameter_px=size)
    plain = ideal_observer_snr(camera(), disc)
    assert ideal_observer_snr(camera(signal_dn=200 * factor), disc) == pytest.approx(plain * factor)
    assert ideal_observer_snr(camera(noise_dn=5 / factor), disc) == pytest.approx(plain * factor)


def test_the_mean_over_places_on_the_grid_is_what_pixels_show() -> None:
    # Aliased frequencies count: a spot sampled at points, whose energy is summed by hand.
    spot_px = 0.35
    narrow = SignalAndNoise(transfer=lambda fx, fy: np.ones_like(fx + fy),
                            noise=NoisePower(variance_dn2=1.0), signal_dn=1.0)  # fmt: skip
    y, x = np.mgrid[-6:7, -6:7]
    energies = []
    for dy, dx in product((np.arange(20) + 0.5) / 20 - 0.5, repeat=2):
        spot = np.exp(-((y - dy) ** 2 + (x - dx) ** 2) / (2 * spot_px**2))
        energies.append(float(np.sum(spot**2)))
    found = ideal_observer_snr(narrow, GaussianSpot(sigma_px=spot_px))
    assert found**2 == pytest.approx(np.mean(energies), rel=1e-5)
