from typing import Any

import numpy as np
import pytest
import skimage.data

from analysis.screen import linear_to_srgb, on_screen, white_level_dn
from standoff.photographs.encoding import SRGB

astronaut: Any = skimage.data.astronaut  # it states no types


def test_a_file_of_srgb_is_shown_as_it_is() -> None:
    stored = astronaut()
    shown = on_screen(SRGB.decode(stored, 255.0), 255.0)
    np.testing.assert_allclose(255 * shown, stored, atol=0.01)
    # Its brightest pixels are white already: the stretch leaves it as a viewer shows it.
    assert white_level_dn(SRGB.decode(stored, 255.0)) == pytest.approx(255.0, rel=0.01)


def test_one_white_for_all_channels_keeps_their_ratios() -> None:
    # Worked example: twice the light of all channels is the same picture.
    dark = np.random.default_rng(0).uniform(0, 50, (40, 50, 3)) * (1.0, 0.5, 0.2)
    pictures = [on_screen(levels, white_level_dn(levels)) for levels in (dark, 2 * dark)]
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-12)
    red, _, blue = on_screen(np.array([[[50.0, 25.0, 10.0]]]), 50.0)[0, 0]
    assert (red, blue) == pytest.approx((1.0, 1.055 * 0.2 ** (1 / 2.4) - 0.055), rel=1e-12)


def test_the_curve_is_that_of_the_standard() -> None:
    # IEC 61966-2-1: a linear share of 0.0031308 is 0.04045, 18 % is 0.4614.
    values = linear_to_srgb(np.array([0.0, 0.0031308, 0.18, 1.0]))
    np.testing.assert_allclose(values, [0.0, 0.04045, 0.4614, 1.0], atol=1e-4)
