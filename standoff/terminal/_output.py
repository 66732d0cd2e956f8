"""What a command prints: results for people or one JSON document, progress and cameras on stderr.

On stderr, one line follows what a camera sees: the focus value, and verdicts on its pose.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from pydantic import BaseModel
from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from acquisition.printable import on_one_line
from standoff.streams import as_shown

if TYPE_CHECKING:
    from acquisition.focus import FocusReading
    from analysis.pose import PoseVerdict

_Item = TypeVar("_Item")

ERRORS = Console(stderr=True, soft_wrap=True, highlight=False)
NOTED: ContextVar[list[str] | None] = ContextVar("NOTED", default=None)
"""Every remark printed by the command that runs, for its report; None outside a command."""

PROGRESS_VARIABLE = "STANDOFF_PROGRESS_S"
"""Environment variable: seconds between the plain lines of progress, for whoever reads them."""

UPPER_BOUND = "d' is an upper bound: registration, light, gloss, parallax and defocus only lower it"
"""What is said beside every verdict on a pose."""

_PLAIN_EVERY_S = 30.0
_WITHOUT_A_TERMINAL = 10_000
_LONGEST_ERROR = 4000
_WIDEST_TEXT = 120
_BEYOND_ASCII = re.compile(r"[^\x00-\x7f]")
_RESULTS = Console(
    soft_wrap=True, highlight=False, width=None if sys.stdout.isatty() else _WITHOUT_A_TERMINAL
)


class Bar:
    """Progress of one piece of work; ``advance_to`` sets how much is done.

    On a terminal a bar; elsewhere, such as in a log, a plain line now and then.
    """

    def __init__(self, progress: Progress, description: str, total: int) -> None:
        self._progress = progress
        self._is_plain = progress.disable
        self._task = progress.add_task(escape(on_one_line(description)), total=total)
        self._description, self._total = description, total
        self._begun_s = self._told_s = time.monotonic()
        self._every_s = _plain_period_s()

    def describe(self, description: str) -> None:
        """Say from the next piece on what is at work."""
        self._description = description

    def advance_to(self, done: int) -> None:
        """Show that ``done`` of the total are done."""
        if self._is_plain:
            self._tell(done)
            return
        shown = escape(on_one_line(self._description))
        self._progress.update(self._task, completed=done, description=shown)

    def _tell(self, done: int) -> None:
        now_s = time.monotonic()
        if now_s - self._told_s < self._every_s:
            return
        self._told_s = now_s
        text = f"{self._description}: {done} of {self._total} after {now_s - self._begun_s:.0f} s"
        ERRORS.print(on_one_line(text), markup=False)

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Hide the bar while the operator is asked something."""
        self._progress.stop()
        try:
            yield
        finally:
            self._progress.start()


def _plain_period_s() -> float:
    text = os.environ.get(PROGRESS_VARIABLE, "")
    return float(text) if text.isdigit() else _PLAIN_EVERY_S


@contextmanager
def progress_bar(description: str, total: int) -> Iterator[Bar]:
    """Show on stderr how far the block is: a bar on a terminal, else a line now and then."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=ERRORS, disable=not ERRORS.is_terminal) as progress:
        yield Bar(progress, description, total)


class ShownProgress:
    """Shows on stderr what a call of the library does."""

    def __init__(self) -> None:
        self._bar: Bar | None = None

    @contextmanager
    def bar(self, task: str, total: int) -> Iterator[Callable[[int], None]]:
        """Show a bar on a terminal, else a line now and then."""
        with progress_bar(task, total) as self._bar:
            yield self._bar.advance_to
        self._bar = None

    def describe(self, text: str) -> None:
        """Say on the bar, from the next piece on, what is at work."""
        if self._bar is not None:
            self._bar.describe(text)

    def hidden(self) -> AbstractContextManager[None]:
        """Hide the bar while the operator is asked something."""
        return nullcontext() if self._bar is None else self._bar.hidden()

    def note(self, text: str) -> None:
        """Print a remark at once."""
        note(text)


def print_json(document: object) -> None:
    """Print one JSON document on stdout: plain lists, numbers and text, or the model of a file."""
    if isinstance(document, BaseModel):
        from calibration.documents import json_object

        document = json_object(document)
    print_text(json.dumps(document, indent=1, allow_nan=False))


def print_json_file(path: Path) -> None:
    """Print the JSON document of a file on stdout; it need not fit into memory."""
    takes_any = _RESULTS.encoding.startswith("utf")
    with path.open(encoding="utf-8") as file:
        for line in file:
            sys.stdout.write(line if takes_any else _BEYOND_ASCII.sub(_json_escape, line))
    sys.stdout.flush()


def _json_escape(letter: re.Match[str]) -> str:
    return json.dumps(letter[0])[1:-1]


def print_text(text: str) -> None:
    """Print a text as it is, and what ends its last line."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def say(*lines: str) -> None:
    """Print lines of a result for people."""
    for line in lines:
        _RESULTS.print(on_one_line(line), markup=False)


def note(*remarks: str) -> None:
    """Print remarks on stderr, a line each, that are worth knowing but no errors."""
    for remark in map(on_one_line, remarks):
        if (noted := NOTED.get()) is not None:
            noted.append(remark)
        ERRORS.print(f"note: {remark}", markup=False)


def note_once(remarks: Iterable[str]) -> None:
    """Print the remarks of a result that were not printed while it was made."""
    noted = NOTED.get() or []
    for remark in remarks:
        if on_one_line(remark) not in noted:
            note(remark)


def note_in_passing(text: str) -> None:
    """Print a remark on stderr about the command, not about its results: no report repeats it."""
    ERRORS.print(f"note: {on_one_line(text)}", markup=False)


def say_error(text: object) -> None:
    """Print why the command ends, in one line on stderr."""
    line = on_one_line(text)
    if len(line) > _LONGEST_ERROR:  # a value from a file, repeated as it was found
        half = _LONGEST_ERROR // 2
        line = f"{line[:half]} [...] {line[-half:]}"
    ERRORS.print(f"standoff: {line}", markup=False)


def print_table(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    ends_in_words: bool = False,
) -> None:
    """Print a table; the first column is text and wraps if space is short, the others numbers.

    With ``ends_in_words`` the last column is text, too. Then everything wraps, at the width of the
    terminal, elsewhere at 120 characters.
    """
    # Laid out as they will be shown: what the encoding lacks is wider where it is spelt out.
    columns = [_as_shown(column) for column in columns]
    rows = [[_as_shown(cell) for cell in row] for row in rows]
    # Names of files and folders may contain brackets, which are not markup.
    table = Table(title=Text(_as_shown(title)), title_justify="left", title_style="bold")
    for index, column in enumerate(columns):
        is_text = index == 0 or (ends_in_words and index == len(columns) - 1)
        if is_text or ends_in_words:
            table.add_column(Text(column), justify="left" if is_text else "right", overflow="fold")
        else:
            widest = max((len(row[index]) for row in rows), default=0)
            table.add_column(
                Text(column), justify="right", no_wrap=True, min_width=max(widest, len(column))
            )
    for row in rows:
        table.add_row(*map(Text, row))
    _RESULTS.print(table, width=min(_RESULTS.width, _WIDEST_TEXT) if ends_in_words else None)


def print_items(
    title: str,
    items: Iterable[_Item],
    cells: Mapping[str, Callable[[_Item], str]],
    *,
    ends_in_words: bool = False,
) -> None:
    """Print a table with a row of each item, by columns that say what stands in them."""
    rows = [[cell(one) for cell in cells.values()] for one in items]
    print_table(title, tuple(cells), rows, ends_in_words=ends_in_words)


def _as_shown(text: str) -> str:
    return as_shown(on_one_line(text), _RESULTS.encoding)


def print_next_steps(steps: Sequence[tuple[str, str]]) -> None:
    """Print what each command is for, and the command that a POSIX shell takes from here."""
    say("", "What to try next, ready to run:")
    for purpose, command in steps:
        say("", f"  # {purpose}", f"  {command}")


def command_line(*words: str | int | Path) -> str:
    """Return a command of standoff as this shell starts it: by its name where the PATH has it."""
    return shlex.join((*_program(), *map(str, words)))


def _program() -> tuple[str, ...]:
    started = Path(sys.argv[0])
    if started.name != "standoff":  # python -m standoff
        return (sys.executable, "-m", "standoff")
    on_path = shutil.which("standoff")
    if on_path is not None and Path(on_path).resolve() == started.resolve():
        return ("standoff",)
    return (str(started),)


_INTERVAL_S = 0.1
_PLAIN_INTERVAL_S = 1.0
_BAR_CELLS = 30
_ARROWS = {"rising": "↑ rising ", "steady": "→ steady ", "falling": "↓ falling"}


class LiveLine(ExitStack):
    """Shows texts on stderr: in place on a terminal, else as one plain line per second."""

    def __init__(self) -> None:
        super().__init__()
        self._shown_s: float | None = None
        self._live = Live(console=ERRORS, auto_refresh=False) if ERRORS.is_terminal else None

    def show(self, text: str, style: str = "", *, now_s: float) -> None:
        """Draw a text, unless one was drawn a moment before: faster than the eye can follow."""
        text = on_one_line(text)
        interval_s = _PLAIN_INTERVAL_S if self._live is None else _INTERVAL_S
        if self._shown_s is not None and now_s - self._shown_s < interval_s:
            return
        if self._live is not None and self._shown_s is None:
            self.enter_context(self._live)
        self._shown_s = now_s
        if self._live is None:
            ERRORS.print(text, markup=False)
        else:
            self._live.update(Text(text, style=style), refresh=True)


@contextmanager
def focus_display() -> Iterator[Callable[[FocusReading, float], None]]:
    """Yield a callback that shows a reading of the focus aid, given that and its time in s."""
    with LiveLine() as line:
        yield lambda reading, now_s: line.show(
            _reading_text(reading), "yellow" if reading.is_past_peak else "", now_s=now_s
        )


def _reading_text(reading: FocusReading) -> str:
    """Value, bar, trend, share of the peak and the peak, as one line of text."""
    if not reading.has_detail:
        return f"focus {'–':>10} nothing to focus on"
    share = reading.percent_of_peak
    filled = round(_BAR_CELLS * min(max(share, 0.0), 100.0) / 100.0)
    bar = "█" * filled + "·" * (_BAR_CELLS - filled)
    hint = "   past the peak: go back" if reading.is_past_peak else ""
    return (
        f"focus {reading.value:10.5g} {bar} {share:5.1f} % of peak {reading.peak:.5g}  "
        f"{_ARROWS[reading.trend]}{hint}"
    )


_VERDICT_STYLES = {"go": "bold green", "no go": "bold red", "unsure": "bold yellow"}


def _verdict_line(name: str, verdict: PoseVerdict) -> str:
    """One line for the operator: verdict, margin and reason."""
    word = "accept" if verdict.accepted else "reject" if verdict.dprime is not None else "lost"
    if verdict.verdict == "unsure":
        word = "unsure"
    margin = "" if verdict.margin is None else f"{100 * verdict.margin:+6.1f} %"
    return f"{name:<12} {word:<6} {margin:>8}  {verdict.reason}"


@contextmanager
def verdict_display(
    *, is_live: bool, is_silent: bool
) -> Iterator[Callable[[str, PoseVerdict], None]]:
    """Yield a callback that shows a verdict of a stream, given the frame's name and the verdict.

    A camera's verdicts go to stderr, no faster than the eye; a folder's all go to stdout, unless
    ``is_silent``: that is for a JSON document.
    """
    if is_live:
        with LiveLine() as line:
            yield lambda name, verdict: line.show(
                _verdict_line(name, verdict),
                _VERDICT_STYLES[verdict.verdict],
                now_s=time.monotonic(),
            )
    elif is_silent:
        yield lambda name, verdict: None
    else:
        yield lambda name, verdict: say(_verdict_line(name, verdict))
