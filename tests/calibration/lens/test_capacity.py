"""Quanta, detection and information from calibrations, against the camera that was simulated."""

from math import erf, exp, pi, sqrt

import numpy as np
import pytest
from scipy.special import i0e, i1e

from calibration.edges import EdgeMeasurement
from calibration.lens import capacity_figures
from tests.calibration.known import known
from tests.calibration.lens.camera import (
    BLACK_DN,
    BRIGHT_DN,
    DARK_DN,
    NOISE,
    SATURATION_DN,
    SIGMA_PX,
    calibrated,
    variance_dn2,
)

LIGHT_DN = BRIGHT_DN - BLACK_DN
NOISE_DN = float(np.sqrt(variance_dn2(BRIGHT_DN)))


def disc_snr(diameter_px: float) -> float:
    ratio = (diameter_px / 2) ** 2 / (2 * SIGMA_PX**2)
    energy = pi * (diameter_px / 2) ** 2 * (1 - (i0e(ratio) + i1e(ratio)))
    return 0.1 * LIGHT_DN / NOISE_DN * sqrt(float(energy))


def test_quanta_are_those_of_the_camera() -> None:
    found, remarks = capacity_figures(calibrated(), NOISE)
    figures = known(found)
    assert remarks == ()
    assert figures.noise_from == "darks and flats"
    assert figures.level_dn == pytest.approx(LIGHT_DN, rel=1e-3)
    assert figures.noise_dn == pytest.approx(NOISE_DN, rel=1e-3)
    freq = np.array(figures.freq_cy_per_px)
    truth = (LIGHT_DN / NOISE_DN) ** 2 * np.exp(-4 * pi**2 * SIGMA_PX**2 * freq**2)
    assert figures.neq[:30] == pytest.approx(truth[:30].tolist(), rel=0.03)
    away = np.abs(np.array(figures.neq) - truth)[1:30]
    assert np.mean(away < 3 * np.array(figures.neq_err)[1:30]) > 0.9


def test_objects_are_seen_as_closed_forms_say() -> None:
    figures = known(capacity_figures(calibrated(), NOISE)[0])
    by_name = {one.description: one for one in figures.detection}
    for diameter_px in (2.0, 5.0, 10.0):
        disc = by_name[f"disc of {diameter_px:g} px"]
        assert disc.snr.value == pytest.approx(disc_snr(diameter_px), rel=0.01)
        assert disc.threshold_contrast * disc.snr.value == pytest.approx(0.5)
    energy = 1.0
    for size in (1.0, 10.0):
        ratio = size / (2 * SIGMA_PX)
        energy *= size * erf(ratio) - 2 * SIGMA_PX / sqrt(pi) * (1 - exp(-(ratio**2)))
    bar = 0.1 * LIGHT_DN / NOISE_DN * sqrt(energy)
    assert by_name["bar of 1 by 10 px"].snr.value == pytest.approx(bar, rel=0.01)
    place_px = 1 / (0.1 * LIGHT_DN / NOISE_DN * sqrt(100 / (2 * SIGMA_PX * sqrt(pi))))
    assert figures.edge_location_err_px == pytest.approx(place_px, rel=0.01)


def test_information_is_that_of_the_levels_and_more_for_all_of_them() -> None:
    figures = known(capacity_figures(calibrated(), NOISE)[0])
    freq = np.linspace(-0.5, 0.5, 401)
    passed = np.exp(-4 * pi**2 * SIGMA_PX**2 * (freq**2 + freq[:, None] ** 2))

    def bits(range_dn: float, variance: float) -> float:
        return 0.5 * float(np.mean(np.log2(1 + range_dn**2 / 12 * passed / variance)))

    assert figures.bits_per_px.value == pytest.approx(
        bits(BRIGHT_DN - DARK_DN, NOISE_DN**2), rel=0.01
    )
    whole_dn = SATURATION_DN - BLACK_DN
    middle = float(variance_dn2(BLACK_DN + whole_dn / 2))
    assert known(figures.most_bits_per_px) == pytest.approx(bits(whole_dn, middle), rel=0.01)


def test_without_a_calibration_the_noise_is_that_around_the_edges() -> None:
    found, remarks = capacity_figures(calibrated(), None)
    figures = known(found)
    assert figures.noise_from == "the pixels around the edges"
    both = float(np.sqrt(variance_dn2(np.array([DARK_DN, BRIGHT_DN])).mean()))
    assert figures.noise_dn == pytest.approx(both, rel=0.05)
    assert any("black level unknown" in one for one in remarks)
    assert figures.most_bits_per_px is None


def test_noise_that_is_not_the_photographs_is_not_taken_for_it() -> None:
    found, remarks = capacity_figures(calibrated(noise=0.4), NOISE)
    figures = known(found)
    assert figures.noise_from == "the pixels around the edges"
    assert figures.noise_dn < 0.5 * NOISE_DN
    assert any("is not that of the darks and flats" in one for one in remarks)


def test_edges_of_one_direction_are_those_of_a_round_lens() -> None:
    psf = calibrated()
    one = psf.model_copy(
        update={
            "transfer_2d": None,
            "sigma_y_px": None,
            "covariance_px2": None,
            "edges": tuple(edge for edge in psf.edges if edge.orientation == "vertical"),
        }
    )
    found, remarks = capacity_figures(one, NOISE)
    figures = known(found)
    assert figures.is_round
    assert any("taken as round" in remark for remark in remarks)
    assert figures.detection[1].snr.value == pytest.approx(disc_snr(5.0), rel=0.02)


def test_without_noise_there_are_no_quanta() -> None:
    psf = calibrated()
    silent = [edge.model_copy(update={"snr": None}) for edge in psf.edges]
    found, remarks = capacity_figures(psf.model_copy(update={"edges": tuple(silent)}), None)
    assert found is None
    assert remarks == ("no noise-equivalent quanta: the photographs show no noise",)
    no_edges: tuple[EdgeMeasurement, ...] = ()
    assert capacity_figures(psf.model_copy(update={"edges": no_edges}), NOISE)[0] is None
