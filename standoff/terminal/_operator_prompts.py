"""What the operator at the bench is shown and asked, who answers at the terminal or by a script."""

import math
import os
import select
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import typer

from acquisition.capture import Placement, QualityFinding, Verdict
from acquisition.plan import PlanEntry, PlanEstimate
from acquisition.session import SPARE_BYTES
from standoff.errors import ApplicationError
from standoff.terminal._output import ERRORS

PLACE_QUESTION = "Enter to capture, s to skip"
LONGEST_ANSWER = 1000
RETAKE_QUESTION = "Enter to keep it, r to retake it"


class Operator:
    """The operator who places targets; asks until it gets a valid answer.

    ``answer`` asks a question and returns the answer without its line ending, ``hidden`` hides the
    progress display meanwhile.
    """

    def __init__(
        self,
        answer: Callable[[str], str],
        hidden: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._answer = answer
        self.hidden = hidden

    def ask(self, question: str) -> str:
        """Ask a question on stderr; a terminal that was closed (Ctrl-D) interrupts."""
        with self.hidden():
            return self._answer(question)

    def place(self, entry: PlanEntry) -> Placement:
        """Ask the operator to place the target."""
        with self.hidden():
            ERRORS.print(what_to_place(entry), markup=False)
            return "skip" if self._choose(PLACE_QUESTION, "s") else "ready"

    def review(self, entry: PlanEntry, findings: tuple[QualityFinding, ...]) -> Verdict:
        """Ask whether to retake a bad capture; a script keeps it."""
        return "keep"

    def wait_if_asked(self) -> None:
        """Wait between two captures if the operator asked to."""

    def _choose(self, question: str, letter: str) -> bool:
        """Whether the answer is the letter, not Enter; ask again after anything else."""
        while True:
            answer = self._answer(question).strip().lower()
            if answer in ("", letter):
                return answer == letter
            ERRORS.print(f"{answer!r} is not a valid answer.", markup=False)


class TerminalOperator(Operator):
    """The operator at this terminal; Enter during a capture makes the next one wait."""

    def __init__(self, hidden: Callable[[], AbstractContextManager[None]] = nullcontext) -> None:
        super().__init__(_typed_answer, hidden)

    def review(self, entry: PlanEntry, findings: tuple[QualityFinding, ...]) -> Verdict:
        """Show the findings and ask whether to retake the capture."""
        with self.hidden():
            for finding in findings:
                text = f"Capture {entry.index}: {finding.problem}: {finding.text}."
                ERRORS.print(text, markup=False)
            return "retake" if self._choose(RETAKE_QUESTION, "r") else "keep"

    def wait_if_asked(self) -> None:
        """Pause if Enter was pressed."""
        if select.select([sys.stdin], [], [], 0)[0]:
            with self.hidden():
                self._answer("Paused. Enter to continue")


class ScriptedOperator(Operator):
    """A script that answers each question with one line; errors name its source."""

    def __init__(self, lines: Iterator[str], source: str) -> None:
        super().__init__(self._next_line)
        self._lines = lines
        self._source = source

    def _next_line(self, question: str) -> str:
        ERRORS.print(f"{question}:", markup=False)
        line = next(self._lines, "")
        if not line:
            raise ApplicationError(
                f"{self._source} has no answer left for: {question}; "
                "give one line per question and run the same command again"
            )
        if len(line) > LONGEST_ANSWER:
            raise ApplicationError(
                f"{self._source} contains a line of more than {LONGEST_ANSWER} characters, which "
                f"cannot be an answer to: {question}"
            )
        return line.rstrip("\r\n")


def what_to_place(entry: PlanEntry) -> str:
    """Tell the operator in a sentence what to place for an entry."""
    if entry.kind == "dark":
        return f"Put the lens cap on, and keep out stray light ({entry.target!r})."
    if entry.kind == "flat":
        return f"Lens cap off. Place a uniform white surface, out of focus: {entry.target!r}."
    return f"Place {entry.kind} {entry.target!r} at {entry.orientation_deg:g} degrees."


def _typed_answer(question: str) -> str:
    _forget_what_was_typed()
    try:
        answer: str = typer.prompt(question, default="", show_default=False, err=True)
    except typer.Abort:
        raise KeyboardInterrupt from None
    return answer


def _forget_what_was_typed() -> None:
    """Discard what was typed before the question: it does not answer it."""
    try:
        import termios  # Windows has none
    except ModuleNotFoundError:
        return
    if os.isatty(sys.stdin.fileno()):
        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def preview_line(estimate: PlanEstimate, out: Path) -> str:
    """Captures, time and disk use in words."""
    placing = f"{estimate.placements} placements" if estimate.placements != 1 else "1 placement"
    free = _free_bytes(out)
    room = f"{free / 1e6:.0f} MB free"
    if estimate.bytes_ is not None and free < estimate.bytes_ + SPARE_BYTES:
        room += f", which is NOT ENOUGH: {SPARE_BYTES / 1e6:.0f} MB must stay free"
    if estimate.bytes_ is None:
        disk = f"disk use depends on the camera's frame ({room})"
    else:
        disk = f"{estimate.bytes_ / 1e6:.0f} MB on disk ({room})"
    return (
        f"{estimate.captures} captures, {placing}: about {time_text(estimate.seconds)} "
        f"plus the operator's own time; {disk}"
    )


def time_text(seconds: float) -> str:
    """A duration in hours, minutes or seconds: ``1 h 05 min``, ``3 min 20 s``, ``7 s``."""
    whole = math.ceil(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"


def _free_bytes(path: Path) -> int:
    there = path.resolve()
    while not there.exists():
        there = there.parent
    return shutil.disk_usage(there).free
