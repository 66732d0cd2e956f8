import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from acquisition.session.files import clear_parts, part_of, whole_file, write_shared

LETTERS = "0123456789abcdef" * 2


def test_writers_of_one_file_have_parts_of_their_own_and_the_last_wins(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    with whole_file(path) as one, whole_file(path) as other:
        one.write(b"first")
        other.write(b"second")
        assert len(list(tmp_path.iterdir())) == 2
    assert path.read_bytes() == b"first"  # its block ended last
    assert list(tmp_path.iterdir()) == [path]


def test_parts_of_those_that_write_stay_and_of_those_that_were_killed_go(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    here, elsewhere = socket.gethostname(), f"not-{socket.gethostname()}.lab"
    living = part_of(tmp_path / "mine.tar")
    dead = tmp_path / f"killed.tar.{here}.{ended.pid}.{LETTERS}.part"
    foreign = tmp_path / f"a.tar.{elsewhere}.{ended.pid}.{LETTERS}.part"
    abandoned = tmp_path / f"b.tar.{elsewhere}.{os.getpid()}.{LETTERS}.part"
    unsigned = tmp_path / "c.tar.0a1b.part"
    for part in (living, dead, foreign, abandoned, unsigned):
        part.touch()
    two_hours_ago_s = time.time() - 7200
    for part in (living, abandoned):
        os.utime(part, (two_hours_ago_s, two_hours_ago_s))
    clear_parts(tmp_path)
    assert set(tmp_path.iterdir()) == {living, foreign}


def test_an_error_leaves_the_file_as_it_was_and_no_part(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(b"before")
    with pytest.raises(TypeError), whole_file(path) as file:
        file.writelines([b"half", "no bytes"])  # type: ignore[list-item]
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["n" * 255, "é" * 127 + "x", "n" * 200 + "é.json"])
def test_a_file_of_the_longest_name_is_written_through_a_part_of_a_shorter_one(
    tmp_path: Path, name: str
) -> None:
    part = part_of(tmp_path / name)
    assert len(os.fsencode(part.name)) <= 255
    write_shared(tmp_path / name, b"whole")
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_what_a_killed_writer_left_of_a_long_name_goes_and_that_of_another_stays(
    tmp_path: Path,
) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    names = ["n" * 250 + "1", "n" * 250 + "2"]
    left = [
        tmp_path / part_of(tmp_path / name).name.replace(f".{os.getpid()}.", f".{ended.pid}.")
        for name in names
    ]
    for part in left:
        part.touch()
    clear_parts(tmp_path, names[0])
    assert list(tmp_path.iterdir()) == [left[1]]
