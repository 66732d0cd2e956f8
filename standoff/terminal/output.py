"""What a command prints: results for people or one JSON document, progress on stderr."""

import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from pathlib import Path

from pydantic import BaseModel
from rich.console import Console
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


def _as_shown(text: str) -> str:
    return as_shown(on_one_line(text), _RESULTS.encoding)
