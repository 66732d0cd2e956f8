"""Scores of the benchmark: the command prints what the function returns."""

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
