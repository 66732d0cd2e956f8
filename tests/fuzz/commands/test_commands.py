"""A case of every kind, each at one of the commands that read such files.

``python -m tests.fuzz`` gives every command hundreds, at all its places.
"""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.fuzz.commands.odd_file import OddFile
from tests.fuzz.commands.server import CommandServer
from tests.fuzz.commands.slots import SLOTS, Slot
from tests.fuzz.commands.sound_files import make_sound_files
from tests.fuzz.commands.verdict import faults_of

pytestmark = pytest.mark.slow

# The places that answer soonest; `make fuzz` has them all.
IMAGES = (
    "import",
    "import --mean",
    "simulate, corrected",
    "map of a noise.json",
    "verify, a capture",
)
DOCUMENTS = ("simulate --noise", "limits", "limits --geometry", "capture --plan", "compare")
SESSIONS = tuple(
    f"{name}, {file}"
    for name in ("verify", "session show", "session exclude", "noise", "capture", "import")
    for file in ("session.json", "journal.jsonl")
)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sound files."""
    root = tmp_path_factory.mktemp("root")
    (root / "sound").mkdir()
    make_sound_files(root / "sound")
    return root


@pytest.fixture(scope="module")
def server() -> Iterator[CommandServer]:
    with closing(CommandServer()) as server:
        yield server


def one_of_each_kind(slots: tuple[Slot, ...], sound: Path) -> Iterator[tuple[Slot, OddFile]]:
    """Kinds in turn, so that every slot gets some."""
    seen: set[str] = set()
    waiting = {slot: iter(slot.odd_files(sound)) for slot in slots}
    while waiting:
        for slot, odd_files in list(waiting.items()):
            new = next((odd for odd in odd_files if odd.kind not in seen), None)
            if new is None:
                del waiting[slot]
            else:
                seen.add(new.kind)
                yield slot, new


@pytest.mark.parametrize(
    "names", [IMAGES, DOCUMENTS, SESSIONS], ids=["images", "documents", "sessions"]
)
def test_a_file_of_every_kind_of_damage_is_refused_in_a_line_or_read(
    server: CommandServer, root: Path, names: tuple[str, ...]
) -> None:
    slots = tuple(slot for slot in SLOTS if slot.name in names)
    assert len(slots) == len(names)
    wrong = {
        f"{slot.name}: {odd.kind}, {odd.name}": faults
        for slot, odd in one_of_each_kind(slots, root / "sound")
        if (faults := faults_of(server, slot, odd, root))
    }
    assert not wrong, "\n".join(f"{case}: {faults}" for case, faults in wrong.items())


@pytest.mark.parametrize("name", ["import", "simulate --noise", "limits", "verify, journal.jsonl"])
def test_the_sound_file_in_the_same_place_is_read(
    server: CommandServer, root: Path, name: str
) -> None:
    [slot] = [slot for slot in SLOTS if slot.name == name]
    assert faults_of(server, slot, None, root) == []
