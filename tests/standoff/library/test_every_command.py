"""Every command has its function, its row in the guide, and a test that both are one document."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

import standoff
from standoff.terminal import application

FUNCTIONS = {
    "capture": {"capture_session", "preview_plan"},
    "verify": {"verify_session"},
    "import": {"import_photographs"},
    "export": {"export_session"},
    "calibrate": {"calibrate_psf"},
    "compare": {"compare_psfs", "psf_history"},
    "focus": {"watch_focus", "find_focus"},
    "geometry": {"calibrate_geometry", "write_geometry"},
    "noise": {"measure_noise", "write_noise"},
    "lens": {"measure_lens", "write_lens"},
    "simulate": {"simulate"},
    "sr-pairs": {"training_pairs"},
    "change-pairs": {"change_pairs"},
    "plan-study": {"plan_study", "write_study"},
    "detectability": {"d_prime_curves", "measure_curves"},
    "evaluate": {"evaluate"},
    "benchmark score": {"score_benchmark"},
    "limits": {"pose_limits", "judge_homography"},
    "pose": {"judge_pose", "judge_poses", "PoseWatch"},
    "changes": {"find_changes", "find_changes_of_series"},
    "validate": {"validate"},
    "report": {"write_report"},
    "benchmark make": {"make_benchmark"},
    "cameras": {"find_cameras"},
    "session list": {"list_sessions"},
    "session show": {"show_session"},
    "session exclude": {"exclude_capture"},
    "session include": {"include_capture"},
    "session set-height": {"correct_height"},
    "session set-aside": {"set_aside_files"},
    "session note": {"add_note"},
}
EXEMPT = {
    "console": "serves a page until it is ended",
    "guide": "serves a page until it is ended",
    "mock": "serves a camera until it is ended",
    "doctor": "checks the installation",
    "demo": "shows the commands at work",
    "paper": "repeats one experiment",
    "stage": "only moves the stage, as Bench does",
}
HERE = Path(__file__).parent


def commands(group: Any = None, name: str = "") -> Iterator[tuple[str, Any]]:
    """The name and the definition of each command, those of groups with the group's name."""
    group = group or get_command(application([]))
    for one, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, f"{name}{one} ")
        else:
            yield f"{name}{one}", command


def rows_of_the_guide() -> dict[str, set[str]]:
    """The functions that the table of docs/library.md names for each command."""
    guide = (HERE.parents[2] / "docs" / "library.md").read_text("utf-8")
    table = guide.split("| command | function | returns |\n| --- | --- | --- |\n")[1]
    rows = [line.split("|") for line in table.split("\n\n")[0].splitlines()]
    return {row[1].strip(" `"): set(re.findall(r"`(\w+)\(", row[2])) for row in rows}


def test_every_command_has_a_function_or_a_reason_why_not() -> None:
    assert {name for name, _ in commands()} == FUNCTIONS.keys() | EXEMPT.keys()
    assert FUNCTIONS.keys().isdisjoint(EXEMPT)
    assert set().union(*FUNCTIONS.values()) <= set(dir(standoff))


def test_the_guide_has_a_row_for_every_command() -> None:
    rows = rows_of_the_guide()
    assert rows.keys() == FUNCTIONS.keys()
    assert [name for name in rows if not rows[name] >= FUNCTIONS[name]] == []


@pytest.mark.parametrize(
    "name", [name for name, one in commands() if any("--json" in p.opts for p in one.params)]
)
def test_the_document_of_every_command_is_compared_with_its_function(name: str) -> None:
    if name in EXEMPT:
        return
    words = {*name.split(), "--json"}
    assert any(words <= said and FUNCTIONS[name] & called for said, called in comparisons()), name


def comparisons() -> Iterator[tuple[set[str], set[str]]]:
    """Of each test that compares documents, its words and the public functions that it calls."""
    for path in HERE.glob("test_one_document*.py"):
        for test in ast.parse(path.read_text("utf-8")).body:
            if isinstance(test, ast.FunctionDef) and test.name.startswith("test_"):
                nodes = list(ast.walk(test))
                yield (
                    {str(one.value) for one in nodes if isinstance(one, ast.Constant)},
                    {one.attr for one in nodes if isinstance(one, ast.Attribute)},
                )
