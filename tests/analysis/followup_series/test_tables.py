import csv
import json
from pathlib import Path

import pytest

from analysis.change_series import (
    ChangesSeries,
    ComparedFollowup,
    read_changes_series,
)
from analysis.errors import ResultsFileError
from analysis.followup_series import write_csv, write_summary
from calibration.documents import json_object

LISTED = (
    ComparedFollowup(
        followup='/p/a, "b".tif',
        sha256="0" * 64,
        folder="a",
        changed_px=3,
        compared_px=9,
        zoom=1.1,
        threshold_sd=5.0,
    ),
    ComparedFollowup(followup="/p/ä.tif", refused="/p/ä.tif: not an image"),
)
DOCUMENT = ChangesSeries(reference="r.tif", compared=1, changed=1, refused=1)


@pytest.mark.parametrize("listed", [(), LISTED[:1], LISTED])
def test_a_summary_written_line_by_line_is_the_document_with_its_list(
    tmp_path: Path, listed: tuple[ComparedFollowup, ...]
) -> None:
    path = tmp_path / "summary.json"
    write_summary(path, DOCUMENT, (one.model_dump() for one in listed))
    whole = DOCUMENT.model_copy(update={"followups": listed})
    assert read_changes_series(path) == whole
    assert json.loads(path.read_text("utf-8")) == json_object(whole)
    assert [file.name for file in tmp_path.iterdir()] == ["summary.json"]


def test_a_table_is_read_back_and_what_is_missing_is_an_empty_cell(tmp_path: Path) -> None:
    path = tmp_path / "changes.csv"
    columns = tuple(ComparedFollowup.model_fields)
    write_csv(path, columns, (one.model_dump() for one in LISTED))
    with path.open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    assert [ComparedFollowup.model_validate(_filled(line)) for line in lines] == list(LISTED)


def test_a_table_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ResultsFileError, match="cannot write"):
        write_csv(tmp_path / "none" / "changes.csv", ("followup",), [])


def _filled(line: dict[str, str]) -> dict[str, str]:
    return {key: value for key, value in line.items() if value}
