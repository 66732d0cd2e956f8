"""What tables show where room is short, and of names with brackets."""

import io
import json
import time
from itertools import count
from pathlib import Path

import pytest
from rich.console import Console

import standoff.terminal._output
from standoff.terminal._output import (
    NOTED,
    note,
    note_in_passing,
    print_json_file,
    print_table,
    progress_bar,
    say_error,
)

NAME = "/somewhere/" + "deep/" * 40 + "edge[1].tif"


@pytest.mark.parametrize("width", [60, 80, 10_000])
def test_a_long_name_folds_and_figures_stay_whole(
    width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = io.StringIO()
    console = Console(file=shown, soft_wrap=True, highlight=False, width=width)
    monkeypatch.setattr(standoff.terminal._output, "_RESULTS", console)
    print_table("Files", ["file", "sigma_x / px"], [[NAME, "0.8000 ± 0.0012"], ["b", "0.84"]])
    text = shown.getvalue()
    assert "0.8000 ± 0.0012" in text
    assert "sigma_x / px" in text
    folded = [line.split("│")[1].strip() for line in text.splitlines() if line.startswith("│")]
    assert "".join(folded[:-1]) == NAME
    if width < 10_000:
        assert max(len(line) for line in text.splitlines()) <= width


def test_without_a_terminal_a_table_is_as_wide_as_it_needs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    print_table("Files of x[old], [/bold]", ["file", "sigma_x / px"], [[NAME, "0.8000"]])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].strip() == "Files of x[old], [/bold]"
    (row,) = [line for line in lines if NAME in line]
    assert "0.8000" in row


def test_a_remark_on_the_command_itself_is_printed_and_kept_from_reports(
    capsys: pytest.CaptureFixture[str],
) -> None:
    token = NOTED.set([])
    try:
        note("the light drifts")
        note_in_passing("compiling")
        assert NOTED.get() == ["the light drifts"]
    finally:
        NOTED.reset(token)
    assert capsys.readouterr().err == "note: the light drifts\nnote: compiling\n"


def test_an_error_that_repeats_a_value_of_a_hundred_thousand_letters_keeps_its_ends(
    capsys: pytest.CaptureFixture[str],
) -> None:
    say_error(f"noise.json: gain: expected a number, got {'x' * 100_000}; write it anew")
    line = capsys.readouterr().err
    assert line.startswith("standoff: noise.json: gain: expected a number, got xxx")
    assert line.endswith("xxx; write it anew\n")
    assert len(line) < 5000


def test_without_a_terminal_long_work_tells_a_plain_line_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seconds = count(step=10)
    monkeypatch.setattr(time, "monotonic", lambda: float(next(seconds)))
    with progress_bar("calibrating a\x1b[2Jb [1]", 9) as bar:
        for done in range(1, 10):
            bar.advance_to(done)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert "[1]: 3 of 9 after 30 s" in lines[0]
    assert all(line.isprintable() for line in lines)


def test_short_work_without_a_terminal_tells_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("calibrating", 3) as bar:
        bar.advance_to(3)
    assert capsys.readouterr().err == ""


def test_the_title_of_a_table_is_on_one_printable_line(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("Captures of a\x1b[2J\nb", ["file"], [["x"]])
    title = capsys.readouterr().out.splitlines()[0]
    assert title.isprintable()
    assert title.startswith("Captures of a")
    assert title.rstrip().endswith("b")


@pytest.mark.parametrize(
    ("encoding", "shown"), [("ascii", "\\u4e5d\\ud83d\\ude00"), ("utf-8", "九😀")]
)
def test_a_json_file_is_printed_with_escapes_where_the_stream_lacks_its_letters(
    encoding: str, shown: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, printed = tmp_path / "summary.json", io.BytesIO()
    path.write_text('{"followup":\n "九😀.tif"}\n', encoding="utf-8")
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(printed, encoding))
    print_json_file(path)
    text = printed.getvalue().decode(encoding)
    assert f'"{shown}.tif"' in text
    assert json.loads(text) == {"followup": "九😀.tif"}


def test_a_table_is_laid_out_as_the_stream_shows_its_letters(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    printed = io.BytesIO()
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(printed, "ascii"))
    print_table("± at 95 %", ["", "µm ±"], [["a", "1.0 ± 0.2 px²"], ["März", "12"]])
    title, *lines = printed.getvalue().decode("ascii").splitlines()
    assert title.strip() == "+/- at 95 %"
    assert len({len(line) for line in lines}) == 1
    assert "| M\\xe4rz |               12 |" in lines
