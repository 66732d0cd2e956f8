"""Ctrl-C and SIGTERM are raised once, whatever is imported when they come."""

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import FrameType

import pytest

import standoff.cli
import standoff.interrupts
from standoff.interrupts import interruption

SWALLOWED = """
import contextlib, signal
with contextlib.suppress(KeyboardInterrupt):
    signal.raise_signal(signal.{name})
is_whole = True
"""

IN_A_CLASS = """
import signal

class Pressed:
    def __set_name__(self, owner, name):
        signal.raise_signal(signal.{name})

class Model:
    field = Pressed()

is_whole = True
"""

LONG = """
import signal, time
signal.raise_signal(signal.SIGINT)
time.sleep(300)
"""

REPLACED = """
import signal
came = []
signal.raise_signal(signal.SIGINT)
signal.signal(signal.SIGINT, lambda *_: came.append(True))
"""

MODELS = """
from typing import Annotated
from pydantic import BaseModel, Field, field_validator

class Stage(BaseModel):
    step_um: Annotated[float, Field(gt=0)] = 1.0

    @field_validator("step_um")
    @classmethod
    def check(cls, value: float) -> float:
        return value

class Bench(BaseModel):
    stages: list[Stage]

is_whole = True
"""


class Source:
    """A module of which each import executes the text anew."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "interrupted_module.py"

    def write(self, text: str) -> None:
        self._file.write_text(text, encoding="utf-8")
        self.forget()

    def forget(self) -> None:
        sys.modules.pop(self._file.stem, None)

    def load(self) -> None:
        import_module(self._file.stem)

    def load_and_wait(self) -> None:
        """Import it; the signal that came on the way is raised within a minute."""
        self.load()
        time.sleep(60)
        pytest.fail("the signal was lost")

    @property
    def is_whole(self) -> bool:
        return hasattr(sys.modules.get(self._file.stem), "is_whole")


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Source]:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    source = Source(tmp_path)
    yield source
    source.forget()


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("text", [SWALLOWED, IN_A_CLASS])
def test_what_comes_in_an_import_is_raised_after_it(source: Source, text: str, name: str) -> None:
    source.write(text.format(name=name))
    with interruption() as interrupted, pytest.raises(KeyboardInterrupt):
        source.load_and_wait()
    assert source.is_whole
    assert interrupted.terminated == (name == "SIGTERM")


def test_outside_of_imports_it_is_raised_at_once() -> None:
    with interruption(), pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.slow
def test_ctrl_c_at_any_call_of_an_import_is_raised_once_after_it(source: Source) -> None:
    source.write(MODELS)
    source.load()  # so that pydantic is there
    source.forget()
    with interruption():
        with _pressing_at(sys.maxsize) as calls:
            source.load()
        assert len(calls) > 200
        # Calls count from one, and load_and_wait is one more.
        begin = calls.index("_find_and_load") + 2
        for number in range(begin, len(calls) - 10, len(calls) // 60):
            source.forget()
            with pytest.raises(KeyboardInterrupt), _pressing_at(number):
                source.load_and_wait()
            assert source.is_whole
        time.sleep(0.1)  # no second one comes


@contextmanager
def _pressing_at(number: int) -> Iterator[list[str]]:
    """Press Ctrl-C at this call of a function in the block; yields the names of those called."""
    called: list[str] = []

    def press(frame: FrameType, event: str, _argument: object) -> None:
        if event == "call":
            called.append(frame.f_code.co_name)
            if len(called) == number:
                signal.raise_signal(signal.SIGINT)

    sys.setprofile(press)
    try:
        yield called
    finally:
        sys.setprofile(None)


def test_an_import_that_lasts_is_interrupted_itself(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standoff.interrupts, "WAITS_AT_MOST_S", 0.1)
    source.write(LONG)
    with interruption(), pytest.raises(KeyboardInterrupt):
        source.load()
    assert not source.is_whole


def test_what_handles_the_signal_by_the_end_of_the_import_gets_it(source: Source) -> None:
    source.write(REPLACED)
    with interruption():
        source.load()
        came: list[bool] = sys.modules["interrupted_module"].came
        ends_s = time.monotonic() + 60
        while not came and time.monotonic() < ends_s:
            time.sleep(0.01)
    assert came == [True]


def test_the_second_sigterm_is_not_ours() -> None:
    with interruption() as interrupted:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        assert interrupted.terminated
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_an_ignored_ctrl_c_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interruption():
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_afterwards_all_is_as_it_was(source: Source) -> None:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    before = [signal.getsignal(number) for number in numbers]
    source.write(SWALLOWED.format(name="SIGINT"))
    with interruption():
        source.load()  # and the block ends before the signal is raised
    assert [signal.getsignal(number) for number in numbers] == before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_a_command_ends_with_status_130_whatever_the_import_made_of_ctrl_c(
    source: Source, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source.write(IN_A_CLASS.format(name="SIGINT"))
    monkeypatch.setattr(standoff.cli, "drop_stale_code", source.load_and_wait)
    with pytest.raises(SystemExit) as ended:
        standoff.cli.main()
    assert ended.value.code == 130
    assert capsys.readouterr().err == "standoff: interrupted; run the same command again\n"
