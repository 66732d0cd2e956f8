"""Kill -9 at random moments, on the real disk; test_journal cuts the journal at every byte."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO

import pytest

from acquisition.session._files import JOURNAL_NAME
from acquisition.session._reader import Session, verify
from tests.acquisition.capture_until_killed import HEIGHTS

KILLS = 50


class Runs:
    """Runs of one session, each in a process of its own."""

    def __init__(self, requests: IO[str], answers: IO[str]) -> None:
        self._requests = requests
        self._answers = answers
        self._unread: list[str] = []

    def begin(self, path: Path) -> int:
        """Begin a run and return the id of its process."""
        self._requests.write(f"{path}\n")
        self._requests.flush()
        return int(self._line().removeprefix("child "))

    def stored(self, captures: int) -> int:
        """Wait for so many more captures, or the end; return how many the session has then."""
        found = 0
        for _ in range(captures):
            line = self._line()
            if line == "end":
                self._unread.append(line)
                break
            found = int(line)
        return found

    def end(self) -> list[str]:
        """Wait for the end of the run and return what it wrote until then."""
        lines: list[str] = []
        while (line := self._line()) != "ended":
            lines.append(line)
        return lines

    def _line(self) -> str:
        if self._unread:
            return self._unread.pop()
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
    """Count the captures, each of which must be whole; of one at most the line may be missing."""
    session = Session(path)
    bad = [check for check in verify(path).files if check.state not in ("ok", "unfinished")]
    assert {check.state for check in bad} <= {"unjournaled"}
    assert len(bad) <= 2  # the capture and its raw frames
    for record in session.records:
        session.load(record)
    return len(session.records)


def files(path: Path) -> dict[str, bytes]:
    """Bytes of every file that the journal knows."""
    return {
        file: (path / file).read_bytes()
        for capture in Session(path).captures
        for file in (capture.record.file, capture.record.frames_file)
        if file is not None
    }


@pytest.mark.slow
def test_killed_at_50_random_moments_a_session_loses_nothing_and_resumes_to_the_end(
    tmp_path: Path, runs: Runs
) -> None:
    moments = random.Random(20250304)
    kills = sessions = 0
    while kills < KILLS:
        # A quick machine may end a session between two kills; the next one begins another.
        path = tmp_path / f"session-{sessions}"
        sessions += 1
        journal = b""
        before: dict[str, bytes] = {}
        is_ended = False
        while kills < KILLS and not is_ended:
            child = runs.begin(path)
            # From the first moment of a run to some captures later, in the midst of one.
            stored = runs.stored(moments.randrange(3) if before else 1)
            time.sleep(moments.uniform(0.0, 0.02))
            with suppress(ProcessLookupError):  # ended by itself
                os.kill(child, signal.SIGKILL)
            lines = runs.end()
            is_ended = "end" in lines
            kills += not is_ended
            assert captured(path) >= max([stored, *(int(n) for n in lines if n != "end")])
            # What was journaled before is there, byte for byte.
            now = files(path)
            assert before.items() <= now.items()
            assert (path / JOURNAL_NAME).read_bytes().startswith(journal)
            before = now
            journal = (path / JOURNAL_NAME).read_bytes().rpartition(b"\n")[0]
        if not is_ended:
            runs.begin(path)
            assert runs.end()[-1] == "end"
        assert before.items() <= files(path).items()
        assert captured(path) == 3 * HEIGHTS
        assert verify(path).is_ok
    assert sessions <= KILLS / 5
