"""Reduced chi-squared of whole sessions, and the sentence where a model does not fit."""

from pathlib import Path

import pytest

from analysis.choices import ValidationModel
from analysis.validation.document import fit_remarks
from analysis.validation.session import ValidationSettings, validate
from calibration.psf import PsfCalibration
from simulation import GaussianPsf
from tests.analysis.height_series import LARGE_SHAPE, PSF, height_series

pytestmark = pytest.mark.slow

MODELS: tuple[ValidationModel, ...] = ("bicubic", "matched", "lmmse")
CALIBRATION = PsfCalibration(
    sigma_x_px=PSF.sigma_x_px,
    sigma_x_err_px=0.003,
    sigma_y_px=PSF.sigma_y_px,
    sigma_y_err_px=0.003,
)


def test_only_a_psf_that_is_not_the_lens_s_is_named(tmp_path: Path) -> None:
    series = height_series(tmp_path / "session", shape=LARGE_SHAPE)
    settings = ValidationSettings(models=MODELS, calibration=CALIBRATION)
    right = validate(series, PSF, settings)
    for pair in right.pairs:
        assert pair.chi2_reduced["matched"] == pytest.approx(1.0, abs=0.1)
        assert pair.chi2_reduced["lmmse"] == pytest.approx(1.0, abs=0.1)
        assert pair.chi2_reduced["bicubic"] > 1.5
    assert not any("does not fit" in remark for remark in right.remarks)

    wrong = validate(series, GaussianPsf(sigma_px=0.9), settings)
    (sentence,) = [remark for remark in wrong.remarks if "does not fit" in remark]
    worst = max(wrong.pairs, key=lambda pair: min(pair.chi2_reduced.values()))
    first = f"{worst.target} {worst.reference_height_mm:g} to {worst.followup_height_mm:g} mm"
    assert f"(reduced chi-squared) {first}" in sentence

    # Models without physics say nothing of the captures, and captures of one frame no noise.
    assert list(fit_remarks(wrong.pairs, ("bicubic", "paper"))) == []
    silent = [pair.model_copy(update={"chi2_reduced": {}}) for pair in wrong.pairs]
    assert list(fit_remarks(silent, MODELS)) == []
    (note,) = fit_remarks([*right.pairs, silent[0]], MODELS)
    assert "single frame" in note
    table = right.to_dataframe()
    chosen = table[(table.model == "matched") & (table.alignment == "followup-grid")]
    assert chosen.chi2_reduced.tolist() == [pair.chi2_reduced["matched"] for pair in right.pairs]
