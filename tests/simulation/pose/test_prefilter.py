"""The kernels that pixels of a pose are sampled with, and their weights."""

import numpy as np
import pytest

from simulation.arrays import FloatArray
from simulation.pose._prefilter import LEAST_COPIES, QUINTIC_SPLINE, SamplingKernel
from simulation.pose.simulate import weight_table

KERNELS = [QUINTIC_SPLINE, LEAST_COPIES]


def value(kernel: SamplingKernel, x: FloatArray) -> FloatArray:
    distance = np.abs(x)
    piece = np.minimum(distance.astype(int), 2)
    powers = (distance - piece)[:, None] ** np.arange(6)
    return np.where(distance <= 3, (np.array(kernel.pieces)[piece] * powers).sum(axis=1), 0.0)


def copies(kernel: SamplingKernel, freq: FloatArray) -> FloatArray:
    """Amplitude of all copies over that of the band."""
    orders = np.arange(1, 6.0)[:, None]
    around = np.concatenate([kernel.transfer(freq + orders), kernel.transfer(freq - orders)])
    return np.asarray(np.sqrt((around**2).sum(axis=0)) / np.abs(kernel.transfer(freq)))


@pytest.mark.parametrize("kernel", KERNELS)
def test_constants_and_ramps_are_reproduced(kernel: SamplingKernel) -> None:
    t = np.linspace(0, 1, 51)
    offsets = np.arange(-2, 4)
    weights = np.stack([value(kernel, t - offset) for offset in offsets])
    # Rounding of coefficients written with 15 digits.
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, rtol=0, atol=1e-13)
    np.testing.assert_allclose(offsets @ weights, t, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kernel", KERNELS)
def test_value_and_slope_are_continuous_and_end_at_zero(kernel: SamplingKernel) -> None:
    pieces = np.array(kernel.pieces)
    ends, starts = pieces.sum(axis=1), np.append(pieces[1:, 0], 0.0)
    np.testing.assert_allclose(ends, starts, rtol=0, atol=1e-13)
    slopes, first = pieces @ np.arange(6), np.append(pieces[1:, 1], 0.0)
    np.testing.assert_allclose(slopes, first, rtol=0, atol=1e-13)
    assert pieces[0, 1] == 0


def test_the_quintic_spline_has_its_closed_form() -> None:
    freq = np.linspace(0, 4, 81)
    np.testing.assert_allclose(QUINTIC_SPLINE.transfer(freq), np.sinc(freq) ** 6, atol=1e-14)
    sampled = (66 + 52 * np.cos(2 * np.pi * freq) + 2 * np.cos(4 * np.pi * freq)) / 120
    np.testing.assert_allclose(QUINTIC_SPLINE.transfer_at_pixels(freq), sampled, atol=1e-14)


@pytest.mark.parametrize("kernel", KERNELS)
def test_values_at_the_pixels_have_the_sum_of_all_copies(kernel: SamplingKernel) -> None:
    freq = np.linspace(-0.5, 0.5, 41)
    orders = np.arange(-6, 7.0)[:, None]
    # The copies beyond fall with the cube of the frequency: 3e-5 together.
    summed = kernel.transfer(freq + orders).sum(axis=0)
    np.testing.assert_allclose(kernel.transfer_at_pixels(freq), summed, rtol=0, atol=1e-4)


def test_copies_are_less_than_the_splines_wherever_those_are_large() -> None:
    freq = np.array([0.2, 0.25, 0.3, 0.35, 0.4, 0.45])
    # Measured: 27, 62, 21, 5.8, 2.8 and 1.6 times less.
    gain = copies(QUINTIC_SPLINE, freq) / copies(LEAST_COPIES, freq)
    assert (gain > [20, 50, 15, 5, 2.5, 1.5]).all()
    # Below that they are at most 1e-5 of the band.
    assert copies(LEAST_COPIES, np.linspace(0.01, 0.2, 30)).max() < 1.2e-5


@pytest.mark.parametrize("kernel", KERNELS)
def test_weights_are_the_kernel_at_the_distances_of_six_pixels(kernel: SamplingKernel) -> None:
    part = np.linspace(0, 1, 11)
    weights = part[:, None] ** np.arange(6) @ weight_table(np.array(kernel.pieces))
    distances = np.abs(part[:, None] - np.arange(-2, 4))
    piece = np.minimum(distances.astype(int), 2)
    powers = (distances - piece)[..., None] ** np.arange(6)
    expected = (np.array(kernel.pieces)[piece] * powers).sum(axis=-1)
    # Rounding of coefficients written with 15 digits, where two pieces meet.
    np.testing.assert_allclose(weights[:, :6], expected, rtol=0, atol=1e-13)
    assert not weights[:, 6:].any()
