"""Questions to the operator: at a terminal's input, by a script, and what is to be placed."""

import os
import sys
from collections.abc import Iterator

import pytest

from acquisition.capture._quality import QualityFinding
from acquisition.plan import PlanEntry
from standoff.errors import ApplicationError
from standoff.terminal._operator_prompts import (
    LONGEST_ANSWER,
    ScriptedOperator,
    TerminalOperator,
    what_to_place,
)

ENTRY = PlanEntry(index=3, kind="edge", target="card [A]", orientation_deg=50.0, height_mm=300.0)
BLURRED = QualityFinding(problem="motion", text="it trembled by 0.4 px", asks_retake=True)


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Write end of a pipe that stands for the keyboard."""
    read, write = os.pipe()
    with os.fdopen(read, encoding="utf-8") as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        yield write
    if not is_closed(write):
        os.close(write)


def is_closed(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return True
    return False


@pytest.mark.parametrize(("answers", "verdict"), [(b"\n", "keep"), (b"well\nR\n", "retake")])
def test_a_bad_capture_is_shown_and_kept_or_taken_again(
    typed: int, capsys: pytest.CaptureFixture[str], answers: bytes, verdict: str
) -> None:
    os.write(typed, answers)
    assert TerminalOperator().review(ENTRY, (BLURRED,)) == verdict
    shown = capsys.readouterr().err
    assert "Capture 3: motion: it trembled by 0.4 px." in shown
    assert ("'well' is not a valid answer." in shown) is (verdict == "retake")


def test_a_line_typed_during_the_captures_makes_the_next_one_wait(
    typed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    operator = TerminalOperator()
    operator.wait_if_asked()
    assert "Paused" not in capsys.readouterr().err
    os.write(typed, b"wait\n")
    operator.wait_if_asked()
    assert "Paused. Enter to continue" in capsys.readouterr().err


def test_the_end_of_the_terminals_input_is_ctrl_c(typed: int) -> None:
    os.close(typed)
    with pytest.raises(KeyboardInterrupt):
        TerminalOperator().ask("Height shown on the scale, in mm")


def test_where_nothing_can_be_dropped_a_question_is_answered_all_the_same(
    typed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "termios", None)  # as on Windows
    os.write(typed, b"251.5\n")
    assert TerminalOperator().ask("Height shown on the scale, in mm") == "251.5"


def test_a_script_keeps_what_was_captured_and_waits_for_nobody(
    capsys: pytest.CaptureFixture[str],
) -> None:
    script = ScriptedOperator(iter(["200.5\r\n"]), "answers.txt")
    assert script.review(ENTRY, (BLURRED,)) == "keep"
    script.wait_if_asked()
    assert script.ask("Height, in mm") == "200.5"
    assert "Height, in mm:" in capsys.readouterr().err
    with pytest.raises(ApplicationError):
        script.ask("Height, in mm")


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [
        ("edge", "Place edge 'card [A]' at 50 degrees."),
        ("dark", "Put the lens cap on, and keep out stray light ('card [A]')."),
        ("flat", "Lens cap off. Place a uniform white surface, out of focus: 'card [A]'."),
    ],
)
def test_the_operator_is_told_what_to_place(kind: str, sentence: str) -> None:
    entry = PlanEntry(
        index=0,
        kind=kind,  # type: ignore[arg-type]  # of the kinds there are
        target="card [A]",
        orientation_deg=50.0,
        height_mm=300.0,
    )
    assert what_to_place(entry) == sentence


def test_a_script_whose_line_never_ends_is_refused_by_name() -> None:
    scripted = ScriptedOperator(iter(["\0" * (LONGEST_ANSWER + 1)]), "/dev/zero")
    with pytest.raises(ApplicationError, match=r"/dev/zero contains a line of more than"):
        scripted.place(ENTRY)
