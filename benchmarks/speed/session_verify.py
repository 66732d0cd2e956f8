"""Time of ``verify`` for a long session beside a bare loop that hashes the same files.

Captures are small, so that the journal counts; of 780 x 580 px, hashing is nearly all.

    python -m benchmarks.speed.session_verify [--captures 10000]
"""

import hashlib
import tempfile
import time
from pathlib import Path

import numpy as np

from acquisition.plan import parse_plan
from acquisition.session import Photograph, SessionWriter, verify
from benchmarks.harness import Recorder, benchmark

ROUNDS = 3


def _session_of(path: Path, captures: int) -> None:
    """Write a session of photographs of 60 x 40 px."""
    plan = parse_plan(
        {
            "schema": "standoff.plan/1",
            "name": "long",
            "heights_mm": [number / 100 for number in range(captures)],
            "targets": [{"kind": "edge", "target": "E"}],
        },
        source="benchmark",
    )
    image_dn = np.ones((40, 60), dtype=np.float32)
    with SessionWriter(path, plan=plan, bench=None, devices={}, operator="benchmark") as session:
        for entry in session.entries:
            photograph = Photograph(image_dn=image_dn, pixel_format="Mono8", max_level_dn=255.0)
            session.add_photograph(entry, photograph)


def _hash_files(path: Path) -> None:
    """Hash every file, and nothing else."""
    for file in path.rglob("*.tif"):
        hashlib.sha256(file.read_bytes()).hexdigest()


@benchmark("numpy", "tifffile")
def main(record: Recorder, *, captures: int = 10_000) -> None:
    with tempfile.TemporaryDirectory() as folder:
        count = record.pick(captures, 500)
        path = Path(folder) / "session"
        _session_of(path, count)
        ours_s, bare_s = [], []
        for _ in range(ROUNDS):
            start = time.process_time()
            assert verify(path).is_ok
            between = time.process_time()
            _hash_files(path)
            ours_s.append(between - start)
            bare_s.append(time.process_time() - between)
        ours, bare = min(ours_s), min(bare_s)
        record.figure("verify of a session", ours, "s", "hashing alone", bare)
