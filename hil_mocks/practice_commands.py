"""Commands typed at a running practice bench: targets, heights and faults."""

from collections.abc import Callable
from dataclasses import replace
from math import isfinite

from hil_mocks.gige import GigeFaults
from hil_mocks.practice_bench import HandStage, PracticeBench, StageEmulator

TRUTH_VALUES = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


class PracticeCommandError(Exception):
    """The practice bench does not understand a line; nothing was done.

    ``word`` is the part of the line that is wrong.
    """

    def __init__(self, text: str, word: str) -> None:
        super().__init__(text)
        self.word = word


class PracticeConsole:
    """Executes one line at a time on a practice bench.

    Parameters
    ----------
    bench
        The running bench.
    stage
        Its stage.
    """

    def __init__(self, bench: PracticeBench, stage: StageEmulator) -> None:
        self._bench = bench
        self._stage = stage
        self._commands: dict[str, Callable[[list[str]], str]] = {
            "place": self._place,
            "height": self._height,
            "fault": self._fault,
            "restart": self._restart,
            "drop-control": self._drop_control,
            "status": self._status,
        }

    def execute(self, line: str) -> str:
        """Execute a line and return what was done.

        Raises
        ------
        PracticeCommandError
            If it is not understood.
        """
        name, *words = line.split()
        command = self._commands.get(name)
        if command is None:
            raise PracticeCommandError(
                f"unknown command {name}; the commands are {', '.join(self._commands)}", name
            )
        return command(words)

    def _place(self, words: list[str]) -> str:
        if not 1 <= len(words) <= 2:
            raise PracticeCommandError("expected: place TARGET [DEGREES]", "place")
        orientation_deg = _number(words[1]) if len(words) == 2 else 0.0
        try:
            self._bench.place(words[0], orientation_deg)
        except ValueError as error:
            at_fault = words[0] if isfinite(orientation_deg) else words[1]
            raise PracticeCommandError(str(error), at_fault) from error
        return self._status([])

    def _height(self, words: list[str]) -> str:
        if len(words) != 1:
            raise PracticeCommandError("expected: height MM", "height")
        if not isinstance(self._stage, HandStage):
            raise PracticeCommandError(
                "the stage of this bench is moved through its serial port", "height"
            )
        try:
            self._stage.move_to(_number(words[0]))
        except ValueError as error:
            raise PracticeCommandError(str(error), words[0]) from error
        return self._status([])

    def _fault(self, words: list[str]) -> str:
        if words == ["none"]:
            self._bench.camera.faults = GigeFaults()
        else:
            self._bench.camera.faults = faults_from_words(self._bench.camera.faults, words)
        return self._status([])

    def _restart(self, _: list[str]) -> str:
        self._bench.camera.restart()
        return "the camera was restarted"

    def _drop_control(self, _: list[str]) -> str:
        self._bench.camera.drop_control()
        return "the camera is not under anyone's control"

    def _status(self, _: list[str]) -> str:
        bench = self._bench
        on = [
            f"{name}={getattr(bench.camera.faults, name)}"
            for name in GigeFaults.names()
            if getattr(bench.camera.faults, name) != getattr(GigeFaults(), name)
        ]
        return (
            f"target {bench.target} at {bench.orientation_deg:g} degrees, "
            f"height {self._stage.true_height_mm:.3f} mm, faults: {', '.join(on) or 'none'}"
        )


def faults_from_words(faults: GigeFaults, words: list[str]) -> GigeFaults:
    """Return the faults with new values: ``packet_loss_rate=0.01 is_stalled=true``.

    Raises
    ------
    PracticeCommandError
        If there is no such fault or its value is invalid.
    """
    if not words:
        raise PracticeCommandError(
            f"expected: fault NAME=VALUE ... or fault none; "
            f"faults are {', '.join(GigeFaults.names())}",
            "fault",
        )
    for word in words:
        name, equals, text = word.partition("=")
        if name not in GigeFaults.names() or not equals:
            raise PracticeCommandError(
                f"{word}: expected NAME=VALUE; faults are {', '.join(GigeFaults.names())}", word
            )
        try:
            value = _value(name, text, getattr(faults, name))
            faults = replace(faults, **{name: value})  # type: ignore[arg-type]  # of the default's type
        except ValueError as error:
            raise PracticeCommandError(str(error), word) from error
    return faults


def _value(name: str, text: str, like: object) -> bool | int | float | frozenset[str]:
    if isinstance(like, bool):
        if text.lower() not in TRUTH_VALUES:
            raise ValueError(f"{name} must be true or false, got {text}")
        return TRUTH_VALUES[text.lower()]
    if isinstance(like, frozenset):
        return frozenset(part for part in text.split(",") if part)
    value = _number(text)
    if isinstance(like, int):
        if not value.is_integer():
            raise ValueError(f"{name} must be a whole number, got {text}")
        return int(value)
    return value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise PracticeCommandError(f"not a number: {text}", text) from error
