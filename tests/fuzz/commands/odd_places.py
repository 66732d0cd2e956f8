"""What is at a path, and is no file that can be read: alike for images, documents and sessions."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

from tests.fuzz.commands.odd_file import Made, OddFile

GIGANTIC = 20 << 30


def _of_size(path: Path, size: int) -> None:
    with path.open("wb") as file:
        file.truncate(size)


def _socket(path: Path) -> None:
    # The name of a socket is short; the folder that is worked in is not.
    here = Path.cwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.chdir(here)


def _loop(path: Path) -> None:
    other = path.with_name("loop")
    other.symlink_to(path.name)
    path.symlink_to(other.name)


def _hollow(path: Path) -> None:
    other = path.with_name("hollow")
    other.mkdir()
    path.symlink_to(other.name)


def _in_itself(path: Path) -> None:
    """A link to a folder that links back to where it is."""
    path.symlink_to(path.parent / path.name / "again")


def odd_places() -> Iterator[OddFile]:
    """Pipes, devices, folders, links, and files without end or content."""
    makers: dict[str, Made] = {
        "pipe": os.mkfifo,
        "socket": _socket,
        "folder": Path.mkdir,
        "nothing": lambda _: None,
        "empty file": Path.touch,
        "file of 20 GiB": lambda path: _of_size(path, GIGANTIC),
        "file of 2 GiB of zeros": lambda path: _of_size(path, 2 << 30),
        "link to itself": lambda path: path.symlink_to(path.name),
        "loop of links": _loop,
        "link through itself": _in_itself,
        "link to nothing": lambda path: path.symlink_to("not there"),
        "link to a folder": _hollow,
        "endless device": lambda path: path.symlink_to("/dev/zero"),
        "random device": lambda path: path.symlink_to("/dev/urandom"),
        "empty device": lambda path: path.symlink_to("/dev/null"),
        "full device": lambda path: path.symlink_to("/dev/full"),
        "terminal": lambda path: path.symlink_to("/dev/tty"),
        "file of the kernel": lambda path: path.symlink_to("/proc/self/status"),
        "memory of the process": lambda path: path.symlink_to("/proc/self/mem"),
        "link with a long name": lambda path: path.symlink_to("x" * 255),
    }
    for name, make in makers.items():
        yield OddFile(kind=f"a {name}", name=name, make=make, is_refused=True)
