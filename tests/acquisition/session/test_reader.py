import hashlib
import json
from pathlib import Path
from xml.etree.ElementTree import fromstring

import numpy as np
import pytest

from acquisition.errors import SessionError
from acquisition.session._journal import (
    HEAD_NAME,
    EventKind,
    JournalEvent,
    JournalHead,
    JournalWriter,
    Stamps,
)
from acquisition.session._reader import Session, _FileCheck, verify
from acquisition.session._repair import repair_session
from acquisition.session._writer import SessionNotes
from tests.acquisition.fakes import FakeUids, FakeUtc
from tests.acquisition.journals import chained_journal, cut_last_line
from tests.acquisition.session_fixtures import (
    DEVICES,
    add,
    bench_of,
    plan_of,
    whole_session,
    writer,
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "session"


def notes(path: Path) -> SessionNotes:
    return SessionNotes(
        path, operator="Ada", stamps=Stamps(utc_now=FakeUtc(), new_uid=FakeUids("note"))
    )


def bad(path: Path) -> list[_FileCheck]:
    return [check for check in verify(path).files if check.state != "ok"]


def flip_byte(path: Path, at: int = -1) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)


def test_a_session_reads_back_what_was_written(path: Path) -> None:
    records = whole_session(path)
    session = Session(path)
    assert session.plan == plan_of()
    assert session.bench == bench_of().model_dump(mode="json")
    assert session.devices == DEVICES
    assert session.manifest.operator == "Zoë"
    assert session.manifest.software["numpy"] == np.__version__
    assert session.records == records
    assert session.is_complete
    assert session.remarks == ()
    images = session.load(records[4])
    assert images.mean_dn == pytest.approx(1004, abs=0)
    assert images.variance_dn2 == pytest.approx(2, abs=0)
    assert images.record == records[4]


def test_the_hash_in_the_journal_is_that_of_sha256sum(path: Path) -> None:
    record = whole_session(path)[0]
    assert record.file == "captures/0000_edge-005_h0100.000mm.tif"
    assert record.sha256 == hashlib.sha256((path / record.file).read_bytes()).hexdigest()


def test_a_directory_that_is_no_session_says_so_in_one_line(path: Path) -> None:
    for open_it in (Session, verify):
        with pytest.raises(SessionError) as refused:
            open_it(path)
        assert refused.value.fault == "not a session"
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "fault", "first_key"),
    [
        ("{", "damaged", ()),
        ("[]", None, ("schema",)),
        ('{"schema": "standoff.session/2"}', None, ("schema",)),
        ('{"schema": "standoff.session/1"}', None, ("bench",)),
    ],
)
def test_a_damaged_session_json_says_so(
    path: Path, text: str, fault: str | None, first_key: tuple[str, ...]
) -> None:
    whole_session(path)
    (path / "session.json").write_text(text)
    with pytest.raises(SessionError) as refused:
        Session(path)
    assert (refused.value.fault, refused.value.keys[:1]) == (fault, first_key)


def test_a_session_json_with_another_plan_inside_names_the_key(path: Path) -> None:
    whole_session(path)
    document = json.loads((path / "session.json").read_text())
    document["plan"]["name"] = ""
    (path / "session.json").write_text(json.dumps(document))
    with pytest.raises(SessionError) as refused:
        Session(path)
    assert refused.value.keys == ("name",)
    document["plan"] = None
    (path / "session.json").write_text(json.dumps(document))
    with pytest.raises(SessionError) as refused:
        Session(path)
    assert refused.value.keys == ("plan",)


def test_a_session_without_its_journal_says_so(path: Path) -> None:
    whole_session(path)
    (path / "journal.jsonl").unlink()
    with pytest.raises(SessionError) as refused:
        Session(path)
    assert refused.value.path == path / "journal.jsonl"


def test_verify_finds_a_whole_session_whole(path: Path) -> None:
    whole_session(path)
    report = verify(path)
    assert report.is_ok
    assert len(report.files) == 7  # session.json and six captures
    assert report.remarks == ()


def test_one_flipped_bit_anywhere_in_a_file_is_found(path: Path) -> None:
    record = whole_session(path)[2]
    file = path / record.file
    for at in range(0, file.stat().st_size, 97):
        flip_byte(file, at)
        (check,) = bad(path)
        assert (check.file, check.state, check.uid) == (record.file, "changed", record.uid)
        with pytest.raises(SessionError) as refused:
            Session(path).load(record)
        assert refused.value.fault == "changed"
        flip_byte(file, at)
    assert verify(path).is_ok


def test_a_missing_file_is_found(path: Path) -> None:
    record = whole_session(path)[1]
    (path / record.file).unlink()
    assert [(c.file, c.state) for c in bad(path)] == [(record.file, "missing")]
    with pytest.raises(SessionError) as refused:
        Session(path).load(record)
    assert refused.value.path == path / record.file


def test_a_changed_session_json_is_found(path: Path) -> None:
    whole_session(path)
    text = (path / "session.json").read_text()
    (path / "session.json").write_text(text.replace("Zoë", "Zoe"))
    assert [(c.file, c.state) for c in bad(path)] == [("session.json", "changed")]


def test_a_file_without_a_journal_line_is_a_fault_that_names_it(path: Path) -> None:
    whole_session(path)
    (path / "captures" / "stray.tif").write_bytes(b"x")
    (path / "captures" / "0001.tif.part").write_bytes(b"x")
    report = verify(path)
    assert not report.is_ok
    assert "captures/stray.tif" in report.faults[0]
    assert {c.file: c.state for c in report.files if c.state != "ok"} == {
        "captures/0001.tif.part": "unfinished",
        "captures/stray.tif": "unjournaled",
    }
    assert report.remarks == (
        "captures/0001.tif.part is left from a run that was killed while writing; delete it",
    )


def test_what_file_managers_and_kills_leave_is_no_fault(path: Path) -> None:
    whole_session(path)
    for name in (".DS_Store", "Thumbs.db", "desktop.ini", "._0001.tif", "0001.tif.part"):
        (path / "captures" / name).write_bytes(b"x")
    assert verify(path).is_ok


def test_a_journal_line_cut_short_is_a_remark_and_its_capture_does_not_exist(path: Path) -> None:
    records = whole_session(path)
    journal = path / "journal.jsonl"
    cut_last_line(journal, 20)
    session = Session(path)
    assert session.records == records[:-1]
    assert not session.is_complete
    report = verify(path)
    assert report.remarks == session.remarks
    assert "cut short" in report.remarks[0]
    assert [(c.file, c.state) for c in bad(path)] == [(records[-1].file, "unjournaled")]


@pytest.mark.parametrize("rest", [b"", b"{"])
def test_captures_without_a_line_in_the_journal_are_a_fault_and_can_be_repaired(
    path: Path, rest: bytes
) -> None:
    whole_session(path)
    (path / "journal.jsonl").write_bytes(rest)
    (path / HEAD_NAME).unlink()
    report = verify(path)
    assert not report.is_ok
    assert "journal.jsonl" in report.faults[0]
    assert repair_session(path).recovered
    assert verify(path).is_ok


def test_raw_frames_are_verified_too(path: Path) -> None:
    frames = (np.full((4, 6), 7, np.uint16), np.full((4, 6), 9, np.uint16))
    with writer(path) as session:
        record = add(session, session.entries[0], raw_frames=frames)
    assert record.frames_file == "frames/0000_edge-005_h0100.000mm.tif"
    assert verify(path).is_ok
    flip_byte(path / record.frames_file)
    assert [(c.file, c.state) for c in bad(path)] == [(record.frames_file, "changed")]


def test_an_excluded_capture_is_marked_and_can_be_taken_back_in(path: Path) -> None:
    records = whole_session(path)
    notes(path).exclude(3, "someone walked by")
    session = Session(path)
    assert [r.index for r in session.records] == [0, 1, 2, 4, 5]
    assert session.captures[3].excluded_because == "someone walked by"
    assert session.is_complete
    event = session.events[-1]
    assert (event.kind, event.facts["operator"]) == ("exclude", "Ada")
    notes(path).include(3, "it was nobody")
    assert Session(path).records == records
    with pytest.raises(SessionError) as refused:
        notes(path).include(3, "again")
    assert refused.value.fault == "no capture"


def test_a_retake_voids_the_capture_until_it_is_captured_again(path: Path) -> None:
    records = whole_session(path)
    notes(path).retake(2, "lamp off")
    assert not Session(path).is_complete
    with pytest.raises(SessionError) as refused:
        notes(path).exclude(2, "also this")
    assert refused.value.fault == "no capture"
    with writer(path, prefix="later") as session:
        (entry,) = session.pending_entries()
        assert entry.index == 2
        retaken = add(session, entry, 2000.0)
    assert retaken.file == "captures/0002_edge-095_h0100.000mm_take2.tif"
    reread = Session(path)
    assert reread.records == (*records[:2], retaken, *records[3:])
    assert [c.record.uid for c in reread.captures if c.is_superseded] == [records[2].uid]
    assert reread.load(records[2]).mean_dn == pytest.approx(1002, abs=0)  # kept, not overwritten
    assert verify(path).is_ok
    flip_byte(path / records[2].file)
    assert verify(path).is_ok  # a superseded file no longer counts


def test_a_note_is_kept_with_who_wrote_it(path: Path) -> None:
    whole_session(path)
    notes(path).note("lens cleaned")
    assert Session(path).events[-1].facts == {"text": "lens cleaned", "operator": "Ada"}


def test_notes_make_no_session_where_there_is_none(path: Path) -> None:
    path.mkdir()
    with pytest.raises(SessionError) as refused:
        notes(path).note("x")
    assert refused.value.fault == "not a session"
    assert list(path.iterdir()) == []


@pytest.mark.parametrize(
    ("kind", "facts", "fault", "first_key"),
    [
        ("exclude", {"capture": "nobody"}, "no capture", ()),
        ("retake", {"supersedes": ["a"]}, "no capture", ()),
        ("height", {"capture": "nobody", "height_mm": 9.0}, "no capture", ()),
        ("capture", {}, "damaged", ("record",)),
        ("capture", {"record": {}}, "damaged", ("index",)),
    ],
)
def test_an_event_that_makes_no_sense_names_its_line(
    path: Path, kind: EventKind, facts: dict[str, object], fault: str, first_key: tuple[str, ...]
) -> None:
    whole_session(path)
    with JournalWriter(path / "journal.jsonl") as journal:
        journal.append(kind, facts)
    with pytest.raises(SessionError) as refused:
        Session(path)
    assert (refused.value.fault, refused.value.line) == (fault, 9)
    assert refused.value.keys[:1] == first_key


@pytest.mark.parametrize("height_mm", [None, "9", True, 10**400])
def test_a_corrected_height_that_is_none_names_its_line(path: Path, height_mm: object) -> None:
    records = whole_session(path)
    with JournalWriter(path / "journal.jsonl") as journal:
        journal.append("height", {"capture": records[0].uid, "height_mm": height_mm})
    with pytest.raises(SessionError) as refused:
        Session(path)
    assert (refused.value.fault, refused.value.line) == ("damaged", 9)
    assert refused.value.keys == ("height_mm",)


def test_a_session_is_opened_by_a_path_in_either_form(path: Path) -> None:
    records = whole_session(path)
    assert Session(str(path)).records == Session(path).records == records
    assert Session(str(path)).path == path


@pytest.mark.parametrize("wrong", [None, 7, b"session", ["session"]])
def test_what_is_no_path_is_a_type_error_in_one_line(wrong: object) -> None:
    with pytest.raises(TypeError) as refused:
        Session(wrong)  # type: ignore[arg-type]  # wrong on purpose
    assert type(wrong).__name__ in str(refused.value)


def test_a_session_shows_its_path_and_the_number_of_its_captures(path: Path) -> None:
    whole_session(path)
    assert repr(Session(path)) == f"Session({str(path)!r}: 6 captures (4 edge, 2 flat))"
    notes(path).exclude(0, "a fly")
    assert "5 captures" in repr(Session(path))


def test_an_empty_session_shows_that_it_is(path: Path) -> None:
    writer(path).close()
    assert repr(Session(path)) == f"Session({str(path)!r}: 0 captures)"


def test_a_session_in_a_notebook_is_a_small_table_of_escaped_text(path: Path) -> None:
    writer(path, plan=plan_of(name="<b>lens & board</b>")).close()
    table = Session(path)._repr_html_()
    assert "&lt;b&gt;lens &amp; board&lt;/b&gt;" in table
    assert len(table) < 1000
    fromstring(table)  # well formed


def rewritten(path: Path, change: dict[str, object]) -> None:
    """Make the journal anew, as a program might that is wrong, with one record changed."""
    with (path / "journal.jsonl").open() as journal:
        documents = [json.loads(line) for line in journal]
    events = []
    for document in documents:
        del document["seq"], document["chain"]
        if document["event"] == "capture" and document["record"]["index"] == 4:
            document["record"].update(change)
        events.append(JournalEvent.from_line(json.dumps(document).encode()))
    data = chained_journal(events)
    (path / "journal.jsonl").write_bytes(data)
    chain = json.loads(data.splitlines()[-1])["chain"]
    head = JournalHead(lines=len(events), chain=chain)
    (path / HEAD_NAME).write_bytes(head.to_bytes())


@pytest.mark.parametrize(
    ("change", "count"),
    [
        ({"height_mm": 101.5}, 1),
        ({"height_asked_mm": 101.5}, 2),
        ({"target": "other"}, 2),
        ({"exposure_us": None}, 1),
    ],
)
def test_a_record_at_odds_with_its_file_or_the_plan_is_a_fault_that_names_the_line(
    path: Path, change: dict[str, object], count: int
) -> None:
    whole_session(path)
    rewritten(path, {})
    assert verify(path).is_ok
    rewritten(path, change)
    report = verify(path)
    assert not report.is_ok
    # The file holds another record, and where the plan asks for it, it asks for something else.
    assert len(report.faults) == count
    assert all("line 7: capture 4" in fault for fault in report.faults)
