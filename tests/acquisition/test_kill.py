"""Kill -9 at random moments, on the real disk; test_journal cuts the journal at every byte."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest

from acquisition.session import JOURNAL_NAME, Session, verify
from tests.acquisition.capture_until_killed import HEIGHTS

KILLS = 50


class Runs:
    """Runs of one session, each in a process of its own."""

    def __init__(self, requests: IO[str], answers: IO[str]) -> None:
        self._requests = requests
        self._answers = answers

    def begin(self, path: Path) -> int:
        """Begin a run and return the id of its process."""
        self._requests.write(f"{path}\n")
        self._requests.flush()
        return int(self._line().removeprefix("child "))

    def stored(self, captures: int) -> int:
        """Wait for so many more captures and return how many the session has then."""
        return max((int(self._line()) for _ in range(captures)), default=0)

    def end(self) -> list[str]:
        """Wait for the end of the run and return what it wrote until then."""
        lines: list[str] = []
        while (line := self._line()) != "ended":
            lines.append(line)
        return lines

    def _line(self) -> str:
        line = self._answers.readline().rstrip("\n")
        assert line, "the server of the runs is gone"
        return line


@pytest.fixture
def runs() -> Iterator[Runs]:
    with subprocess.Popen(
        [sys.executable, "-m", "tests.acquisition.capture_until_killed"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        yield Runs(server.stdin, server.stdout)
        server.stdin.close()


def captured(path: Path) -> int:
    """Count the captures, each of which must be whole."""
    session = Session.open(path)
    assert verify(path).is_ok
    for record in session.records:
        session.load(record)
    return len(session.records)


def files(path: Path) -> dict[str, bytes]:
    """Bytes of every file that the journal knows."""
    return {
        file: (path / file).read_bytes()
        for capture in Session.open(path).captures
        for file in (capture.record.file, capture.record.frames_file)
        if file is not None
    }


@pytest.mark.slow
def test_killed_at_50_random_moments_a_session_loses_nothing_and_resumes_to_the_end(
    tmp_path: Path, runs: Runs
) -> None:
    path = tmp_path / "session"
    moments = random.Random(20250304)
    journal = b""
    before: dict[str, bytes] = {}
    for kill in range(KILLS):
        child = runs.begin(path)
        # From the first moment of a run to some captures later, in the midst of one.
        stored = runs.stored(moments.randrange(3) if kill else 1)
        time.sleep(moments.uniform(0.0, 0.02))
        os.kill(child, signal.SIGKILL)
        stored = max([stored, *(int(line) for line in runs.end())])
        assert captured(path) >= stored
        # What was journaled before is there, byte for byte.
        now = files(path)
        assert before.items() <= now.items()
        assert (path / JOURNAL_NAME).read_bytes().startswith(journal)
        before = now
        journal = (path / JOURNAL_NAME).read_bytes().rpartition(b"\n")[0]
    assert len(before) < 2 * 3 * HEIGHTS  # every kill found a run at work
    runs.begin(path)
    assert runs.end()[-1] == "end"
    assert before.items() <= files(path).items()
    assert captured(path) == 3 * HEIGHTS
    session = Session.open(path)
    assert {record.index for record in session.records} == set(range(3 * HEIGHTS))
    assert session.is_complete
