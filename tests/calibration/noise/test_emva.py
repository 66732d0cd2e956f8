"""The data sheet of EMVA 1288 of a camera that is known."""

from math import log2, log10, sqrt

import pytest

from calibration.noise import (
    LevelSample,
    PatternParts,
    Saturation,
    emva_sheet,
    fit_photon_transfer,
)
from tests.calibration.known import known

GAIN_E_PER_DN, READ_E, BLACK_DN, TOP_DN = 4.0, 8.0, 64.0, 4064.0
NONE = PatternParts(total=0.0, rows=0.0, columns=0.0, pixels=0.0)


def sample(kind: str, light_dn: float) -> LevelSample:
    variance = (READ_E / GAIN_E_PER_DN) ** 2 + 1 / 12 + light_dn / GAIN_E_PER_DN
    return LevelSample.model_validate(
        {
            "kind": kind,
            "capture": f"{kind} {light_dn:g}",
            "exposure_us": 21.0 if kind == "dark" else light_dn,
            "mean_dn": BLACK_DN + light_dn,
            "variance_dn2": variance,
            "pixels": 10_000,
            "frames": 10,
        }
    )


SAMPLES = [sample("dark", 0.0), *(sample("flat", light) for light in (500, 1000, 2000, 2600))]


def test_the_sheet_has_the_figures_of_the_camera() -> None:
    transfer = fit_photon_transfer(SAMPLES, Saturation(level_dn=TOP_DN, err_dn=0.3))
    sheet = emva_sheet(transfer, PatternParts(total=2.0, rows=0.5, columns=0.2, pixels=1.9), NONE)
    saturation_e = GAIN_E_PER_DN * (TOP_DN - BLACK_DN)
    assert sheet.system_gain_dn_per_e == pytest.approx(1 / GAIN_E_PER_DN)
    assert sheet.dark_noise_e == pytest.approx(READ_E)
    assert sheet.dark_noise_dn == pytest.approx(sqrt((READ_E / GAIN_E_PER_DN) ** 2 + 1 / 12))
    assert sheet.saturation_e == pytest.approx(saturation_e)
    # SNR = m / sqrt(m + d^2) is 1 at m = (1 + sqrt(1 + 4 d^2)) / 2, d + 1/2 + 1 / (8 d).
    dark_e = sqrt(READ_E**2 + GAIN_E_PER_DN**2 / 12)
    exact = (1 + sqrt(1 + 4 * dark_e**2)) / 2
    assert sheet.threshold_e == pytest.approx(exact, rel=1 / (8 * dark_e**2))
    assert sheet.snr_max_db == pytest.approx(10 * log10(saturation_e))
    assert sheet.dynamic_range_db == pytest.approx(20 * log10(saturation_e / sheet.threshold_e))
    assert sheet.dynamic_range_bits == pytest.approx(log2(saturation_e / sheet.threshold_e))
    assert sheet.dsnu_e.total == pytest.approx(2.0 * GAIN_E_PER_DN)
    assert sheet.linearity_error == pytest.approx(0.0, abs=1e-9)


def test_the_threshold_counts_the_rounding_that_there_was() -> None:
    # Levels of 12 bits in the upper bits of 16 are 16 DN apart: a variance of 16^2 / 12.
    step_dn = 16.0
    samples = [
        one.model_copy(update={"variance_dn2": one.variance_dn2 + (step_dn**2 - 1) / 12})
        for one in SAMPLES
    ]
    saturation = Saturation(level_dn=TOP_DN, err_dn=0.3)
    sheet = emva_sheet(fit_photon_transfer(samples, saturation, step_dn**2 / 12), NONE, NONE)
    assert sheet.dark_noise_e == pytest.approx(READ_E)
    dark_e = sqrt(READ_E**2 + (GAIN_E_PER_DN * step_dn) ** 2 / 12)
    assert sheet.threshold_e == pytest.approx(dark_e + 0.5)


def test_a_saturation_that_nobody_saw_has_no_error_and_says_so() -> None:
    seen, unseen = (
        emva_sheet(
            fit_photon_transfer(SAMPLES, Saturation(level_dn=TOP_DN, err_dn=err)), NONE, NONE
        )
        for err in (0.3, None)
    )
    for sheet, has_err in ((seen, True), (unseen, False)):
        rows = [row for row in sheet.rows() if row.symbol in ("SNR_max", "μ_e.sat", "DR")]
        assert len(rows) == 3
        for row in rows:
            assert (row.err is not None) == has_err
            assert row.name.endswith("from the pixel format") != has_err
        assert ("from the pixel format" in sheet.dynamic_range_text) != has_err
    # d(20 lg x) is 20 / ln 10 of the relative error; the SNR is the root of the saturation.
    relative = known(seen.saturation_err_e) / seen.saturation_e
    assert known(seen.snr_max_err_db) == pytest.approx(4.342945 * relative)


def test_the_rows_are_in_the_standards_order_with_units() -> None:
    transfer = fit_photon_transfer(SAMPLES, Saturation(level_dn=TOP_DN, err_dn=None))
    sheet = emva_sheet(transfer, NONE, PatternParts(total=0.01, rows=0, columns=0, pixels=0.01))
    assert not sheet.is_saturated
    symbols = [row.symbol for row in sheet.rows() if row.symbol]
    assert symbols == [
        *("K", "σ_d", "σ_y.dark", "SNR_max", "μ_e.min", "μ_e.sat", "DR"),
        *("DSNU_1288", "DSNU_1288.row", "DSNU_1288.col", "DSNU_1288.pixel"),
        *("PRNU_1288", "PRNU_1288.row", "PRNU_1288.col", "PRNU_1288.pixel", "LE"),
    ]
    by_symbol = {row.symbol: row for row in sheet.rows()}
    assert (by_symbol["PRNU_1288"].value, by_symbol["PRNU_1288"].unit) == (1.0, "%")
    assert by_symbol["K"].unit == "DN/e"
