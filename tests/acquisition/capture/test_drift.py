import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy.special import ndtr

from acquisition.capture.quality import drift_between

BLACK_DN = 64.0


def spot(x_px: float, y_px: float, light: float = 1.0) -> NDArray[np.float64]:
    rows, cols = np.indices((50, 70))
    squared = (cols - 41 - x_px) ** 2 + (rows - 19 - y_px) ** 2
    return BLACK_DN + light * (300 + 2000 * np.exp(-squared / (2 * 4.0**2)))


@settings(max_examples=40, deadline=None)
@given(x_px=st.floats(-0.5, 0.5), y_px=st.floats(-0.5, 0.5), light=st.floats(0.8, 1.25))
def test_shift_and_change_of_light_are_found_apart(x_px: float, y_px: float, light: float) -> None:
    drift = drift_between(spot(0, 0), spot(x_px, y_px, light), black_level_dn=BLACK_DN)
    assert drift.level == pytest.approx(light - 1, abs=0.01)
    assert drift.shift_x_px == pytest.approx(x_px, abs=0.02)
    assert drift.shift_y_px == pytest.approx(y_px, abs=0.02)


def test_along_an_edge_nothing_is_claimed() -> None:
    def edge(shift_px: float) -> NDArray[np.float64]:
        return np.tile(BLACK_DN + 2000 * ndtr((np.arange(80) - 40 - shift_px) / 1.5), (30, 1))

    drift = drift_between(edge(0.0), edge(0.3), black_level_dn=BLACK_DN)
    assert drift.shift_x_px == pytest.approx(0.3, rel=0.1)
    assert drift.shift_y_px == pytest.approx(0.0, abs=1e-6)


def test_a_drift_that_matters_says_what_to_do() -> None:
    still = drift_between(spot(0, 0), spot(0, 0), black_level_dn=BLACK_DN)
    assert not still.is_notable
    assert "warm up" not in still.text
    moved = drift_between(spot(0, 0), spot(0.3, 0, 0.97), black_level_dn=BLACK_DN)
    assert moved.is_notable
    assert "-3.0" in moved.text or "-2.9" in moved.text
    assert "warm up" in moved.text


@pytest.mark.parametrize("level_dn", [0.0, BLACK_DN, 900.0])
def test_pictures_without_structure_have_no_shift(level_dn: float) -> None:
    flat = np.full((9, 9), level_dn)
    drift = drift_between(flat, flat, black_level_dn=BLACK_DN)
    assert (drift.level, drift.shift_px) == (0.0, 0.0)


def test_pictures_of_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError):
        drift_between(np.zeros((3, 4)), np.zeros((4, 3)), black_level_dn=0)
