"""The benchmark's data set: the command prints what the function returns."""

from pathlib import Path

import pytest

import standoff
from tests.standoff.conftest import Command
from tests.standoff.library.one_document import printed, without_caller


@pytest.mark.slow
def test_benchmark_make(command: Command, tmp_path: Path) -> None:
    made = standoff.make_benchmark(tmp_path / "set", size="tiny")
    # A set that is there is found complete.
    words = ("benchmark", "make", "--size", "tiny", "--out", tmp_path / "set", "--json")
    assert printed(command(*words)) == without_caller(made.to_json()) | {"tasks_found_done": 20}
    done = command(*words[:-1])
    assert done.status == 0
    assert f"sha256 {made.sha256}" in done.out
