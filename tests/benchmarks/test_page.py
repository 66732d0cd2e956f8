"""The page of the benchmarks: what was run anew takes the place of its section, the rest stays."""

import ast
import json
import subprocess
from pathlib import Path
from string import Formatter

import pytest

from benchmarks.__main__ import FOLDER, benchmark_page, modules, sections_of
from benchmarks.harness import MEASURED, measured_commit

FACTS = {"processor": "a processor", "cores": "2", "system": "Linux x86_64", "Python": "3.11"}


def lines_of(path: Path, name: str, value: float, commit: str) -> Path:
    head = {"benchmark": name, "environment": FACTS, "note": "", "commit": commit}
    figure = {"benchmark": name, "name": "a figure", "value": value, "unit": "px"}
    figure |= {"peer": "a peer", "peer_value": 2 * value}
    path.write_text("".join(json.dumps(one) + "\n" for one in (head, figure)), "utf-8")
    return path


def test_a_section_that_was_run_anew_is_replaced_and_the_others_stay(tmp_path: Path) -> None:
    first, second = list(modules())[:2]
    one = benchmark_page(lines_of(tmp_path / "a", first, 3.0, "abc"), plot="p.png", mode="")
    both = benchmark_page(
        lines_of(tmp_path / "b", second, 5.0, "def"), plot="p.png", mode="", kept=sections_of(one)
    )
    assert f"[{first}](#{first}), [{second}](#{second})" in both
    assert both.index(f"## {first}\n\nCommit abc.") < both.index(f"## {second}\n\nCommit def.")
    again = benchmark_page(
        lines_of(tmp_path / "c", first, 7.0, "0123"), plot="p.png", mode="", kept=sections_of(both)
    )
    assert sections_of(again)[second] == sections_of(both)[second]
    assert "| a figure | 7 px | a peer | 14 | **2** |" in again
    assert "Commit abc" not in again


def test_the_committed_page_is_read_into_sections_that_hold_all_of_its_rows() -> None:
    page = (Path(__file__).parents[2] / "docs" / "benchmarks.md").read_text("utf-8")
    sections = sections_of(page)
    rows = sum(section.count("\n| ") for section in sections.values())
    assert rows == page.count("\n| ") > 1000


def test_figures_are_of_the_last_commit_that_changed_what_is_measured(tmp_path: Path) -> None:
    def git(*words: str) -> str:
        who = ("-c", "user.name=a", "-c", "user.email=a@b")
        done = subprocess.run(
            ["git", *who, *words], cwd=tmp_path, capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    assert measured_commit(tmp_path) == ""
    git("init", "-q")
    for name in (*MEASURED, "docs"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.py").write_text("")
    git("add", "-A")
    git("commit", "-qm", "one")
    first = git("rev-parse", "--short", "HEAD")
    (tmp_path / "docs" / "a.py").write_text("x = 1")
    git("commit", "-qam", "a document")
    assert measured_commit(tmp_path) == first
    (tmp_path / "simulation" / "a.py").write_text("x = 1")
    assert measured_commit(tmp_path) == f"{first}+"
    git("commit", "-qam", "code")
    assert measured_commit(tmp_path) not in ("", first, f"{first}+")


@pytest.mark.parametrize("name", MEASURED)
def test_what_is_measured_is_there(name: str) -> None:
    assert (Path(__file__).parents[2] / name / "__init__.py").is_file()


def text_of(note: ast.expr) -> str:
    """What a note says, with a word for each value that the module fills in."""
    parts = note.values if isinstance(note, ast.JoinedStr) else [note]
    return "".join(str(one.value) if isinstance(one, ast.Constant) else "value" for one in parts)


@pytest.mark.parametrize(("name", "module"), modules().items())
def test_the_note_of_a_benchmark_names_its_options_alone(name: str, module: str) -> None:
    tree = ast.parse((FOLDER / module.split(".")[1] / f"{name}.py").read_text("utf-8"))
    [main] = [one for one in tree.body if isinstance(one, ast.FunctionDef) and one.name == "main"]
    [declared] = [one for one in main.decorator_list if isinstance(one, ast.Call)]
    notes = [text_of(word.value) for word in declared.keywords if word.arg == "note"]
    named = {field for note in notes for _, field, *_ in Formatter().parse(note) if field}
    assert named <= {one.arg for one in main.args.kwonlyargs}
