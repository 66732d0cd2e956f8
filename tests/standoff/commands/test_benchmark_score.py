"""``standoff benchmark score``: what it writes and prints, and a program that takes part."""

import csv
import re
import subprocess
import sys
from pathlib import Path

import pytest

from analysis.benchmark import read_scores
from standoff.library import SCORE_FILES
from tests.analysis.benchmark.hand_made_set import everything, write_json
from tests.standoff.conftest import Command

GUIDE = Path(__file__).parents[3] / "docs" / "benchmark-scoring.md"


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A data set, a program that knows the truth, and one that refuses all pairs."""
    folder = tmp_path_factory.mktemp("benchmark")
    data, knows = everything(folder)
    return data, knows, write_json(folder / "|refuses|", "alignment.json", {})


@pytest.mark.slow
def test_programs_are_written_and_printed_side_by_side(
    command: Command, folders: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    data, knows, refuses = folders
    out = tmp_path / "scores"
    words = ("benchmark", "score", knows, refuses, "--data", data, "--out", out)
    done = command.done(*words)
    assert "Alignment of two photographs" in done.out
    assert "related pairs within 0.1 px / %" in done.out
    assert sorted(path.name for path in out.iterdir()) == sorted(SCORE_FILES)
    scores = read_scores(out / "scores.json")
    assert [one.name for one in scores.programs] == ["knows", "|refuses|"]
    with (out / "scores.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(scores.scores)
    assert {row["program"] for row in rows} == {"knows", "|refuses|"}
    text = (out / "scores.md").read_text("utf-8")
    row = next(line for line in text.splitlines() if line.startswith("| related pairs within 0.1"))
    # All of four scenes are found, or none: Clopper and Pearson's interval of four.
    assert row.split(" | ")[1:3] == ["**100.0 (39.8 to 100.0)**", "0.0 (0.0 to 60.2)"]
    assert "\\|refuses\\|" in text
    page = (out / "scores.html").read_text("utf-8")
    assert page.count("<svg") == 7
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert "exists already" in command.refused(1, *words)
    command.done(*words, "--force")
    assert (out / "scores.csv").read_bytes() == before["scores.csv"]
    assert (out / "scores.md").read_bytes() == before["scores.md"]


def test_a_fault_is_one_line_and_nothing_is_written(
    command: Command, folders: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    spoilt = write_json(tmp_path / "spoilt", "alignment.json", {"p7": {"refused": True}})
    done = command("benchmark", "score", spoilt, "--data", folders[0], "--out", tmp_path / "out")
    assert (done.status, done.out) == (1, "")
    assert done.err == f"standoff: {spoilt / 'alignment.json'}: there is no task 'p7'\n"
    assert not (tmp_path / "out").exists()


def test_without_a_data_set_it_is_wrong_usage(command: Command, tmp_path: Path) -> None:
    assert command("benchmark", "score", tmp_path).status == 2


@pytest.mark.slow
def test_the_program_of_the_guide_takes_part(command: Command, tmp_path: Path) -> None:
    data, bicubic = tmp_path / "data", tmp_path / "bicubic"
    command.done("benchmark", "make", "--out", data, "--size", "tiny")
    [program] = [
        code
        for code in re.findall(r"```python\n(.*?)```", GUIDE.read_text("utf-8"), re.S)
        if "sys.argv" in code
    ]
    (tmp_path / "example.py").write_text(program)
    subprocess.run([sys.executable, tmp_path / "example.py", data, bicubic], check=True)
    scores = {
        (one["track"], one["measure"]): one["value"]
        for one in command.document("benchmark", "score", bicubic, "--data", data)["scores"]
        if one["group"] == "all"
    }
    assert scores["simulation", "answered"] == scores["changes", "answered"] == 100
    # Plain bicubic is far from perfect, and far from unlike.
    assert 5 < scores["simulation", "error_median"] < 100
    assert scores["simulation", "correlation_median"] > 0.8
