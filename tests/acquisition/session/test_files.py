"""Files of a session: shared, durable, and no links."""

import errno
import hashlib
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from acquisition.errors import SessionError
from acquisition.session._files import (
    atomic_write,
    clear_parts,
    part_of,
    whole_file,
    write_new_hashed,
    write_shared,
)
from acquisition.session._reader import Session, verify
from acquisition.session._repair import repair_session
from acquisition.session._writer import SessionNotes
from tests.acquisition.session_fixtures import whole_session, writer

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


def test_a_file_is_written_whole_and_leaves_no_part(tmp_path: Path) -> None:
    atomic_write(tmp_path / "a.bin", b"new")
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"a.bin": b"new"}


def test_the_part_of_a_killed_run_is_written_over(tmp_path: Path) -> None:
    (tmp_path / "a.bin.part").write_bytes(b"half of something longer")
    atomic_write(tmp_path / "a.bin", b"new")
    assert [file.name for file in tmp_path.iterdir()] == ["a.bin"]
    assert (tmp_path / "a.bin").read_bytes() == b"new"


def test_a_full_disk_leaves_the_file_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError) as refused:
        atomic_write(path, b"new")
    assert refused.value.errno == errno.ENOSPC
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"a.bin": b"old"}


def test_data_are_durable_before_the_name_and_the_name_before_the_return(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def logged_fsync(descriptor: int) -> None:
        is_directory = Path(f"/proc/self/fd/{descriptor}").resolve() == tmp_path.resolve()
        steps.append("fsync directory" if is_directory else "fsync file")
        fsync(descriptor)

    def logged_replace(self: Path, target: Path) -> Path:
        steps.append("rename")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", logged_fsync)
    monkeypatch.setattr(Path, "replace", logged_replace)
    atomic_write(tmp_path / "a.bin", b"new")
    assert steps == ["fsync file", "rename", "fsync directory"]


def test_the_hash_is_that_of_the_file(tmp_path: Path) -> None:
    digest = write_new_hashed(tmp_path / "a.bin", (b"abc-", memoryview(b"def")))
    assert digest == hashlib.sha256((tmp_path / "a.bin").read_bytes()).hexdigest()


def test_a_write_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError) as refused:
        write_new_hashed(tmp_path / "a.bin", (b"half",))
    assert refused.value.errno == errno.ENOSPC
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_does_not_fit_is_refused_with_the_systems_reason(tmp_path: Path) -> None:
    # A limit on the size of files is refused in the same place as a full disk.
    resource = pytest.importorskip("resource", reason="a limit of POSIX systems")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8000, limits[1]))
    try:
        with pytest.raises(OSError) as refused:
            write_new_hashed(tmp_path / "a", (bytes(80_000),))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert refused.value.errno == errno.EFBIG
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "s"
    whole_session(path)
    return path


@pytest.mark.parametrize("name", ["not there", "x" * 255])
def test_a_journal_that_is_a_link_to_nothing_makes_no_file(path: Path, name: str) -> None:
    journal = path / "journal.jsonl"
    journal.unlink()
    journal.symlink_to(name)
    before = sorted(path.rglob("*"))
    with pytest.raises(SessionError, match="a link, which is not followed when writing"):
        writer(path)
    assert sorted(path.rglob("*")) == before


def test_a_journal_that_is_a_link_is_read_and_never_written(path: Path, tmp_path: Path) -> None:
    journal, elsewhere = path / "journal.jsonl", tmp_path / "elsewhere.jsonl"
    journal.rename(elsewhere)
    journal.symlink_to(elsewhere)
    before = elsewhere.read_bytes()
    assert verify(path).is_ok
    for write in (
        lambda: writer(path),
        lambda: SessionNotes(path, operator="Zoë").note("dust"),
        lambda: repair_session(path),
    ):
        with pytest.raises(SessionError, match="a link, which is not followed when writing"):
            write()
    assert elsewhere.read_bytes() == before


@pytest.mark.parametrize("name", ["journal.head", "journal.head.part"])
def test_a_link_or_pipe_in_the_place_of_a_head_is_replaced(
    path: Path, tmp_path: Path, name: str
) -> None:
    head, elsewhere = path / "journal.head", tmp_path / "elsewhere"
    elsewhere.write_bytes(head.read_bytes())
    before = elsewhere.read_bytes()
    odd = path / name
    odd.unlink(missing_ok=True)
    odd.symlink_to(elsewhere)
    SessionNotes(path, operator="Zoë").note("dust")
    assert elsewhere.read_bytes() == before
    assert not head.is_symlink()
    os.mkfifo(path / "journal.head.part")
    SessionNotes(path, operator="Zoë").note("more dust")
    assert Session(path).events[-1].facts["text"] == "more dust"
    assert verify(path).is_ok


def test_the_part_of_a_file_is_never_a_link_or_a_pipe(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_bytes(b"theirs")
    (tmp_path / "a.part").symlink_to(elsewhere)
    os.mkfifo(tmp_path / "b.part")
    for name in ("a", "b"):
        atomic_write(tmp_path / name, b"ours")
        assert (tmp_path / name).read_bytes() == b"ours"
        assert not (tmp_path / name).is_symlink()
    assert elsewhere.read_bytes() == b"theirs"


def test_captures_are_not_written_into_a_folder_elsewhere(path: Path, tmp_path: Path) -> None:
    (path / "captures").rename(tmp_path / "elsewhere")
    (path / "captures").symlink_to(tmp_path / "elsewhere")
    assert verify(path).is_ok
    with pytest.raises(SessionError, match="captures is a link"):
        writer(path)
    assert not any(event.kind == "resume" for event in Session(path).events)
