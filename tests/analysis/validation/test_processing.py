import numpy as np
import pytest

from analysis.validation.metrics import (
    crop_centre_half,
    normalise,
    process_for_comparison,
    subtract_background,
)


def test_normalising_stretches_the_own_extremes_to_0_and_255() -> None:
    np.testing.assert_allclose(normalise(np.array([[2.0, 4.0, 12.0]])), [[0.0, 51.0, 255.0]])


def test_normalising_undoes_gain_and_offset() -> None:
    image = np.random.default_rng(1).uniform(0, 50, (20, 30))
    np.testing.assert_allclose(normalise(image), normalise(3.7 * image + 11), atol=1e-10)


@pytest.mark.parametrize("value", [5.0, np.nan, np.inf])
def test_a_constant_or_infinite_image_cannot_be_normalised(value: float) -> None:
    with pytest.raises(ValueError):
        normalise(np.full((4, 4), value))


def test_a_constant_and_a_ramp_are_all_background() -> None:
    rows, cols = np.ogrid[:200, :220]
    background = subtract_background(7.0 + 0.5 * rows - 0.25 * cols)
    np.testing.assert_allclose(background[60:-60, 60:-60], 0, atol=1e-9)


def test_a_blob_loses_the_closed_form_share_of_its_peak() -> None:
    # A Gaussian of sigma s keeps s^2 / (s^2 + 10^2) of its peak under the background blur.
    y, x = np.ogrid[-100:101, -100:101]
    blob = np.exp(-(x**2 + y**2) / (2 * 5.0**2))
    remaining = subtract_background(blob)[100, 100]
    assert remaining == pytest.approx(1 - 25 / 125, abs=2e-4)  # the filter is cut at 4 sigma


def test_the_centre_half_of_an_odd_sized_image() -> None:
    rows, cols = np.mgrid[:10, :15].astype(float)
    np.testing.assert_array_equal(crop_centre_half(rows)[:, 0], [2, 3, 4, 5, 6])
    np.testing.assert_array_equal(crop_centre_half(cols)[0], [3, 4, 5, 6, 7, 8, 9])


def test_processing_is_the_three_steps_in_order() -> None:
    image = np.random.default_rng(2).uniform(0, 4095, (40, 60)).astype(np.uint16)
    processed = process_for_comparison(image)
    assert processed.shape == (20, 30)
    np.testing.assert_array_equal(
        processed, crop_centre_half(subtract_background(normalise(image)))
    )
