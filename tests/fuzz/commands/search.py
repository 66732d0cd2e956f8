"""Every odd file at every place, in several processes."""

import os
import re
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.fuzz.commands.odd_file import OddFile
from tests.fuzz.commands.server import CommandServer
from tests.fuzz.commands.slots import SLOTS, Slot
from tests.fuzz.commands.sound_files import make_sound_files
from tests.fuzz.commands.verdict import emptied_folder, faults_of

PROCESSES = len(os.sched_getaffinity(0))

# Between them they load and compile what all others need.
_REHEARSED = ("calibrate", "simulate", "simulate, another pose", "detectability", "changes", "pose")


CASES_A_PART = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchedPart:
    """Some cases of a place, counted from the sound file on, and what was wrong."""

    slot: str
    first: int
    cases: int
    faults: tuple[str, ...]

    def __str__(self) -> str:
        last = self.first + self.cases - 1
        return f"{self.slot}: cases {self.first} to {last}, {len(self.faults)} faults"


def parts_in(output: str) -> frozenset[tuple[str, int]]:
    """Place and first case of the parts that an earlier run says were done."""
    found = re.finditer(r"^(\S.*): cases (\d+) to \d+, \d+ faults$", output, re.MULTILINE)
    return frozenset((one[1], int(one[2])) for one in found)


def search_commands(
    slots: Sequence[Slot], done_before: frozenset[tuple[str, int]] = frozenset()
) -> Iterator[SearchedPart]:
    """Give the commands every odd file at these places; yields what is done.

    A case of each kind comes first, at every place, before the many that are alike.
    """
    with TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "sound").mkdir()
        make_sound_files(root / "sound")
        parts = sorted(
            (first, place, slot.name)
            for place, slot in enumerate(slots)
            for first in range(0, 1 + len(slot.odd_files(root / "sound")), CASES_A_PART)
            if (slot.name, first) not in done_before
        )
        workers = ProcessPoolExecutor(
            PROCESSES, mp_context=get_context("spawn"), initializer=_start, initargs=(root,)
        )
        with workers:
            searches = [workers.submit(_search, name, first) for first, _, name in parts]
            for done in as_completed(searches):
                yield done.result()


class _Worker:
    """What a process of the search has for all its places."""

    root: Path
    server: CommandServer


def _start(root: Path) -> None:
    _Worker.root, _Worker.server = root, CommandServer()
    for name in _REHEARSED:
        work = emptied_folder(root)
        _Worker.server.rehearse(_slot(name).command(None, root / "sound", work), work)


def _slot(name: str) -> Slot:
    [slot] = [slot for slot in SLOTS if slot.name == name]
    return slot


def _search(name: str, first: int) -> SearchedPart:
    slot, faults = _slot(name), []
    cases: list[OddFile | None] = [None, *slot.odd_files(_Worker.root / "sound")]
    part = cases[first : first + CASES_A_PART]
    for odd in part:
        case = "the sound file" if odd is None else f"{odd.kind}, {odd.name}"
        found = faults_of(_Worker.server, slot, odd, _Worker.root)
        faults += [f"{case}: {fault}" for fault in found]
    return SearchedPart(slot=name, first=first, cases=len(part), faults=tuple(faults))
