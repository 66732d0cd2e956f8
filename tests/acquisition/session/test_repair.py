"""A damaged journal is made anew of what its chain and the captures' own records vouch for."""

import json
from pathlib import Path

import pytest

from acquisition.errors import SessionError
from acquisition.session._capture_files import capture_seal
from acquisition.session._journal import HEAD_NAME, JournalWriter, Stamps
from acquisition.session._reader import Session, verify
from acquisition.session._record import CaptureRecord
from acquisition.session._repair import repair_session
from acquisition.session._writer import SessionNotes
from tests.acquisition.fakes import FakeUids, FakeUtc
from tests.acquisition.session_fixtures import whole_session, writer

LINES = 10
"""Start, plan, six captures, an exclusion and a note."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "session"


def made(path: Path) -> tuple[CaptureRecord, ...]:
    records = whole_session(path)
    notes = SessionNotes(
        path, operator="Ada", stamps=Stamps(utc_now=FakeUtc(), new_uid=FakeUids("note"))
    )
    notes.exclude(3, "dust")
    notes.note("lens cleaned")
    return records


def lines_of(path: Path) -> list[bytes]:
    return (path / "journal.jsonl").read_bytes().splitlines(keepends=True)


def all_records(path: Path) -> set[CaptureRecord]:
    return {capture.record for capture in Session(path).captures}


def damage(path: Path, lines: list[bytes]) -> bytes:
    data = b"".join(lines)
    (path / "journal.jsonl").write_bytes(data)
    with pytest.raises(SessionError):
        verify(path)
    return data


@pytest.mark.parametrize("number", range(1, LINES + 1))
@pytest.mark.parametrize("kind", ["altered", "removed", "chain", "garbled"])
def test_one_bad_line_costs_no_capture(path: Path, number: int, kind: str) -> None:
    records = made(path)
    lines = lines_of(path)
    line = lines.pop(number - 1)
    if kind == "altered":
        lines.insert(number - 1, line.replace(b'"utc": "2', b'"utc": "3'))
    elif kind == "chain":
        lines.insert(number - 1, line[:-5] + (b"0" if line[-5:-4] != b"0" else b"1") + line[-4:])
    elif kind == "garbled":
        lines.insert(number - 1, b"\xff" * len(line) + b"\n")
    data = damage(path, lines)
    report = repair_session(path)
    assert report.kept_as is not None
    assert report.kept_as.read_bytes() == data
    assert verify(path).is_ok
    assert all_records(path) == set(records)
    excluded = [c.record.index for c in Session(path).captures if c.excluded_because is not None]
    # Line 9 is the exclusion. A chain can be made again, where there is a line after it.
    assert excluded == ([] if number == 9 and kind != "chain" else [3])
    was_lost = kind != "chain" or number == LINES
    assert [one.number for one in report.lost] == ([number] if was_lost else [])


def test_lines_that_were_doubled_and_moved_come_back_to_their_places(path: Path) -> None:
    records = made(path)
    before = [(event.kind, event.uid) for event in Session(path).events]
    lines = lines_of(path)
    damage(path, [*lines[:2], lines[4], lines[3], lines[2], lines[2], *lines[5:]])
    report = repair_session(path)
    assert report.lost == ()
    assert all_records(path) == set(records)
    assert [(event.kind, event.uid) for event in Session(path).events][:-1] == before


def test_without_a_journal_every_capture_comes_back_from_its_file(path: Path) -> None:
    records = made(path)
    (path / "journal.jsonl").unlink()
    report = repair_session(path)
    assert set(report.records) == set(records)
    assert all(one.is_sealed for one in report.recovered)
    assert [one.number for one in report.lost] == list(range(1, LINES + 1))
    assert verify(path).is_ok
    with JournalWriter(path / "journal.jsonl") as journal:
        journal.append("note", {"text": "goes on"})
    assert verify(path).is_ok


def test_a_file_that_is_no_capture_of_this_session_is_named(path: Path) -> None:
    made(path)
    (path / "captures" / "odd.tif").write_bytes(b"II*\0")
    (path / "journal.jsonl").unlink()
    report = repair_session(path)
    assert [one.file for one in report.left_out] == ["captures/odd.tif"]
    assert not verify(path).is_ok
    # The journal is sound now: a second repair finds nothing to do, and names the file again.
    again = repair_session(path)
    assert (again.kept_as, again.left_out) == (None, report.left_out)
    assert "captures/odd.tif" in again.remarks[-1]
    stamps = Stamps(utc_now=FakeUtc(), new_uid=FakeUids("note"))
    (moved,) = SessionNotes(path, operator="Ada", stamps=stamps).set_aside("from another disk")
    assert (path / moved["to"]).read_bytes() == b"II*\0"
    assert verify(path).is_ok
    assert Session(path).events[-1].facts["set_aside"] == [moved]


def test_a_capture_that_was_altered_after_its_line_was_lost_is_not_taken_in(path: Path) -> None:
    records = made(path)
    (path / "journal.jsonl").unlink()
    altered = path / records[2].file
    data = bytearray(altered.read_bytes())
    data[len(data) // 2] ^= 1
    altered.write_bytes(data)
    report = repair_session(path)
    assert set(report.records) == set(records) - {records[2]}
    (left_out,) = report.left_out
    assert left_out.file == records[2].file
    assert "damaged" in left_out.refusal
    assert not verify(path).is_ok
    assert altered.read_bytes() == data


def test_a_copy_of_a_capture_under_another_name_is_no_second_capture(path: Path) -> None:
    records = made(path)
    copy = path / "captures" / "copy.tif"
    copy.write_bytes((path / records[0].file).read_bytes())
    assert not verify(path).is_ok
    (left_out,) = repair_session(path).left_out
    assert left_out.file == "captures/copy.tif"
    assert "copy of capture 0" in left_out.refusal


def test_a_lost_end_of_a_journal_comes_back_from_the_captures(path: Path) -> None:
    """The head and all lines but the first are gone: the captures are evidence of the rest."""
    records = made(path)
    (path / HEAD_NAME).unlink()
    (path / "journal.jsonl").write_bytes(lines_of(path)[0])
    before = {record.file: (path / record.file).read_bytes() for record in records}
    report = verify(path)
    assert not report.is_ok
    assert records[0].file in report.faults[0]
    with pytest.raises(SessionError) as refused:
        writer(path)
    assert refused.value.fault == "unknown files"
    assert lines_of(path) == [*lines_of(path)[:1]]
    assert not (path / HEAD_NAME).exists()
    assert set(repair_session(path).records) == set(records)
    assert verify(path).is_ok
    with writer(path, prefix="later") as session:
        assert session.pending_entries() == ()
    assert {name: (path / name).read_bytes() for name in before} == before


def test_a_capture_of_an_older_version_comes_back_with_a_remark(path: Path) -> None:
    (record, *_) = made(path)
    older = path / record.file
    older.write_bytes(
        older.read_bytes()[: -len(capture_seal("0" * 64))].replace(b"seal=sha256", b"make=other.")
    )
    (path / "journal.jsonl").unlink()
    report = repair_session(path)
    assert [one.file for one in report.recovered if not one.is_sealed] == [record.file]
    assert any("cannot be told" in text for text in report.remarks)
    assert verify(path).is_ok


def test_a_sound_journal_is_left_alone(path: Path) -> None:
    made(path)
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    assert repair_session(path).kept_as is None
    assert {file: file.read_bytes() for file in path.rglob("*") if file.is_file()} == before


def test_a_lost_line_is_quoted_in_the_new_journal(path: Path) -> None:
    made(path)
    lines = lines_of(path)
    lines[8] = lines[8].replace(b"dust", b"rust")
    damage(path, lines)
    repair_session(path)
    (lost,) = Session(path).events[-1].facts["lost"]
    assert lost["line"] == 9
    assert json.loads(lost["text"])["reason"] == "rust"


def test_a_repair_counts_as_a_change_of_the_captures_and_a_note_does_not(path: Path) -> None:
    made(path)
    before = Session(path).changed_utc
    SessionNotes(path, operator="Ada").note("by the clock of this computer, which is later")
    assert Session(path).changed_utc == before
    lines = lines_of(path)
    assert json.loads(lines[8])["event"] == "exclude"
    damage(path, lines[:8] + lines[9:])
    repair_session(path)
    session = Session(path)
    assert all(capture.excluded_because is None for capture in session.captures)
    assert before < session.changed_utc == session.events[-1].utc


def test_a_session_in_use_is_not_repaired(path: Path) -> None:
    made(path)
    with JournalWriter(path / "journal.jsonl"), pytest.raises(SessionError) as refused:
        repair_session(path)
    assert refused.value.fault == "in use"


def test_a_folder_that_is_no_session_is_left_as_it_is(tmp_path: Path) -> None:
    with pytest.raises(SessionError) as refused:
        repair_session(tmp_path)
    assert refused.value.fault == "not a session"
    assert list(tmp_path.iterdir()) == []


def test_a_head_that_was_removed_is_written_anew(path: Path) -> None:
    made(path)
    (path / HEAD_NAME).unlink()
    assert not verify(path).is_ok
    repair_session(path)
    assert verify(path).is_ok
