"""A sweep's work that is quick and easily checked: it commits the hashes of the photographs."""

import hashlib
import os
import time
from dataclasses import dataclass
from pathlib import Path

from acquisition.session import commit_file
from analysis.sweep.shards import Shard, ShardDone, ShardWork


@dataclass(frozen=True)
class Hashing(ShardWork):
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

    def found(self, shard: Shard) -> ShardDone | None:
        path = self._commit(shard)
        return self._done(path.read_bytes()) if path.exists() else None

    def __call__(self, shard: Shard) -> ShardDone:
        time.sleep(self.delay_s)
        (self.folder / f"{os.getpid()}.pid").touch()
        lines = []
        for item in shard.items:
            try:
                data = item.path.read_bytes()
            except FileNotFoundError:
                data = b"x"
            digest = hashlib.sha256(data).hexdigest()
            lines.append(f"{item.path}: {'refused' if data.startswith(b'x') else digest}\n")
        whole = "".join(lines).encode()
        commit_file(self._commit(shard), whole)
        return self._done(whole)

    def committed(self) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in self.folder.glob("*.shard")}

    def workers(self) -> set[int]:
        """Processes that did a shard."""
        return {int(path.stem) for path in self.folder.glob("*.pid")}

    def _commit(self, shard: Shard) -> Path:
        return self.folder / f"{shard.number:016x}-{shard.key[:16]}.shard"

    def _done(self, data: bytes) -> ShardDone:
        lines = data.decode().splitlines()
        refused = tuple(line for line in lines if line.endswith("refused"))
        return ShardDone(images=len(lines) - len(refused), refused=refused, notes={"kind": "seen"})


def photographs(folder: Path, count: int) -> list[Path]:
    """Write so many files."""
    folder.mkdir()
    paths = [folder / f"{number:04d}.png" for number in range(count)]
    for number, path in enumerate(paths):
        path.write_bytes(f"{number}".encode())
    return paths
