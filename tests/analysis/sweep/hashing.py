"""A sweep's work that is quick and easily checked: it answers with hashes of the photographs."""

import hashlib
import os
import time
from dataclasses import dataclass
from pathlib import Path

from analysis.errors import RefusedPhotographError
from analysis.sweep import Batch, Commit, Manifest, Record, Records, SweepItem, SweepWork


@dataclass(frozen=True)
class Hashing(SweepWork):
    """Refuses what is missing or begins with an x; notes the process that works."""

    folder: Path
    settings: str = ""
    delay_s: float = 0.0

    @property
    def key(self) -> str:
        return self.settings

    @property
    def state(self) -> Path:
        return self.folder

    def do(self, batch: Batch, commit: Commit) -> None:
        time.sleep(self.delay_s)
        (self.folder / f"{os.getpid()}.pid").touch()
        super().do(batch, commit)

    def answer(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        try:
            data = item.path.read_bytes()
        except FileNotFoundError:
            data = b"x"
        if data.startswith(b"x"):
            raise RefusedPhotographError(f"{item.path}: refused")
        row = {"sha256": hashlib.sha256(data).hexdigest()}
        return Record(items=(item,), rows=(row,), notes={"kind": "seen"})

    def workers(self) -> set[int]:
        """Processes that did a batch."""
        return {int(path.stem) for path in self.folder.glob("*.pid")}


def answers(manifest: Manifest, work: Hashing) -> dict[Path, str]:
    """Hashes by paths, as a further run finds them; of a refused photograph it is the refusal."""
    found = Records(manifest, work).answers()
    return {one.item.path: one.refused or one.row["sha256"] for one in found}


def photographs(folder: Path, count: int) -> list[Path]:
    """Write so many files."""
    folder.mkdir()
    paths = [folder / f"{number:04d}.png" for number in range(count)]
    for number, path in enumerate(paths):
        path.write_bytes(f"{number}".encode())
    return paths
