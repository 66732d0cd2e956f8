"""Results as pandas tables hold what the documents hold."""

import sys

import pytest

from acquisition.dataframe import PandasMissingError, dataframe


@pytest.mark.slow
def test_columns_are_the_keys_and_words_share_a_cell() -> None:
    table = dataframe(
        [
            {"x_px": 1.5, "flags": ("soft", "short"), "fit": {"err": 0.1}, "path": "a.tif"},
            {"x_px": 2.5, "flags": (), "fit": {"err": 0.2}, "path": "b.tif"},
        ]
    )
    assert list(table) == ["x_px", "flags", "fit.err", "path"]
    assert table.x_px.dtype == float
    assert table["flags"].tolist() == ["soft short", ""]
    assert table["fit.err"].tolist() == [0.1, 0.2]
    assert dataframe([]).empty


def test_without_pandas_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(PandasMissingError, match=r"pip install standoff\[pandas\]"):
        dataframe([{"x_px": 1.0}])
