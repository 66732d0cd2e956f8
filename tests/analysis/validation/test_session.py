import csv
import json
from dataclasses import replace
from io import StringIO
from math import inf
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from acquisition.session.reader import Session
from analysis.errors import ResultsFileError
from analysis.reports.page import png_bytes
from analysis.reports.validation import render_validation
from analysis.reports.validation_plots import plot_curves, plot_images
from analysis.results_file import write_results
from analysis.validation.alignment import PROCEDURES
from analysis.validation.kernels import KernelBook, trainings_needed
from analysis.validation.metrics import ImageMetrics
from analysis.validation.models import ValidationModel
from analysis.validation.screening import screen
from analysis.validation.session import (
    METRICS,
    Validation,
    curve_errors,
    table_1,
    table_2,
    validate,
)
from analysis.validation.tables import (
    PAPER_TABLE_1,
    PAPER_TABLE_2,
    VALIDATION_SCHEMA,
    both_tables,
    curves_csv,
    validation_document,
)
from tests.analysis.height_series import PSF, height_series

MODELS: tuple[ValidationModel, ...] = ("bicubic", "paper", "matched")
POINT = ImageMetrics(
    correlation=0.9, mse_dn2=10.0, nmi=1.2, psnr_db=38.0, ssim=0.8, data_range_dn=255.0
)


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return height_series(tmp_path_factory.mktemp("series") / "session")


@pytest.fixture(scope="module")
def validation(series: Session, tmp_path_factory: pytest.TempPathFactory) -> Validation:
    book = KernelBook(folder=tmp_path_factory.mktemp("kernels"))
    screening = screen(series, PSF)
    assert trainings_needed(series, screening.pairs, MODELS, book) == []
    return validate(series, PSF, screening, MODELS, book)


def test_the_difference_of_curves_by_hand() -> None:
    moved = replace(POINT, correlation=0.8, mse_dn2=14.0, psnr_db=37.0)
    found = curve_errors([(POINT, POINT), (POINT, moved)])
    assert found.correlation == pytest.approx(0.1**2 / 2)
    assert found.mse_dn2 == pytest.approx(4.0**2 / 2)
    assert found.psnr_db == pytest.approx(1.0 / 2)
    assert (found.nmi, found.ssim, found.pairs) == (0.0, 0.0, 2)


def test_two_curves_that_are_both_infinite_do_not_differ() -> None:
    equal = replace(POINT, psnr_db=inf)
    assert curve_errors([(equal, equal)]).psnr_db == 0.0


def test_no_points_are_no_curve() -> None:
    with pytest.raises(ValueError, match="no points"):
        curve_errors([])


@given(shifts=st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=8))
def test_the_difference_of_curves_is_symmetric_and_nothing_for_one_curve(
    shifts: list[float],
) -> None:
    points = [replace(POINT, ssim=POINT.ssim + shift) for shift in shifts]
    forth = curve_errors((POINT, point) for point in points)
    back = curve_errors((point, POINT) for point in points)
    assert forth == back
    assert curve_errors((point, point) for point in points).ssim == 0.0


def test_the_models_that_know_the_psf_beat_the_one_that_does_not(validation: Validation) -> None:
    assert len(validation.pairs) == 5
    curves, means = table_1(validation), table_2(validation)
    for procedure in PROCEDURES:
        bicubic, paper = means[procedure, "bicubic"], means[procedure, "paper"]
        assert paper.mse_dn2 < bicubic.mse_dn2
        for name in ("correlation", "nmi", "psnr_db", "ssim"):
            assert getattr(paper, name) > getattr(bicubic, name)
        for name in METRICS:
            known, unknown = (curves[procedure, model] for model in ("paper", "bicubic"))
            assert getattr(known, name) < getattr(unknown, name)
    best = means["followup-grid", "matched"].mse_dn2
    assert best < means["as-in-paper", "paper"].mse_dn2 / 2


def test_only_one_pair_of_a_target_keeps_its_images(validation: Validation) -> None:
    kept = [pair for pair in validation.pairs if pair.images is not None]
    # The one of the first reference that is nearest to twice the distance.
    assert [(pair.reference.index, pair.followup.index) for pair in kept] == [(0, 3)]


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


def test_the_points_of_the_curves_are_written_out(validation: Validation) -> None:
    lines = list(csv.DictReader(StringIO(curves_csv(validation))))
    assert len(lines) == len(validation.pairs) * len(PROCEDURES) * (len(MODELS) + 1)
    captured = [line for line in lines if line["model"] == "captured"]
    pair = validation.pairs[0]
    assert float(captured[0]["ssim"]) == pair.captured_curves["as-in-paper"].ssim


def test_the_document_is_written_as_json(validation: Validation, tmp_path: Path) -> None:
    document = validation_document(validation, {"session": "here"})
    path = tmp_path / "validation.json"
    write_results(path, document)
    assert json.loads(path.read_text()) == json.loads(json.dumps(document))
    assert document["schema"] == VALIDATION_SCHEMA
    assert document["table_2"][0]["alignment"] == "as-in-paper"
    assert len(document["pairs"]) == 5
    with pytest.raises(ResultsFileError, match="cannot write"):
        write_results(tmp_path / "nowhere" / "v.json", document)


def test_the_figures_and_the_report_show_every_model(
    validation: Validation, series: Session
) -> None:
    images, curves = plot_images(validation), plot_curves(validation)
    assert len(images.axes) == 2 + len(MODELS)
    assert len(curves.axes) == len(METRICS)
    for figure in (images, curves):
        assert png_bytes(figure).startswith(b"\x89PNG")
    page = render_validation(series, validation, (("psf", "psf.json"),))
    for words in ("Table I:", "Table II:", "as-in-paper", "the paper&#39;s own", "leaves"):
        assert words in page
