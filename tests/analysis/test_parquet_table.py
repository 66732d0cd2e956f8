import csv
import sys
from pathlib import Path

import pytest

from analysis.change_series import ComparedFollowup
from analysis.errors import ResultsFileError
from analysis.followup_series import write_csv
from analysis.parquet_table import column_kinds, require_parquet, write_parquet

ROWS = [
    ComparedFollowup(followup="a.png", zoom=1.5, changes=3, taken="2026").model_dump(),
    ComparedFollowup(followup="b, c.png", refused="no picture").model_dump(),
]
NAMES = tuple(ComparedFollowup.model_fields)


def test_a_table_holds_what_the_csv_beside_it_does_with_types(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "changes.parquet"
    write_parquet(path, column_kinds(ComparedFollowup, NAMES), ROWS)
    write_csv(tmp_path / "changes.csv", NAMES, ROWS)
    found = parquet.read_table(path)
    assert found.to_pylist() == ROWS
    types = {field.name: str(field.type) for field in found.schema}
    assert (types["followup"], types["zoom"], types["changes"]) == ("string", "double", "int64")
    with (tmp_path / "changes.csv").open(newline="") as file:
        assert next(csv.reader(file)) == found.column_names


def test_a_table_without_lines_has_its_columns(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "none.parquet"
    write_parquet(path, {"a": bool, "b": str}, [])
    assert parquet.read_table(path).schema.names == ["a", "b"]


def test_without_pyarrow_a_line_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ResultsFileError, match=r"pip install 'standoff\[parquet\]'"):
        require_parquet()
