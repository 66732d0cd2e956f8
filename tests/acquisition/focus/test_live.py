import numpy as np
import pytest

from acquisition.focus.live import FocusMeter, FocusOptions
from acquisition.focus.measures import Region, focus_value

BLACK_DN = 64.0


def noisy(
    rng: np.random.Generator, sigma_dn: float
) -> np.ndarray[tuple[int, int], np.dtype[np.uint16]]:
    """A vertical edge of 400 and 2000 DN with white noise."""
    clean = np.where(np.arange(200) < 100, 400.0, 2000.0) * np.ones((160, 1))
    return np.rint(clean + sigma_dn * rng.standard_normal(clean.shape)).astype(np.uint16)


def test_the_first_frame_gives_no_value_as_its_noise_is_not_known() -> None:
    meter = FocusMeter(FocusOptions())
    frame = noisy(np.random.default_rng(1), 20.0)
    assert meter.add(frame, BLACK_DN) is None
    assert meter.add(frame, BLACK_DN) is not None


def test_the_noise_of_single_frames_is_taken_out() -> None:
    rng = np.random.default_rng(2)
    clean = focus_value(noisy(rng, 0.0), black_level_dn=BLACK_DN)
    meter = FocusMeter(FocusOptions())
    values = [meter.add(noisy(rng, 20.0), BLACK_DN) for _ in range(9)]
    raw = focus_value(noisy(rng, 20.0), black_level_dn=BLACK_DN)
    # 4 v / mean((I - b)^2) is 1600 / 1.9e6 = 8e-4 of noise in 6.7e-3; 32 000 px leave 1 % of it.
    assert raw == pytest.approx(clean + 4 * 400 / 1.93e6, rel=0.02)
    assert values[-1] == pytest.approx(clean, rel=0.01)


def test_a_known_noise_is_used_from_the_first_frame_on() -> None:
    meter = FocusMeter(FocusOptions(noise=lambda level_dn: 400.0))
    frame = noisy(np.random.default_rng(3), 20.0)
    expected = focus_value(frame, black_level_dn=BLACK_DN, noise_variance_dn2=400.0)
    assert meter.add(frame, BLACK_DN) == expected


def test_only_the_region_is_looked_at() -> None:
    flat = Region(x_px=10, y_px=20, width_px=60, height_px=50)
    meter = FocusMeter(FocusOptions(region=flat, noise=lambda level_dn: 0.0))
    assert meter.add(noisy(np.random.default_rng(4), 0.0), BLACK_DN) == 0.0


def test_frames_that_change_their_size_are_refused() -> None:
    meter = FocusMeter(FocusOptions())
    frame = noisy(np.random.default_rng(5), 1.0)
    meter.add(frame, BLACK_DN)
    with pytest.raises(ValueError):
        meter.add(frame[:-2], BLACK_DN)
