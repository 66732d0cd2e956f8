"""The benchmark's data set and its scores: the command prints what the function returns."""

from pathlib import Path

import pytest

import standoff
from tests.analysis.benchmark.hand_made_set import everything
from tests.standoff.conftest import Command
from tests.standoff.library.one_document import printed, without_caller


@pytest.mark.slow
def test_benchmark_score(command: Command, tmp_path: Path) -> None:
    data, program = everything(tmp_path)
    words = ("benchmark", "score", program, "--data", data)
    done = command(*words, "--out", tmp_path / "scores", "--json")
    found = standoff.score_benchmark(program, data)
    assert printed(done) == without_caller(found.to_json())


@pytest.mark.slow
def test_benchmark_make(command: Command, tmp_path: Path) -> None:
    made = standoff.make_benchmark(tmp_path / "set", size="tiny")
    # A set that is there is found complete.
    words = ("benchmark", "make", "--size", "tiny", "--out", tmp_path / "set", "--json")
    assert printed(command(*words)) == without_caller(made.to_json()) | {"tasks_found_done": 30}
    done = command.done(*words[:-1])
    assert f"sha256 {made.sha256}" in done.out
