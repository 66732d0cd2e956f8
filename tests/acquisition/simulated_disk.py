"""What a disk may hold after a power cut: the writes of a run, replayed in every allowed order.

A journaling file system commits names (creations, renames, removals) in their order, and whatever
is synced with all names before it. Data that was not synced may be there, in part, as zeros or
not at all. The recorder sees what passes through ``os``; what a file held is read at each sync.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import pytest

OpKind = Literal["data", "sync", "names", "rename", "link", "unlink", "folder", "promise"]
"""``names``: a folder was synced."""


@dataclass(frozen=True, slots=True)
class DiskOp:
    """One operation; ``name`` is relative to the folder, ``data`` what the file then holds."""

    kind: OpKind
    name: str
    target: str = ""
    data: bytes = b""


class DiskRecorder:
    """Records the operations below a folder; ``promise`` marks what was reported as safe."""

    def __init__(self, root: Path) -> None:
        self.ops: list[DiskOp] = []
        self._root = root

    def promise(self, name: str) -> None:
        """Mark that something must survive from now on."""
        self.ops.append(DiskOp("promise", name))

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Record while the block runs."""
        with pytest.MonkeyPatch.context() as patch:
            self._patch(patch)
            yield

    def _name(self, path: str | os.PathLike[str]) -> str | None:
        full = Path(path)
        return full.relative_to(self._root).as_posix() if full.is_relative_to(self._root) else None

    def _saw(self, descriptor: int, *, is_synced: bool) -> None:
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        name = self._name(path)
        if name is None:
            return
        if path.is_dir():
            known = _names(self.ops)[0]
            for file in sorted(path.iterdir()):
                made = self._name(file)
                if file.is_file() and made is not None and made not in known:
                    self.ops.append(DiskOp("data", made, data=file.read_bytes()))
            self.ops.append(DiskOp("names", name))
            return
        self.ops.append(DiskOp("data", name, data=path.read_bytes()))
        if is_synced:
            self.ops.append(DiskOp("sync", name))

    def _patch(self, patch: pytest.MonkeyPatch) -> None:
        fsync, write, ftruncate = os.fsync, os.write, os.ftruncate
        replace, link, unlink, mkdir = os.replace, os.link, os.unlink, os.mkdir

        def seen_fsync(descriptor: int) -> None:
            fsync(descriptor)
            self._saw(descriptor, is_synced=True)

        def seen_write(descriptor: int, data: bytes) -> int:
            count = write(descriptor, data)
            self._saw(descriptor, is_synced=False)
            return count

        def seen_ftruncate(descriptor: int, size: int) -> None:
            ftruncate(descriptor, size)
            self._saw(descriptor, is_synced=False)

        def seen_replace(source: Path, target: Path) -> None:
            replace(source, target)
            self._names("rename", source, target)

        def seen_link(source: Path, target: Path) -> None:
            link(source, target)
            self._names("link", source, target)

        def seen_unlink(path: Path, **options: int) -> None:
            unlink(path, **options)
            self._names("unlink", path)

        def seen_mkdir(path: Path, mode: int = 0o777) -> None:
            mkdir(path, mode)
            self._names("folder", path)

        for name, seen in (
            ("fsync", seen_fsync),
            ("write", seen_write),
            ("ftruncate", seen_ftruncate),
            ("replace", seen_replace),
            ("link", seen_link),
            ("unlink", seen_unlink),
            ("mkdir", seen_mkdir),
        ):
            patch.setattr(os, name, seen)

    def _names(self, kind: OpKind, path: Path, target: Path | None = None) -> None:
        name = self._name(path)
        if name is not None:
            other = "" if target is None else self._name(target) or ""
            self.ops.append(DiskOp(kind, name, other))


@dataclass(frozen=True, slots=True)
class DiskState:
    """What may be on the disk, and the promises that were made before."""

    files: tuple[tuple[str, bytes], ...]
    folders: tuple[str, ...]
    promises: tuple[str, ...]

    def restore(self, root: Path) -> None:
        """Write it to a folder."""
        root.mkdir(parents=True)
        for folder in self.folders:
            (root / folder).mkdir(parents=True, exist_ok=True)
        for name, data in self.files:
            (root / name).write_bytes(data)


def states(ops: list[DiskOp]) -> Iterator[DiskState]:
    """Every state that a power cut between two operations may leave, once each."""
    seen: set[DiskState] = set()
    for end in range(len(ops) + 1):
        promises = tuple(op.name for op in ops[:end] if op.kind == "promise")
        barriers = (i + 1 for i, op in enumerate(ops[:end]) if op.kind in ("sync", "names"))
        synced_until = max(barriers, default=0)
        contents = _contents(ops[:end])
        for names_until in range(synced_until, end + 1):
            names, folders = _names(ops[:names_until])
            files = sorted(names)
            for data in product(*(contents[names[name]] for name in files)):
                state = DiskState(tuple(zip(files, data, strict=True)), folders, promises)
                if state not in seen:
                    seen.add(state)
                    yield state


def _names(ops: list[DiskOp]) -> tuple[dict[str, int], tuple[str, ...]]:
    """Which file each name is, by the number of the operation that made it; and the folders."""
    names: dict[str, int] = {}
    folders: list[str] = []
    for number, op in enumerate(ops):
        if op.kind == "data":
            names.setdefault(op.name, number)
        elif op.kind == "rename":
            names[op.target] = names.pop(op.name)
        elif op.kind == "link":
            names[op.target] = names[op.name]
        elif op.kind == "unlink":
            names.pop(op.name, None)
        elif op.kind == "folder":
            folders.append(op.name)
    return names, tuple(folders)


def _contents(ops: list[DiskOp]) -> dict[int, tuple[bytes, ...]]:
    """What each file may hold: what was synced, and what was written since, whole or in part."""
    synced: dict[int, bytes] = {}
    latest: dict[int, bytes] = {}
    for number, op in enumerate(ops):
        if op.kind in ("data", "sync"):
            file = _names(ops[: number + 1])[0][op.name]
            if op.kind == "data":
                latest[file] = op.data
            else:
                synced[file] = latest[file]
    made: dict[int, tuple[bytes, ...]] = {}
    for file, data in latest.items():
        old = synced.get(file, b"")
        if data == old:
            made[file] = (data,)
            continue
        added = data[len(old) :] if data.startswith(old) else b""
        parts = {old, data}
        if added:
            parts |= {old + added[: len(added) // 2], old + bytes(len(added))}
        made[file] = tuple(sorted(parts))
    return made
