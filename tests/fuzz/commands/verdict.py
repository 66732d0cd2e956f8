"""Whether a command that was given an odd file ended as it must."""

import hashlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from shutil import rmtree

from tests.fuzz.commands.odd_file import OddFile
from tests.fuzz.commands.server import CommandServer, Ended
from tests.fuzz.commands.slots import Slot

REFUSALS = (1, 2)
MOST_CPU_S = 10.0
MOST_BYTES = 600_000_000
_ALLOWED = r"standoff: |note: |\d+ captures?, "  # and what a plan will take
_READ_BYTES = 1 << 20

Tree = dict[str, tuple[int, int, int, str]]


def faults_of(server: CommandServer, slot: Slot, odd: OddFile | None, root: Path) -> list[str]:
    """Run the command with the odd file, or the sound one; return what is wrong with its end.

    ``root`` holds the folder ``sound``; the command runs in a folder beside it, which is emptied.
    """
    work = emptied_folder(root)
    arguments = slot.command(odd, root / "sound", work)
    before = _tree(work)
    ended = server.run(arguments, work)
    after = _tree(work)
    if odd is None:
        return [] if ended.status == 0 else [f"status {ended.status}: {ended.err[-800:]}"]
    faults = list(_faults(ended, is_refused=odd.is_refused and not slot.notes_odd_files))
    new = [name for name, (mode, *_) in after.items() if name not in before and stat.S_ISREG(mode)]
    faults += [f"left {name}" for name in new if name.endswith(".part")]
    if ended.status in REFUSALS:
        faults += [f"refused, yet wrote {name}" for name in new if not name.startswith(slot.leaves)]
    may_change = () if ended.status in REFUSALS else slot.alters
    if may_change and odd.is_chained_anew:
        may_change += slot.takes_again
    faults += [
        f"altered {name}"
        for name, was in before.items()
        if stat.S_ISREG(was[0]) and was != after.get(name) and not name.startswith(may_change)
    ]
    return faults


def emptied_folder(root: Path) -> Path:
    """A folder beside the sound files for the commands of this process."""
    work = root / f"work-{os.getpid()}"
    rmtree(work, ignore_errors=True)
    work.mkdir()
    return work


def _faults(ended: Ended, *, is_refused: bool) -> Iterator[str]:
    """What is wrong with status, words and cost."""
    allowed = REFUSALS if is_refused else (0, *REFUSALS)
    said = ended.err.strip()[-600:]
    if ended.status not in allowed:
        yield f"status {ended.status}: {said}"
    elif ended.status in REFUSALS:
        lines = ended.err.splitlines()
        if sum(line.startswith("standoff: ") for line in lines) != 1:
            yield f"not one line: {said}"
        if any(not re.match(_ALLOWED, line) for line in lines):
            yield f"lines of another kind: {said}"
    odd = sorted({letter for letter in ended.out + ended.err if not _is_shown(letter)})
    if odd:
        yield f"letters that are not printable: {odd}"
    if len(ended.err) > 20_000:
        yield f"{len(ended.err)} letters on stderr"
    if ended.cpu_s > MOST_CPU_S:
        yield f"took {ended.cpu_s:.1f} s of processor time"
    if ended.peak_bytes > MOST_BYTES:
        yield f"took {ended.peak_bytes / 1e9:.2f} GB"


def _is_shown(letter: str) -> bool:
    return letter.isprintable() or letter == "\n"


def _tree(folder: Path) -> Tree:
    """What lies in a folder: kind, size, time, and the content of what is small."""
    found: Tree = {}
    for path in folder.rglob("*"):
        status = path.lstat()
        digest = ""
        if stat.S_ISREG(status.st_mode) and status.st_size <= _READ_BYTES:
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
        found[str(path.relative_to(folder))] = (
            status.st_mode,
            status.st_size,
            0 if stat.S_ISDIR(status.st_mode) else status.st_mtime_ns,
            digest,
        )
    return found
