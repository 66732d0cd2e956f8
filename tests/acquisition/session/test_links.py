"""A session may have been received: what is written in it never goes through a link or a pipe."""

import os
from pathlib import Path

import pytest

from acquisition.errors import SessionError
from acquisition.session.files import atomic_write
from acquisition.session.reader import Session, verify
from acquisition.session.repair import repair_session
from acquisition.session.writer import SessionNotes
from tests.acquisition.session_fixtures import whole_session, writer


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
    with pytest.raises(SessionError, match="a link, which is not written through"):
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
        with pytest.raises(SessionError, match="a link, which is not written through"):
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
