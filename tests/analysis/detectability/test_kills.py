import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from analysis.detectability.sweep import ArtefactWork
from tests.analysis.detectability.test_sweep import PLAN, load, never, scenes, swept

ROOT = Path(__file__).parents[3]
KILLS = 10

CLIENT = """
import sys, time
from pathlib import Path
from analysis.detectability.sweep import ArtefactWork
from analysis.sweep import Manifest, SweepOptions, run_sweep
from tests.analysis.detectability.test_sweep import PLAN, load

def slow_load(path):
    time.sleep(0.003)
    return load(path)

if __name__ == "__main__":
    state, photographs, workers = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    work = ArtefactWork(plan=PLAN, load=slow_load, folder=state)
    with Manifest(photographs.iterdir(), state) as manifest:
        print("begins", flush=True)
        run_sweep(manifest, work, SweepOptions(workers=workers))
"""


def begun(script: Path, state: Path, photographs: Path, workers: int) -> subprocess.Popen[str]:
    """Start a sweep; return when it begins."""
    client = subprocess.Popen(
        [sys.executable, str(script), str(state), str(photographs), str(workers)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert client.stdout is not None
    assert client.stdout.readline() == "begins\n"
    return client


def committed_bytes(state: Path) -> int:
    """Size of what is committed."""
    return sum(path.stat().st_size for path in state.glob("*.records"))


@pytest.mark.slow
def test_clients_killed_at_random_moments_leave_what_ends_with_the_same_bits(
    tmp_path: Path,
) -> None:
    """Five without workers, and five with two of them, which end with their client.

    One of each is killed soon after it begins, the others soon after a commit, whenever that is.
    """
    paths = scenes(tmp_path / "photographs", 300)
    (tmp_path / "expected").mkdir()
    expected = swept(paths, ArtefactWork(plan=PLAN, load=load, folder=tmp_path / "expected"))
    state, script = tmp_path / "state", tmp_path / "client.py"
    script.write_text(CLIENT)
    rng = random.Random(5)
    for kill in range(KILLS):
        before = committed_bytes(state)
        client = begun(script, state, tmp_path / "photographs", 1 + kill % 2)
        while kill % 5 and committed_bytes(state) == before and client.poll() is None:
            time.sleep(0.005)
        time.sleep(rng.uniform(0.0, 0.1))
        client.send_signal(signal.SIGKILL)
        client.communicate()
    found = swept(paths, ArtefactWork(plan=PLAN, load=load, folder=state))
    assert found.found_done > 0
    assert found.bits == expected.bits
    again = swept(paths, ArtefactWork(plan=PLAN, load=never, folder=state))
    assert again.found_done == 300
