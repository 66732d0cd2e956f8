import numpy as np
import pytest

from calibration.edge_fit.shading import Shading, is_even, slopes_across
from calibration.edge_search import EdgeLine
from simulation.arrays import FloatArray

DARK_DN, BRIGHT_DN = 8_000.0, 52_000.0
ROWS, COLS = 120, 160


def shading(image: FloatArray, x_px: float, normal_deg: float) -> Shading:
    """Of an edge of 80 px, from 11 px beside it on."""
    line = EdgeLine(x_px, 0.5 * ROWS, float(np.deg2rad(normal_deg)), 40.0)
    return slopes_across(image.astype(np.float32), line, 11.0, np.inf, BRIGHT_DN - DARK_DN)


def step(x_px: float, normal_deg: float) -> FloatArray:
    """Two even levels that meet at a line through (x_px, half of the rows)."""
    y, x = np.mgrid[:ROWS, :COLS] - np.array([0.5 * ROWS, x_px])[:, None, None]
    normal = np.deg2rad(normal_deg)
    is_bright = np.cos(normal) * x + np.sin(normal) * y > 0
    return np.asarray(np.where(is_bright, BRIGHT_DN, DARK_DN))


@pytest.mark.parametrize("normal_deg", [0.0, 0.5, 1.0, -0.5])
def test_even_levels_have_no_shading_wherever_the_frame_cuts_what_lies_beside(
    normal_deg: float,
) -> None:
    # To a single column of the far zone, and to one of the near one.
    for to_frame_px in np.arange(11.0, 46.0, 0.37).tolist():
        x_px = COLS - 1 - to_frame_px
        assert is_even(shading(step(x_px, normal_deg), x_px, normal_deg)), to_frame_px


def test_a_slope_is_found_where_most_of_the_far_zone_is_within_the_frame() -> None:
    slope_dn_per_px = 20.0
    x_px = COLS - 1 - 38.0  # the far zone begins 27 px from the edge
    image = step(x_px, 0.0)
    image[:, int(x_px) + 1 :] += slope_dn_per_px * (np.arange(int(x_px) + 1, COLS) - x_px)
    noise = np.random.default_rng(1).normal(0, 1.0, image.shape)
    # 1 DN over 11 columns of 20 pixels and more, and a clean dark side.
    found = shading(image + noise, x_px, 0.0)
    assert found.bright == pytest.approx(slope_dn_per_px, abs=0.1)
    assert found.dark == 0.0
