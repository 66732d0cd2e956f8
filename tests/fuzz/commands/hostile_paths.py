"""Paths that no command can read or write, each refused by the system or for its name."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.privileges import NOBODY

LONGEST_NAME_BYTES = 255
USAGE, DATA = 2, 1


@dataclass(frozen=True, slots=True, kw_only=True)
class HostilePath:
    """One kind.

    Parameters
    ----------
    kind
        What is wrong.
    path
        Gives the path, in the folder that `make_hostile_places` fills, for an ending.
    statuses
        With which a command may end.
    needs_ordinary_user
        Whether root may all the same.
    """

    kind: str
    path: Callable[[str], str]
    statuses: tuple[int, ...] = (DATA,)
    needs_ordinary_user: bool = False


_EITHER = (DATA, USAGE)
"""What is there, and no file or folder of the right kind, may be refused for its name first."""

_ODD_LETTERS = "two\nlines \x1b[31mred\x07 \udcff\udcfe \u202e"

HOSTILE_PATHS = (
    HostilePath(kind="an empty name", path=lambda _: "", statuses=(USAGE,)),
    HostilePath(kind="a zero byte", path=lambda ending: f"a\0b{ending}", statuses=(USAGE,)),
    HostilePath(kind="a name that is too long", path=lambda ending: "n" * 300 + ending),
    HostilePath(
        kind="a name of few letters and too many bytes",
        path=lambda ending: "é" * 127 + "ab" + ending,
    ),
    HostilePath(kind="a path that is too long", path=lambda ending: "folder/" * 700 + f"x{ending}"),
    HostilePath(kind="a file for a folder", path=lambda ending: f"file/x{ending}"),
    HostilePath(kind="letters that hurt", path=lambda ending: f"file/{_ODD_LETTERS}{ending}"),
    HostilePath(kind="a loop of links", path=lambda _: "loop"),
    HostilePath(kind="a loop of links on the way", path=lambda ending: f"loop/x{ending}"),
    *(
        HostilePath(kind=kind, path=path, statuses=statuses, needs_ordinary_user=True)
        for kind, path, statuses in (
            ("a folder that may not be entered on the way", "shut/x{}".format, (DATA,)),
            (
                "a folder that may be listed and not entered on the way",
                "listed/x{}".format,
                (DATA,),
            ),
            ("a folder that may not be entered", "shut".format, _EITHER),
            ("a folder that may be listed and not entered", "listed".format, _EITHER),
            ("a file that may not be read", "secret{}".format, _EITHER),
            ("nothing, in a folder that may not be written", "sealed/x{}".format, _EITHER),
        )
    ),
)


def make_hostile_places(folder: Path, endings: set[str]) -> None:
    """Make what the paths lead to, owned by the ordinary user whom permissions bind."""
    (folder / "file").write_text("no folder")
    (folder / "loop").symlink_to("loop")
    for name, mode in (("shut", 0o000), ("listed", 0o600), ("sealed", 0o555)):
        (folder / name).mkdir()
        _give_away(folder / name, mode)
    for ending in endings:
        (folder / f"secret{ending}").write_text("secret")
        _give_away(folder / f"secret{ending}", 0o000)
    _give_away(folder, 0o755)


def _give_away(path: Path, mode: int) -> None:
    if os.geteuid() == 0:
        os.chown(path, NOBODY, NOBODY)
    path.chmod(mode)
