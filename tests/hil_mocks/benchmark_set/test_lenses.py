"""The lenses' transfer functions beside closed forms and another quadrature."""

from math import cos, exp, pi, radians, sin, sqrt

import numpy as np
import pytest

from benchmarks.truth.lenses import defocused_pupil_otf
from hil_mocks.benchmark_set._lenses import (
    LENSES,
    CircularPupil,
    GaussianLens,
    aberrated,
    contrast,
    falls_to,
)


def test_the_contrast_of_an_astigmatic_gaussian_is_in_closed_form() -> None:
    lens = GaussianLens(sigma_major_px=0.9, sigma_minor_px=0.5, angle_deg=25.0)
    variance = (0.9 * cos(radians(10))) ** 2 + (0.5 * sin(radians(10))) ** 2
    pixel = np.sinc(0.3 * cos(radians(35))) * np.sinc(0.3 * sin(radians(35)))
    expected = exp(-2 * pi**2 * variance * 0.3**2) * pixel
    assert contrast(lens, 0.3, 35.0) == pytest.approx(expected, rel=1e-12)


def test_a_perfect_lens_at_half_of_its_cut_off_passes_two_fifths() -> None:
    lens = CircularPupil(f_number=8.0)
    half = lens.cut_off_cy_per_px / 2
    passed = 2 / pi * (pi / 3 - 0.5 * sqrt(0.75))  # 0.391
    assert contrast(lens, half, 0.0) == pytest.approx(passed * np.sinc(half), rel=1e-12)
    assert lens.cut_off_cy_per_px == pytest.approx(8.3 / (0.55 * 8))


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: str(lens.facts()))
def test_no_frequency_below_the_one_found_has_less_contrast(lens: CircularPupil) -> None:
    found = falls_to(lens, 0.3, 77.0)
    assert contrast(lens, found, 77.0) == pytest.approx(0.3, abs=1e-9)
    for freq in np.linspace(0, found, 50)[:-1]:
        assert contrast(lens, freq, 77.0) > 0.3


def test_a_defocused_pupil_is_that_of_hopkins() -> None:
    """Along one line, by a quadrature of its own: the path is 2 sqrt(3) times Zernike's."""
    v = np.linspace(0, 1, 41)[1:-1]
    lens = aberrated(5.6, defocus=0.25)
    for bearing in (0.0, 1.1):
        freq = v * lens.cut_off_cy_per_px
        found = lens.otf(freq * cos(bearing), freq * sin(bearing))
        assert found == pytest.approx(defocused_pupil_otf(v, 2 * sqrt(3) * 0.25), abs=1e-5)


def test_a_weakly_aberrated_pupil_has_the_strehl_ratio_of_marechal() -> None:
    """The integral of the OTF over that of the perfect one; exp(-s^2) to third order in s^2."""
    waves = (0.01, -0.012, 0.009, 0.011, -0.008, 0.01)
    lens = CircularPupil(f_number=8.0, zernike_waves=waves)
    f = np.linspace(-2, 2, 401)
    fx, fy = np.meshgrid(f, f)
    strehl = lens.otf(fx, fy).sum().real / CircularPupil(f_number=8.0).otf(fx, fy).sum()
    assert strehl == pytest.approx(exp(-((2 * pi) ** 2) * sum(w * w for w in waves)), abs=3e-4)


def test_an_aberrated_pupil_is_its_sum_over_a_fine_grid() -> None:
    """Brute force on 1201 points across the pupil: right to 1e-3, the jagged rim's share."""
    points = np.linspace(-1, 1, 1201)
    x, y = points[None, :], points[:, None]
    r2 = x * x + y * y
    path = 0.1 * sqrt(8) * (3 * r2 - 2) * x + 0.08 * sqrt(6) * 2 * x * y
    pupil = np.where(r2 <= 1, np.exp(2j * pi * path), 0)
    lens = aberrated(8.0, coma2=0.1, astig1=0.08)
    for across, down in ((240, 0), (300, 400), (-250, 610)):
        left, right = max(-across, 0), 1201 - max(across, 0)
        ahead = pupil[down:, left + across : right + across]
        expected = (ahead * pupil[: 1201 - down, left:right].conj()).sum() / np.sum(r2 <= 1)
        fx, fy = (n / 1200 * lens.cut_off_cy_per_px for n in (across, down))
        assert lens.otf(np.array(fx), np.array(fy)) == pytest.approx(expected, abs=1e-3)
