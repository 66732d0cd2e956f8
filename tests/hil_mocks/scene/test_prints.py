import numpy as np
import pytest
from numpy.typing import NDArray

from hil_mocks.truth._images import PeriodicImage
from hil_mocks.truth.scenes import GRAIN_PITCH_MM, PHOTOGRAPHS, photograph, print_photograph

ROWS, COLS = 24, 40


def wave(cols: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Four periods across, three down: exactly what a periodic image can hold."""
    return np.asarray(np.cos(2 * np.pi * (4 * cols / COLS + 3 * rows / ROWS) + 0.3))


def wave_image(own_sigma: float = 0.0) -> PeriodicImage:
    rows, cols = np.indices((ROWS, COLS), dtype=np.float64)
    return PeriodicImage(wave(cols, rows).astype(np.float32), own_sigma)


@pytest.mark.parametrize("sigma", [0.3, 0.8, 2.0])
def test_a_wave_between_its_samples_has_the_amplitude_that_a_gaussian_leaves(sigma: float) -> None:
    cols, rows = np.random.default_rng(2).uniform(-90, 90, size=(2, 500))
    amplitude = np.exp(-2 * np.pi**2 * sigma**2 * ((4 / COLS) ** 2 + (3 / ROWS) ** 2))
    # The cubic spline's own error, (f / (1 - f))^4 of what the blur leaves, measured 2.1e-4.
    np.testing.assert_allclose(
        wave_image().blurred(cols, rows, sigma), amplitude * wave(cols, rows), atol=3e-4
    )


def test_an_images_own_blur_adds_to_that_of_the_camera_in_squares() -> None:
    cols, rows = np.random.default_rng(2).uniform(0, 20, size=(2, 50))
    np.testing.assert_allclose(
        wave_image(own_sigma=0.6).blurred(cols, rows, 0.8),
        wave_image().blurred(cols, rows, 1.0),
        atol=1e-6,
    )


def test_the_highest_frequency_keeps_its_sign_and_size_at_its_samples() -> None:
    rows, cols = np.indices((8, 8))
    checks = np.where((rows + cols) % 2, -1.0, 1.0).astype(np.float32)
    read = PeriodicImage(checks).blurred(cols.astype(np.float64), rows.astype(np.float64), 1e-9)
    np.testing.assert_allclose(read, checks, atol=1e-5)


def test_photographs_are_read_from_the_wheel_as_luma() -> None:
    for name in PHOTOGRAPHS:
        picture = photograph(name)
        assert picture.ndim == 2
        assert 0 <= picture.min() < picture.max() <= 1


def test_a_print_shows_its_photograph_upright_and_centred() -> None:
    # Away from the middle of both axes, so that a flip or a transposition would be seen.
    picture = photograph("camera")
    rows, cols = np.arange(60, 440, 20), np.arange(100, 500, 20)
    pitch_mm = 164 / 512
    x_mm, y_mm = np.meshgrid((cols - 255.5) * pitch_mm, (rows - 255.5) * pitch_mm)
    seen = print_photograph("camera").reflectance(x_mm, y_mm, 0.5 * pitch_mm)
    correlation = np.corrcoef(seen.ravel(), picture[np.ix_(rows, cols)].ravel())[0, 1]
    assert correlation > 0.97  # the grain and the blur take the rest


@pytest.mark.slow
def test_a_print_holds_detail_beyond_the_camera() -> None:
    # At 200 mm a pixel is 0.207 mm: its Nyquist frequency is a period of 0.415 mm.
    x_mm = np.arange(2048.0) * (GRAIN_PITCH_MM / 2)
    line = print_photograph("brick").reflectance(x_mm, np.zeros(2048), 0.0)
    power = np.abs(np.fft.rfft((line - line.mean()) * np.hanning(line.size))) ** 2
    freq_cy_per_mm = np.fft.rfftfreq(line.size, GRAIN_PITCH_MM / 2)
    beyond = power[freq_cy_per_mm > 1 / 0.415].sum() / power[freq_cy_per_mm > 0.1].sum()
    assert beyond > 0.02
