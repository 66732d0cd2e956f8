import json
from math import inf
from pathlib import Path
from typing import Literal

import pytest
from pydantic import Field

from analysis.errors import ResultsFileError
from analysis.results_file import InfiniteAsNull, ResultsDocument, StoredValues, write_results
from calibration.documents import json_object, read_document


class Figures(StoredValues):
    psnr_db: InfiniteAsNull
    ssim: float


class Results(ResultsDocument):
    schema_name: Literal["test/1"] = Field(default="test/1", alias="schema")
    figures: tuple[Figures, ...]


RESULTS = Results(figures=(Figures(psnr_db=inf, ssim=1.0), Figures(psnr_db=30.5, ssim=0.5)))


def read(path: Path) -> Results:
    return read_document(path, Results, ResultsFileError, "write it with standoff test")


def test_a_document_comes_back_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    write_results(path, RESULTS)
    assert read(path) == RESULTS


def test_what_json_cannot_hold_is_null(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    write_results(path, RESULTS)
    assert json.loads(path.read_text()) == {
        "schema": "test/1",
        "figures": [{"psnr_db": None, "ssim": 1.0}, {"psnr_db": 30.5, "ssim": 0.5}],
        "provenance": None,
    }


def test_what_a_later_version_adds_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    later = json_object(RESULTS) | {"uncertainty": {"version": "9"}}
    later["figures"][0]["new"] = 1
    path.write_text(json.dumps(later))
    assert read(path) == RESULTS


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("{", None),
        ("[]", "schema"),
        ('{"schema": "test/2"}', "schema"),
        ('{"schema": "test/1"}', "figures"),
        ('{"schema": "test/1", "figures": [{"psnr_db": 1, "ssim": "much"}]}', "figures.0.ssim"),
        ('{"schema": "test/1", "figures": [{"psnr_db": 1, "ssim": NaN}]}', "figures.0.ssim"),
    ],
)
def test_a_broken_file_is_refused_by_the_value_at_fault(
    tmp_path: Path, text: str, key: str | None
) -> None:
    path = tmp_path / "results.json"
    path.write_text(text)
    with pytest.raises(ResultsFileError) as refused:
        read(path)
    assert (refused.value.source, refused.value.key) == (str(path), key)
    assert str(path) in str(refused.value)


def test_a_file_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    path = tmp_path / "nowhere" / "r.json"
    for use in (lambda: write_results(path, RESULTS), lambda: read(path)):
        with pytest.raises(ResultsFileError) as refused:
            use()
        assert refused.value.source == str(path)
        assert isinstance(refused.value.__cause__, FileNotFoundError)
