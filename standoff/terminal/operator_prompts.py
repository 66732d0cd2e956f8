"""Questions to the operator at the bench, answered at the terminal or by a script's lines."""

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext

import typer

from acquisition.capture import Placement, QualityFinding, Verdict
from acquisition.plan import PlanEntry
from standoff.errors import ApplicationError
from standoff.terminal.output import ERRORS

PLACE_QUESTION = "Enter to capture, s to skip"
RETAKE_QUESTION = "Enter to keep it, r to take it again"


class Operator:
    """Whoever places targets: asks until an answer is understood.

    Parameters
    ----------
    answer
        Puts a question and returns what was answered, without the end of its line.
    hidden
        Takes the progress display away while the operator is asked.
    """

    def __init__(
        self,
        answer: Callable[[str], str],
        hidden: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._answer = answer
        self.hidden = hidden

    def ask(self, question: str) -> str:
        """Put a question, on stderr.

        Raises
        ------
        KeyboardInterrupt
            If the terminal's input was ended (Ctrl-D).
        ApplicationError
            If a script's answers have come to their end.
        """
        with self.hidden():
            return self._answer(question)

    def place(self, entry: PlanEntry) -> Placement:
        """Have the target placed."""
        with self.hidden():
            ERRORS.print(what_to_place(entry), markup=False)
            return "skip" if self._choose(PLACE_QUESTION, "s") else "ready"

    def review(self, entry: PlanEntry, findings: tuple[QualityFinding, ...]) -> Verdict:
        """Ask whether a bad capture is to be taken again; a script keeps it."""
        return "keep"

    def wait_if_asked(self) -> None:
        """Wait between two captures if the operator wants that."""

    def _choose(self, question: str, letter: str) -> bool:
        """Whether the answer is the letter, not Enter; anything else is asked again."""
        while True:
            answer = self._answer(question).strip().lower()
            if answer in ("", letter):
                return answer == letter
            ERRORS.print(f"{answer!r} is no answer to that.", markup=False)


class TerminalOperator(Operator):
    """The operator at this terminal; a line typed during the captures makes the next one wait."""

    def __init__(self, hidden: Callable[[], AbstractContextManager[None]] = nullcontext) -> None:
        super().__init__(_typed_answer, hidden)

    def review(self, entry: PlanEntry, findings: tuple[QualityFinding, ...]) -> Verdict:
        """Show the findings and ask."""
        with self.hidden():
            for finding in findings:
                text = f"Capture {entry.index}: {finding.problem}: {finding.text}."
                ERRORS.print(text, markup=False)
            return "retake" if self._choose(RETAKE_QUESTION, "r") else "keep"

    def wait_if_asked(self) -> None:
        """Pause if a line was typed."""
        if select.select([sys.stdin], [], [], 0)[0]:
            with self.hidden():
                self._answer("Paused. Enter to go on")


class ScriptedOperator(Operator):
    """A script that answers each question with one line.

    Parameters
    ----------
    lines
        The answers in turn.
    source
        What to call them in an error.
    """

    def __init__(self, lines: Iterator[str], source: str) -> None:
        super().__init__(self._next_line)
        self._lines = lines
        self._source = source

    def _next_line(self, question: str) -> str:
        ERRORS.print(f"{question}:", markup=False)
        line = next(self._lines, "")
        if not line:
            raise ApplicationError(
                f"{self._source} has no answer left to: {question}; "
                "give one line for each question and run the same command again"
            )
        return line.rstrip("\r\n")


def what_to_place(entry: PlanEntry) -> str:
    """Say in a sentence what an entry needs under the camera."""
    if entry.kind == "dark":
        return f"Put the lens cap on, and keep stray light off ({entry.target!r})."
    if entry.kind == "flat":
        return f"Lens cap off. Place an even white surface, defocused: {entry.target!r}."
    return f"Place {entry.kind} {entry.target!r} at {entry.orientation_deg:g} degrees."


def _typed_answer(question: str) -> str:
    _forget_what_was_typed()
    try:
        answer: str = typer.prompt(question, default="", show_default=False, err=True)
    except typer.Abort:
        raise KeyboardInterrupt from None
    return answer


def _forget_what_was_typed() -> None:
    """Drop what came before the question was there: it is no answer to it."""
    try:
        import termios  # Windows has none
    except ModuleNotFoundError:
        return
    if os.isatty(sys.stdin.fileno()):
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
