"""Questions to the operator, asked by a job and answered by whoever is in control."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition

from acquisition.capture import Placement, QualityFinding, Verdict
from acquisition.plan import PlanEntry
from standoff.terminal import what_to_place

STOP_CHECK_S = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """One button: ``key`` is the answer."""

    key: str
    label: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Prompt:
    """A question; ``wants_text`` asks for a line of text besides the choice."""

    number: int
    text: str
    choices: tuple[Choice, ...]
    wants_text: bool = False


def what_is_placed(entry: PlanEntry) -> str:
    """Name what an entry's placement is, for a question or a line about it."""
    if entry.kind == "dark":
        return "Lens cap"
    if entry.kind == "flat":
        return f"White surface {entry.target!r}"
    return f"{entry.kind.capitalize()} {entry.target!r} at {entry.orientation_deg:g} degrees"


class PromptQueue:
    """Shows one question at a time; the asking thread waits.

    Parameters
    ----------
    check
        Called while waiting; may raise to end the wait.
    """

    def __init__(self, check: Callable[[], None]) -> None:
        self._check = check
        self._changed = Condition()
        self._prompt: Prompt | None = None
        self._answer: tuple[str, str] | None = None
        self._asked = 0

    @property
    def current(self) -> Prompt | None:
        """The question that is waiting for an answer."""
        return self._prompt

    def answer(self, number: int, choice: str, text: str = "") -> bool:
        """Answer a question; False if it is not the one waiting, or has no such choice."""
        with self._changed:
            prompt = self._prompt
            if prompt is None or prompt.number != number:
                return False
            if choice not in {each.key for each in prompt.choices}:
                return False
            self._answer = (choice, text)
            self._changed.notify_all()
        return True

    def place(self, entry: PlanEntry) -> Placement:
        """Ask the operator to place a target.

        Raises
        ------
        OperatorStopError
            If the job is stopped meanwhile, as for all questions.
        """
        return self._placement(what_to_place(entry))

    def confirm(self, entry: PlanEntry) -> Placement:
        """Ask the operator whether a target is still in place."""
        return self._placement(f"{what_is_placed(entry)}: still in place? If not, place it again.")

    def review(self, entry: PlanEntry, findings: tuple[QualityFinding, ...]) -> Verdict:
        """Ask whether to retake a bad capture."""
        found = "; ".join(f"{finding.problem}: {finding.text}" for finding in findings)
        choices = (Choice(key="retake", label="Retake it"), Choice(key="keep", label="Keep it"))
        choice, _ = self._ask(f"Capture {entry.index} of {entry.target!r}: {found}.", choices)
        return "retake" if choice == "retake" else "keep"

    def ask(self, question: str) -> str:
        """Ask a question that is answered by a line of text; an empty one confirms."""
        _, text = self._ask(question, (Choice(key="ok", label="Confirm"),), wants_text=True)
        return text

    def _placement(self, text: str) -> Placement:
        choices = (Choice(key="ready", label="It is in place"), Choice(key="skip", label="Skip it"))
        choice, _ = self._ask(text, choices)
        return "skip" if choice == "skip" else "ready"

    def _ask(
        self, text: str, choices: tuple[Choice, ...], *, wants_text: bool = False
    ) -> tuple[str, str]:
        with self._changed:
            self._asked += 1
            self._answer = None
            self._prompt = Prompt(
                number=self._asked, text=text, choices=choices, wants_text=wants_text
            )
            try:
                while self._answer is None:
                    self._check()
                    self._changed.wait(STOP_CHECK_S)
                return self._answer
            finally:
                self._prompt = None
