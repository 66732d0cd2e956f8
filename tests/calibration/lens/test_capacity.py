"""Quanta, detection and information from calibrations, against the camera that was simulated."""

from math import erf, exp, pi, sqrt

import numpy as np
import pytest
from scipy.special import i0e, i1e

from acquisition.files import Provenance
from calibration.edges import EdgeMeasurement
from calibration.lens import capacity_figures
from calibration.noise import NoiseCalibration
from calibration.psf import PsfCalibration
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
    assert figures.level_of == "the bright side of the edges"
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

    # Shot noise is linear in the level: its mean over both sides is that of the middle.
    mean_dn2 = float(variance_dn2(0.5 * (DARK_DN + BRIGHT_DN)))
    assert figures.bits_per_px.value == pytest.approx(bits(BRIGHT_DN - DARK_DN, mean_dn2), rel=2e-3)
    whole_dn = SATURATION_DN - BLACK_DN
    middle = float(variance_dn2(BLACK_DN + whole_dn / 2))
    assert known(figures.most_bits_per_px) == pytest.approx(bits(whole_dn, middle), rel=0.01)


@pytest.mark.parametrize("noise", [NOISE, None])
def test_the_disc_of_frequencies_carries_less_than_the_square(
    noise: NoiseCalibration | None,
) -> None:
    figures = known(capacity_figures(calibrated(), noise)[0])
    disc, square = known(figures.edge_bits_per_px).value, figures.bits_per_px.value
    assert 0.7 * square < disc < square


def test_without_a_calibration_signal_and_noise_are_those_of_the_middle_of_the_levels() -> None:
    found, remarks = capacity_figures(calibrated(), None)
    figures = known(found)
    assert figures.noise_from == "the pixels around the edges"
    assert figures.level_of == "the mean of both sides of the edges"
    middle_dn = 0.5 * (DARK_DN + BRIGHT_DN)
    variance = float(variance_dn2(middle_dn))
    assert figures.level_dn == pytest.approx(middle_dn, rel=1e-3)  # black is taken as 0
    assert figures.noise_dn == pytest.approx(sqrt(variance), rel=0.03)
    assert figures.neq[0] == pytest.approx(middle_dn**2 / variance, rel=0.06)
    assert any("black level unknown" in one for one in remarks)
    assert figures.most_bits_per_px is None


def test_a_saturation_that_nobody_saw_gives_no_full_range() -> None:
    seen = NOISE.model_copy(update={"saturation_is_reached": True})
    unseen = NOISE.model_copy(update={"saturation_is_reached": False})
    assert known(capacity_figures(calibrated(), seen)[0]).most_bits_per_px is not None
    assert known(capacity_figures(calibrated(), unseen)[0]).most_bits_per_px is None


def as_processed(how: str) -> PsfCalibration:
    psf = calibrated()
    if how == "JPEG":
        flagged = [edge.model_copy(update={"flags": (*edge.flags, "jpeg")}) for edge in psf.edges]
        return psf.model_copy(update={"edges": tuple(flagged)})
    if how == "sharpened":
        return calibrated(amount=0.6)
    origin = Provenance(
        version="1", created="2026-11-28T10:00:00Z", command="", encoding=("linear", "srgb")
    )
    return psf.model_copy(update={"provenance": origin})


@pytest.mark.parametrize("how", ["JPEG", "sharpened", "stored with a tone curve"])
@pytest.mark.parametrize("noise", [NOISE, None])
def test_processed_photographs_have_no_quanta(noise: NoiseCalibration | None, how: str) -> None:
    found, remarks = capacity_figures(as_processed(how), noise)
    assert found is None
    assert remarks[0].startswith(f"no noise-equivalent quanta: the photographs are {how}")


def test_quanta_of_interpolated_colours_are_said_to_be_rough() -> None:
    psf = calibrated()
    coloured = [edge.model_copy(update={"red_shift_px": 0.0}) for edge in psf.edges]
    found, remarks = capacity_figures(psf.model_copy(update={"edges": tuple(coloured)}), NOISE)
    assert found is not None
    assert any("noise that is not white" in one for one in remarks)


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
    assert any("assumed to be round" in remark for remark in remarks)
    assert figures.detection[1].snr.value == pytest.approx(disc_snr(5.0), rel=0.02)


def test_without_noise_there_are_no_quanta() -> None:
    psf = calibrated()
    silent = [edge.model_copy(update={"snr": None}) for edge in psf.edges]
    for noise in (None, NOISE):
        found, remarks = capacity_figures(psf.model_copy(update={"edges": tuple(silent)}), noise)
        assert found is None
        assert remarks == ("no noise-equivalent quanta: the photographs show no noise",)
    no_edges: tuple[EdgeMeasurement, ...] = ()
    assert capacity_figures(psf.model_copy(update={"edges": no_edges}), NOISE)[0] is None
