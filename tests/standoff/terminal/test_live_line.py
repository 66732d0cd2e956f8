from io import StringIO

import pytest
from rich.console import Console

from standoff.terminal._output import LiveLine


def shown(monkeypatch: pytest.MonkeyPatch, *, is_terminal: bool, at_s: tuple[float, ...]) -> str:
    """What stands on stderr after one text at each of these times."""
    stream = StringIO()
    console = Console(file=stream, force_terminal=is_terminal, color_system=None, width=40)
    monkeypatch.setattr("standoff.terminal._output.ERRORS", console)
    with LiveLine() as line:
        for number, now_s in enumerate(at_s):
            line.show(f"text {number}", now_s=now_s)
    return stream.getvalue()


def test_without_a_terminal_there_is_a_plain_line_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    found = shown(monkeypatch, is_terminal=False, at_s=(0.0, 0.5, 1.0, 1.9, 2.0))
    assert found.splitlines() == ["text 0", "text 2", "text 4"]


def test_on_a_terminal_one_line_is_drawn_anew_no_faster_than_the_eye(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = shown(monkeypatch, is_terminal=True, at_s=(0.0, 0.05, 0.125))
    assert "text 0" in found
    assert "text 1" not in found
    assert found.count("\n") == 1
    assert "text 2" in found
