from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, strategies as st

from analysis.sweep import _items as items, sorted_lines

LINES = st.lists(st.binary(max_size=3).map(lambda line: line.replace(b"\n", b"") + b"\n"))


@given(LINES)
def test_lines_come_sorted_and_once(lines: list[bytes]) -> None:
    with pytest.MonkeyPatch.context() as patch, TemporaryDirectory() as folder:
        # So few that runs are merged twice.
        patch.setattr(items, "_LINES_AT_ONCE", 3)
        patch.setattr(items, "_RUNS_AT_ONCE", 2)
        assert list(sorted_lines(lines, Path(folder))) == sorted(set(lines))


def test_no_lines_are_no_lines(tmp_path: Path) -> None:
    assert list(sorted_lines([], tmp_path)) == []
    assert list(tmp_path.iterdir()) == []


def test_a_hundred_thousand_lines_take_a_few_open_files(tmp_path: Path) -> None:
    lines = [f"{number * 7919 % 100_003:06d}\n".encode() for number in range(100_003)]
    assert list(sorted_lines(lines, tmp_path)) == sorted(lines)
