"""Kill -9 at random moments, on the real disk; test_journal cuts the journal at every byte."""

import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from acquisition.session import Session, verify
from tests.acquisition.capture_until_killed import HEIGHTS

KILLS = 10


def begin(path: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "tests.acquisition.capture_until_killed", str(path)],
        stdout=subprocess.PIPE,
        text=True,
    )


def captured(path: Path) -> int:
    """Count the captures, each of which must be whole."""
    session = Session.open(path)
    assert verify(path).is_ok
    for record in session.records:
        session.load(record)
    return len(session.records)


@pytest.mark.slow
def test_killed_at_random_moments_a_session_loses_nothing_and_resumes_to_the_end(
    tmp_path: Path,
) -> None:
    path = tmp_path / "session"
    moments = random.Random(20250304)
    stored = 0
    for _ in range(KILLS):
        with begin(path) as process:
            assert process.stdout is not None
            for _ in range(moments.randrange(1, 9)):
                stored = int(process.stdout.readline())
            time.sleep(moments.uniform(0.0, 0.008))  # about the time of one capture
            process.kill()
        assert captured(path) >= stored
    with begin(path) as process:
        process.communicate(timeout=60)
        assert process.returncode == 0
    assert captured(path) == 3 * HEIGHTS
    assert Session.open(path).is_complete
