"""Kill -9 of a worker or of the client at random moments: the next run ends with the same bits."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from analysis.sweep.engine import SweepOptions, run_sweep
from analysis.sweep.manifest import Manifest
from tests.analysis.sweep.hashing import Hashing, photographs

ROOT = Path(__file__).parents[3]
KILLS = 10

CLIENT = """
import sys
from pathlib import Path
from analysis.sweep.engine import SweepOptions, run_sweep
from analysis.sweep.manifest import Manifest
from tests.analysis.sweep.hashing import Hashing

if __name__ == "__main__":
    work = Hashing(Path(sys.argv[1]), delay_s=0.01)
    with Manifest(Path(sys.argv[2]).iterdir(), work.state) as manifest:
        print("begins", flush=True)
        run_sweep(manifest, work, SweepOptions(workers=int(sys.argv[3])))
"""


@pytest.fixture
def expected(tmp_path: Path) -> dict[str, bytes]:
    (tmp_path / "expected").mkdir()
    work = Hashing(tmp_path / "expected")
    with Manifest(photographs(tmp_path / "photographs", 300), work.state) as manifest:
        run_sweep(manifest, work)
    return work.committed()


def started(script: Path, state: Path, photographs: Path, workers: int) -> subprocess.Popen[str]:
    client = subprocess.Popen(
        [sys.executable, str(script), str(state), str(photographs), str(workers)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert client.stdout is not None
    assert client.stdout.readline() == "begins\n"
    return client


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_client_killed_at_random_moments_leaves_a_state_that_ends_as_without(
    workers: int, expected: dict[str, bytes], tmp_path: Path
) -> None:
    work = Hashing(tmp_path / "state")
    work.folder.mkdir()
    script = tmp_path / "client.py"
    script.write_text(CLIENT)
    rng = random.Random(workers)
    lasts_s = 0.1 if workers == 1 else 1.2  # two processes take a second to start
    for _ in range(KILLS // 2):
        client = started(script, work.state, tmp_path / "photographs", workers)
        time.sleep(rng.uniform(0.0, lasts_s))
        client.send_signal(signal.SIGKILL)
        client.communicate()
    with Manifest((tmp_path / "photographs").iterdir(), work.state) as manifest:
        found = run_sweep(manifest, work)
    assert found.found_done > 0
    assert work.committed() == expected


@pytest.mark.slow
def test_workers_killed_at_random_moments_change_nothing(
    expected: dict[str, bytes], tmp_path: Path
) -> None:
    work = Hashing(tmp_path / "state", delay_s=0.2)
    work.folder.mkdir()
    rng = random.Random(3)
    killed: set[int] = set()
    is_over = threading.Event()

    def kill() -> None:
        while len(killed) < KILLS and not is_over.wait(rng.uniform(0.2, 1.0)):
            # Workers note their processes, each its own; the client does no shard.
            alive = sorted(work.workers() - killed - {os.getpid()})
            if alive:
                victim = rng.choice(alive)
                os.kill(victim, signal.SIGKILL)
                killed.add(victim)

    killer = threading.Thread(target=kill)
    with Manifest((tmp_path / "photographs").iterdir(), work.state) as manifest:
        killer.start()
        try:
            found = run_sweep(manifest, work, SweepOptions(workers=2))
        finally:
            is_over.set()
            killer.join()
    assert found.images == 300
    assert len(killed) == KILLS
    assert work.committed() == expected
