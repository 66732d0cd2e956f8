"""d' by noise-equivalent quanta is d' by operators on pixels, for lenses of any shape."""

import pytest

from benchmarks.studies.quanta import hotelling, predicted
from simulation.psf import GaussianPsf, LensOtf, MeasuredPsf, Psf

ROUND = MeasuredPsf(
    lens=LensOtf(cut_off_period_px=(0.55, 0.0, 0.55), gaussian_px2=(0.1, 0.0, 0.1)),
    gaussian=GaussianPsf(sigma_px=0.6),
)
ELLIPTIC = MeasuredPsf(
    lens=LensOtf(cut_off_period_px=(0.5, 0.1, 0.4), gaussian_px2=(0.2, 0.03, 0.1)),
    gaussian=GaussianPsf(sigma_px=0.7),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "psf", [GaussianPsf(sigma_x_px=0.7, sigma_y_px=0.5, rho=0.3), ROUND, ELLIPTIC]
)
def test_quanta_predict_hotellings_d_prime_at_zoom_1(psf: Psf) -> None:
    by_quanta, by_pixels = predicted(psf.otf, 3.0), hotelling(psf, 3.0, "lmmse")
    assert by_quanta == pytest.approx(by_pixels, rel=2e-3)


def test_twice_the_noise_halves_it() -> None:
    lens = GaussianPsf(sigma_px=0.7).otf
    assert predicted(lens, 6.0) == pytest.approx(0.5 * predicted(lens, 3.0))
