"""Reduced chi-squared of whole sessions, and the sentence where a model does not fit."""

import csv
import json
from io import StringIO
from math import inf
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st

from acquisition.session import Session
from analysis.choices import ValidationModel
from analysis.reports import plot_curves, plot_images, png_bytes, validation_report
from analysis.results_file import write_results
from analysis.validation import (
    METRICS,
    ImageMetrics,
    KernelBook,
    ShownPair,
    Validation,
    ValidationSettings,
    both_tables,
    curves_csv,
    mean_metrics,
    read_validation,
    screen,
    shown_pairs,
    trainings_needed,
    validated,
)
from analysis.validation._document import (
    PAPER_TABLE_1,
    PAPER_TABLE_2,
    VALIDATION_SCHEMA,
    fit_remarks,
)
from analysis.validation._metrics import PROCEDURES
from analysis.validation._session import curve_differences
from calibration.psf import PsfCalibration
from simulation import GaussianPsf
from tests.analysis.height_series import LARGE_SHAPE, PSF, height_series

MODELS: tuple[ValidationModel, ...] = ("bicubic", "paper", "matched")
POINT = ImageMetrics(
    correlation=0.9, mse_dn2=10.0, nmi=1.2, psnr_db=38.0, ssim=0.8, data_range_dn=255.0
)


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return height_series(tmp_path_factory.mktemp("series") / "session", shape=LARGE_SHAPE)


@pytest.fixture(scope="module")
def book(tmp_path_factory: pytest.TempPathFactory) -> KernelBook:
    return KernelBook(folder=tmp_path_factory.mktemp("kernels"))


@pytest.fixture(scope="module")
def validation(series: Session, book: KernelBook) -> Validation:
    screening = screen(series, PSF)
    assert trainings_needed(series, screening.pairs, MODELS, book) == []
    settings = ValidationSettings(models=MODELS, kernels=book)
    return validated(series, PSF, settings, screening=screening, psf_name="psf.json")


@pytest.fixture(scope="module")
def shown(series: Session, validation: Validation, book: KernelBook) -> list[ShownPair]:
    return shown_pairs(series, validation, PSF, book)


def point(**values: float) -> ImageMetrics:
    return POINT.model_copy(update=values)


def test_the_difference_of_curves_by_hand() -> None:
    moved = point(correlation=0.8, mse_dn2=14.0, psnr_db=37.0)
    found = curve_differences([(POINT, POINT), (POINT, moved)])
    assert found.correlation == pytest.approx(0.1**2 / 2)
    assert found.mse_dn2 == pytest.approx(4.0**2 / 2)
    assert found.psnr_db == pytest.approx(1.0 / 2)
    assert (found.nmi, found.ssim, found.pairs) == (0.0, 0.0, 2)


def test_two_curves_that_are_both_infinite_do_not_differ() -> None:
    equal = point(psnr_db=inf)
    assert curve_differences([(equal, equal)]).psnr_db == 0.0


def test_no_points_are_no_curve() -> None:
    with pytest.raises(ValueError):
        curve_differences([])


@given(shifts=st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=8))
def test_the_difference_of_curves_is_symmetric_and_nothing_for_one_curve(
    shifts: list[float],
) -> None:
    points = [point(ssim=POINT.ssim + shift) for shift in shifts]
    forth = curve_differences((POINT, point) for point in points)
    back = curve_differences((point, POINT) for point in points)
    assert forth == back
    assert curve_differences((point, point) for point in points).ssim == 0.0


@pytest.mark.slow
def test_the_models_that_know_the_psf_beat_the_one_that_does_not(validation: Validation) -> None:
    assert len(validation.pairs) == 5
    curves = {(row.alignment, row.model): row for row in validation.table_1}
    for procedure in PROCEDURES:
        means = validation.means(procedure)
        bicubic, paper = means["bicubic"], means["paper"]
        assert paper.mse_dn2 < bicubic.mse_dn2
        for name in ("correlation", "nmi", "psnr_db", "ssim"):
            assert getattr(paper, name) > getattr(bicubic, name)
        for name in METRICS:
            known, unknown = (curves[procedure, model] for model in ("paper", "bicubic"))
            assert getattr(known, name) < getattr(unknown, name)
    best = validation.means("followup-grid")["matched"].mse_dn2
    assert best < validation.means("as-in-paper")["paper"].mse_dn2 / 2


def test_the_means_are_those_of_the_pairs(validation: Validation) -> None:
    assert [(row.alignment, row.model) for row in validation.table_2] == [
        (procedure, model) for procedure in PROCEDURES for model in MODELS
    ]
    for row in validation.table_2:
        own = mean_metrics([p.of(row.alignment, row.model).agreement for p in validation.pairs])
        assert own.pairs == 5
        assert all(getattr(row, name) == value for name, value in own)


@pytest.mark.slow
def test_progress_counts_the_pairs_of_a_validation_with_what_is_usual(series: Session) -> None:
    told: list[int] = []
    usual = validated(series, PSF, progress=told.append)
    assert told == [1, 2, 3, 4, 5]
    assert usual.models == ("bicubic", "paper", "matched", "lmmse")
    assert repr(usual).startswith("<Validation of 5 pairs: MSE bicubic ")


def test_figure_2_shows_one_pair_of_a_target(shown: list[ShownPair]) -> None:
    # The one of the first reference that is nearest to twice the distance.
    assert [(one.pair.reference, one.pair.followup) for one in shown] == [(0, 3)]
    assert list(shown[0].simulated) == list(MODELS)


def test_the_tables_say_the_same_in_every_form(validation: Validation) -> None:
    first, second = both_tables(validation)
    assert len(first.rows) == len(second.rows) == len(PROCEDURES) * len(MODELS)
    for table, paper in ((first, PAPER_TABLE_1), (second, PAPER_TABLE_2)):
        text, latex = table.text(), table.latex()
        for row in (*table.rows, *table.paper):
            assert all(cell in text for cell in row)
            assert " & ".join(row) in latex
        assert len(table.paper) == len(paper)
        assert latex.count(r"\\") == 1 + len(table.rows) + len(table.paper)
        read = list(csv.DictReader(StringIO(table.csv())))
        assert [(line["alignment"], line["model"]) for line in read] == [r[:2] for r in table.rows]
        for line, values in zip(read, table.values, strict=True):
            assert [float(line[name]) for name in table.value_names] == list(values)


def test_a_learned_model_is_named_with_the_steps_of_its_training(validation: Validation) -> None:
    trained = validation.model_copy(
        update={
            "table_2": tuple(
                row.model_copy(update={"model": "kernelgan", "training_steps": 25})
                if row.model == "bicubic"
                else row
                for row in validation.table_2
            )
        }
    )
    table = both_tables(trained)[1]
    assert "kernelgan (25 steps)" in table.text()
    assert "kernelgan (25 steps) & " in table.latex()
    for line in csv.DictReader(StringIO(table.csv())):
        # A program asks for the model by its name.
        assert (line["training_steps"] == "25") == (line["model"] == "kernelgan")


def test_the_points_of_the_curves_are_written_out(validation: Validation) -> None:
    lines = list(csv.DictReader(StringIO(curves_csv(validation))))
    assert len(lines) == len(validation.pairs) * len(PROCEDURES) * (len(MODELS) + 1)
    captured = [line for line in lines if line["model"] == "captured"]
    pair = validation.pairs[0]
    assert float(captured[0]["ssim"]) == pair.captured_curves["as-in-paper"].ssim


def test_the_document_comes_back_as_it_was_written(validation: Validation, tmp_path: Path) -> None:
    path = tmp_path / "validation.json"
    write_results(path, validation)
    assert read_validation(path) == validation
    document: dict[str, Any] = json.loads(path.read_text())
    assert document["schema"] == VALIDATION_SCHEMA
    assert list(document["table_1"][0]) == [
        *("alignment", "model", "training_steps"),
        *METRICS,
        "pairs",
    ]
    assert list(document["table_2"][0]) == [
        *("alignment", "model", "training_steps", "correlation", "mse_dn2", "nmi"),
        *("psnr_db", "psnr_of_mean_db", "ssim", "pairs"),
    ]
    assert document["table_2"][0]["alignment"] == "as-in-paper"
    assert len(document["pairs"]) == 5


@pytest.mark.slow
def test_the_figures_and_the_report_show_every_model(
    validation: Validation, series: Session, shown: list[ShownPair]
) -> None:
    images, curves = plot_images(shown), plot_curves(validation)
    assert len(images.axes) == 2 + len(MODELS)
    assert len(curves.axes) == len(METRICS)
    for figure in (images, curves):
        assert png_bytes(figure).startswith(b"\x89PNG")
    page = validation_report(series, validation, shown).html()
    for words in ("Table I:", "Table II:", "as-in-paper", "the paper&#39;s own", "leaves"):
        assert words in page


FIT_MODELS: tuple[ValidationModel, ...] = ("bicubic", "matched", "lmmse")
CALIBRATION = PsfCalibration(
    sigma_x_px=PSF.sigma_x_px, sigma_x_err_px=0.003, sigma_y_px=PSF.sigma_y_px, sigma_y_err_px=0.003
)


@pytest.mark.slow
def test_only_a_psf_that_is_not_the_lens_s_is_named(series: Session) -> None:
    settings = ValidationSettings(models=FIT_MODELS, calibration=CALIBRATION)
    right = validated(series, PSF, settings)
    for pair in right.pairs:
        assert pair.chi2_reduced["matched"] == pytest.approx(1.0, abs=0.1)
        assert pair.chi2_reduced["lmmse"] == pytest.approx(1.0, abs=0.1)
        assert pair.chi2_reduced["bicubic"] > 1.5
    assert not any("does not fit" in remark for remark in right.remarks)

    wrong = validated(series, GaussianPsf(sigma_px=0.9), settings)
    (sentence,) = [remark for remark in wrong.remarks if "does not fit" in remark]
    worst = max(wrong.pairs, key=lambda pair: min(pair.chi2_reduced.values()))
    first = f"{worst.target} {worst.reference_height_mm:g} to {worst.followup_height_mm:g} mm"
    assert f"(reduced chi-squared): {first}" in sentence

    # Models without physics say nothing of the captures, and captures of one frame no noise.
    assert list(fit_remarks(wrong.pairs, ("bicubic", "paper"))) == []
    silent = [pair.model_copy(update={"chi2_reduced": {}}) for pair in wrong.pairs]
    assert list(fit_remarks(silent, FIT_MODELS)) == []
    (note,) = fit_remarks([*right.pairs, silent[0]], FIT_MODELS)
    assert "single frame" in note
    table = right.to_dataframe()
    chosen = table[(table.model == "matched") & (table.alignment == "followup-grid")]
    assert chosen.chi2_reduced.tolist() == [pair.chi2_reduced["matched"] for pair in right.pairs]
