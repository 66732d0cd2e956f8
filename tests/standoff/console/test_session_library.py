"""What the console reads again of a folder of sessions, and what it does not."""

import os
from pathlib import Path

import pytest

from acquisition.session.reader import Session
from acquisition.session.writer import SessionNotes
from standoff.console.session_library import SessionLibrary, UnknownSessionError
from tests.acquisition.session_fixtures import add, writer


class CountingLibrary(SessionLibrary):
    """Notes which sessions are read."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.opened: list[str] = []

    def open(self, name: str) -> Session:
        self.opened.append(name)
        return super().open(name)


@pytest.fixture
def library(tmp_path: Path) -> CountingLibrary:
    for name in ("one", "two"):
        capture(tmp_path / name, name)
    return CountingLibrary(tmp_path)


def capture(session: Path, prefix: str) -> None:
    with writer(session, prefix=prefix) as opened:
        add(opened, opened.pending_entries()[0])


def test_sessions_that_have_not_changed_are_listed_without_being_read_again(
    library: CountingLibrary,
) -> None:
    first = library.summaries()
    assert sorted(library.opened) == ["one", "two"]
    assert library.summaries() == first
    assert len(library.opened) == 2


def test_the_session_that_has_changed_is_read_again_and_no_other(library: CountingLibrary) -> None:
    library.summaries()
    library.opened.clear()
    capture(library.folder / "two", "later")
    SessionNotes(library.folder / "two", operator="Ada").exclude(0, "dust")
    found = {each.name: (each.captured, each.excluded) for each in library.summaries()}
    assert found == {"one": (1, 0), "two": (2, 1)}
    assert library.opened == ["two"]


def test_a_session_that_is_put_back_from_a_copy_of_the_same_size_is_read_again(
    library: CountingLibrary,
) -> None:
    manifest = library.folder / "one" / "session.json"
    library.summaries()
    at_ns = manifest.stat().st_mtime_ns
    manifest.write_text(manifest.read_text().replace("Zoë", "Eöz"))
    os.utime(manifest, ns=(at_ns, at_ns + 1_000_000))
    assert {each.operator for each in library.summaries()} == {"Zoë", "Eöz"}


def test_a_damaged_session_is_told_until_it_is_mended(library: CountingLibrary) -> None:
    journal = library.folder / "one" / "journal.jsonl"
    sound = journal.read_bytes()
    journal.write_bytes(sound[:-40])
    assert [bool(each.fault) for each in library.summaries()].count(True) == 1
    journal.write_bytes(sound)
    assert not any(each.fault for each in library.summaries())


def test_whoever_turns_the_pages_of_a_session_reads_its_journal_once(
    library: CountingLibrary,
) -> None:
    session = library.read("one")
    assert library.read("one") is session
    assert library.opened == ["one"]


def test_a_page_of_a_session_that_goes_on_shows_what_was_added(library: CountingLibrary) -> None:
    assert len(library.read("one").captures) == 1
    capture(library.folder / "one", "later")
    assert len(library.read("one").captures) == 2
    assert len(library.read("two").captures) == 1
    assert library.opened == ["one", "one", "two"]


def test_a_session_that_was_removed_is_gone(library: CountingLibrary) -> None:
    library.summaries()
    library.read("one")
    (library.folder / "one").rename(library.folder / ".removed")
    assert [each.name for each in library.summaries()] == ["two"]
    with pytest.raises(UnknownSessionError):
        library.read("one")
