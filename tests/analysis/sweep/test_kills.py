import os
import random
import signal
import threading
from pathlib import Path

import pytest

from analysis.sweep import Manifest, SweepOptions, run_sweep
from tests.analysis.sweep.hashing import Hashing, answers, photographs

KILLS = 5


@pytest.fixture
def expected(tmp_path: Path) -> dict[Path, str]:
    (tmp_path / "expected").mkdir()
    work = Hashing(tmp_path / "expected")
    with Manifest(photographs(tmp_path / "photographs", 300), work.state) as manifest:
        run_sweep(manifest, work)
        return answers(manifest, work)


@pytest.mark.slow
def test_workers_killed_at_random_moments_change_nothing(
    expected: dict[Path, str], tmp_path: Path
) -> None:
    work = Hashing(tmp_path / "state", delay_s=0.2)
    work.folder.mkdir()
    rng = random.Random(3)
    killed: set[int] = set()
    is_over = threading.Event()

    def kill() -> None:
        while len(killed) < KILLS and not is_over.wait(rng.uniform(0.2, 1.0)):
            # Workers note their processes, each its own; the client does nothing.
            alive = sorted(work.workers() - killed - {os.getpid()})
            if alive:
                victim = rng.choice(alive)
                os.kill(victim, signal.SIGKILL)
                killed.add(victim)

    killer = threading.Thread(target=kill)
    with Manifest((tmp_path / "photographs").iterdir(), work.state) as manifest:
        killer.start()
        try:
            found, _ = run_sweep(manifest, work, SweepOptions(workers=2))
        finally:
            is_over.set()
            killer.join()
        assert answers(manifest, work) == expected
    assert found.images == 300
    assert len(killed) == KILLS
