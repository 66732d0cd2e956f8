"""The error of an edge's width, against closed forms and against fits of rendered edges."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import ndtr

from analysis.study import EdgeLevels, sigma_err_px, white_noise_sigma_err_px
from calibration.edges import EdgeImage, measure_edges
from calibration.noise import LevelNoise


def white(noise_dn: float) -> LevelNoise:
    """The same noise at all levels."""
    return LevelNoise(offset_dn2=noise_dn**2, slope_dn=0.0, floor_dn2=noise_dn**2)


def levels(noise: LevelNoise) -> EdgeLevels:
    return EdgeLevels(low_dn=100.0, high_dn=2100.0, frame_noise=noise)


@pytest.mark.parametrize("sigma_px", [0.5, 0.8, 1.5])
def test_white_noise_gives_the_closed_form_within_what_the_levels_cost(sigma_px: float) -> None:
    found = sigma_err_px(sigma_px, 200.0, levels(white(40.0)), 4)
    closed = white_noise_sigma_err_px(sigma_px, 200.0, snr=2000.0 / 20.0)
    # The two levels share the band of 4 sigma and 5 px or so with the rise: some per cent.
    assert closed < found < 1.12 * closed


@given(st.floats(0.4, 4.0), st.floats(20.0, 900.0), st.integers(2, 400))
def test_four_times_the_frames_or_the_length_halve_the_error(
    sigma_px: float, length_px: float, frames: int
) -> None:
    noise = LevelNoise(offset_dn2=5.0, slope_dn=0.2, floor_dn2=2.0)
    once = sigma_err_px(sigma_px, length_px, levels(noise), frames)
    assert sigma_err_px(sigma_px, length_px, levels(noise), 4 * frames) == pytest.approx(once / 2)
    assert sigma_err_px(sigma_px, 4 * length_px, levels(noise), frames) == pytest.approx(once / 2)


@given(st.floats(0.4, 3.0), st.floats(0.5, 80.0))
def test_the_unit_of_the_levels_does_not_matter(sigma_px: float, factor: float) -> None:
    noise = LevelNoise(offset_dn2=30.0, slope_dn=0.3, floor_dn2=4.0)
    scaled = EdgeLevels(
        low_dn=100.0 * factor,
        high_dn=2100.0 * factor,
        frame_noise=LevelNoise(
            offset_dn2=30.0 * factor**2, slope_dn=0.3 * factor, floor_dn2=4.0 * factor**2
        ),
    )
    assert sigma_err_px(sigma_px, 90.0, scaled, 3) == pytest.approx(
        sigma_err_px(sigma_px, 90.0, levels(noise), 3)
    )


def test_levels_that_do_not_rise_are_refused() -> None:
    with pytest.raises(ValueError, match="must rise"):
        EdgeLevels(low_dn=10.0, high_dn=10.0, frame_noise=white(1.0))


def test_an_edge_fit_reports_the_error_that_was_predicted() -> None:
    sigma_px, noise = 0.7, LevelNoise(offset_dn2=-10.0, slope_dn=0.2, floor_dn2=6.0)
    y, x = np.mgrid[-50.0:50.0, -60.0:60.0]
    turn = np.deg2rad(8.0)
    edge = ndtr((x * np.cos(turn) + y * np.sin(turn)) / sigma_px)
    clean = 100.0 + 2000.0 * edge
    drawn = np.random.default_rng(4).normal(size=clean.shape)
    image = clean + drawn * np.sqrt(noise.variance_dn2(clean) / 5)
    photograph = EdgeImage(
        name="edge", image_dn=image, noise=noise.averaged(5), saturation_dn=4095.0
    )
    (found,) = measure_edges(photograph)
    predicted = sigma_err_px(sigma_px, found.length_px, levels(noise), 5)
    # The fit scales its error by the scatter of 2000 pixels, known to 1 / sqrt(4000), 1.6 %.
    assert found.sigma_err_px == pytest.approx(predicted, rel=0.08)
    assert abs(found.sigma_px - sigma_px) < 4 * predicted
