from collections.abc import Callable

import numpy as np
import pytest

from simulation.followup import exposed, unsharp_masked, vignetted

IMAGE = np.random.default_rng(2).uniform(100.0, 900.0, (31, 44))


def test_exposure_scales_the_light_above_the_black_level() -> None:
    brighter = exposed(IMAGE, 1.5, black_level_dn=64.0)
    np.testing.assert_allclose(brighter - 64.0, 1.5 * (IMAGE - 64.0))
    np.testing.assert_allclose(exposed(IMAGE, 1.0, 64.0), IMAGE)


def test_vignetting_takes_its_share_at_the_corners_and_nothing_at_the_centre() -> None:
    flat = np.full((31, 45), 1000.0)
    dim = vignetted(flat, 0.3)
    for corner in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        assert dim[corner] == pytest.approx(700.0)
    assert dim[15, 22] == pytest.approx(1000.0)
    # Half-way to the corner: cos^4 with tan^2 a quarter of the corner's (0.7^-0.5 - 1).
    flat_odd = np.full((41, 61), 1000.0)
    expected = 1000.0 * (1 + (0.7**-0.5 - 1) / 4) ** -2
    assert vignetted(flat_odd, 0.3)[10, 15] == pytest.approx(expected)


def test_vignetting_leaves_the_black_level_and_colour_alone() -> None:
    black = np.full((9, 11, 3), 64.0)
    np.testing.assert_allclose(vignetted(black, 0.5, black_level_dn=64.0), 64.0)


@pytest.mark.parametrize("frequency", [0.05, 0.2, 0.4])
def test_sharpening_lifts_a_wave_by_its_closed_form(frequency: float) -> None:
    x = np.arange(400)
    wave = np.tile(np.cos(2 * np.pi * frequency * x), (9, 1))
    amount, sigma = 0.8, 1.2
    # The blur leaves exp(-2 pi^2 sigma^2 f^2); scipy's sampled Gaussian is good to 1e-3 here.
    gain = 1 + amount * (1 - np.exp(-2 * (np.pi * sigma * frequency) ** 2))
    sharp = unsharp_masked(wave, amount, sigma)
    np.testing.assert_allclose(sharp[:, 50:-50], gain * wave[:, 50:-50], atol=2e-3)


def test_no_sharpening_changes_nothing_and_the_dtype_stays() -> None:
    image = IMAGE.astype(np.float32)
    np.testing.assert_array_equal(unsharp_masked(image, 0.0, 1.0), image)
    for result in (unsharp_masked(image, 1.0, 1.0), vignetted(image, 0.1), exposed(image, 2.0)):
        assert result.dtype == np.float32


@pytest.mark.parametrize(
    "call",
    [
        lambda: exposed(IMAGE, -1.0),
        lambda: vignetted(IMAGE, 1.0),
        lambda: unsharp_masked(IMAGE, -0.1, 1.0),
        lambda: unsharp_masked(IMAGE, 1.0, 0.0),
        lambda: unsharp_masked(IMAGE, float("nan"), 1.0),
    ],
)
def test_impossible_options_are_refused(call: Callable[[], object]) -> None:
    with pytest.raises(ValueError):
        call()
