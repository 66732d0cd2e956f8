"""The journal of a session and its chain."""

import errno
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.errors import SessionError
from acquisition.session._journal import (
    HEAD_NAME,
    LARGEST_LINE_BYTES,
    JournalEvent,
    JournalHead,
    JournalReading,
    JournalWriter,
    Stamps,
    _read_journal,
    read_journal_file,
)
from tests.acquisition.fakes import FakeUids, FakeUtc
from tests.acquisition.journals import chained_journal, unchained_journal
from tests.acquisition.records import RECORD

EVENTS = (
    JournalEvent(kind="start", utc="2025-03-04T05:06:07Z", uid="a", facts={"operator": "Zoë"}),
    JournalEvent(kind="capture", utc="2025-03-04T05:06:08Z", uid="b", facts={"record": {"x": 1}}),
    JournalEvent(kind="note", utc="2025-03-04T05:06:09Z", uid="c", facts={"text": 'a "b"\n\\ 日'}),
)
JOURNAL = chained_journal(EVENTS)
UNCHAINED = unchained_journal(EVENTS)
both = pytest.mark.parametrize("data", [JOURNAL, UNCHAINED], ids=["chained", "unchained"])


def writer(path: Path) -> JournalWriter:
    return JournalWriter(path, Stamps(utc_now=FakeUtc(), new_uid=FakeUids()))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.jsonl"


@both
def test_events_read_back_as_they_were_written(data: bytes) -> None:
    reading = _read_journal(data)
    assert reading.events == EVENTS
    assert (reading.sound_bytes, reading.torn_tail) == (len(data), b"")
    assert reading.unchained == (0 if data == JOURNAL else len(EVENTS))


@both
def test_a_journal_cut_at_any_byte_gives_every_event_before(data: bytes) -> None:
    starts = [data.find(line) for line in data.splitlines()]
    # A line is whole once its last brace is there, with or without the newline after it.
    ends = [start + len(line) for start, line in zip(starts, data.splitlines(), strict=True)]
    for length in range(len(data) + 1):
        reading = _read_journal(data[:length])
        whole = sum(end <= length for end in ends)
        assert reading.events == EVENTS[:whole]
        cut = whole < len(EVENTS) and length > starts[whole]
        assert bool(reading.torn_tail) == cut


@pytest.mark.slow
@both
def test_a_journal_cut_at_any_byte_goes_on_after_being_mended(path: Path, data: bytes) -> None:
    for length in range(len(data) + 1):
        path.with_name(HEAD_NAME).unlink(missing_ok=True)
        path.write_bytes(data[:length])
        cut = _read_journal(data[:length])
        if cut.events and not cut.unchained:
            # As after a power cut: the head counts the lines that were whole before.
            counted = JournalHead(lines=len(cut.events), chain=cut.chain)
            path.with_name(HEAD_NAME).write_bytes(counted.to_bytes())
        with writer(path) as journal:
            journal.append("resume", {})
        again = read_journal_file(path)
        notes = ("note",) if cut.torn_tail else ()
        assert [e.kind for e in again.events] == [*(e.kind for e in cut.events), *notes, "resume"]
        assert (again.torn_tail, again.is_head_missing) == (b"", False)
        if cut.torn_tail:
            quoted = again.events[-2].facts["cut_short"].encode()
            assert data.startswith(quoted[:1])


@both
@given(tail=st.binary(max_size=40))
def test_whatever_a_power_cut_leaves_at_the_end_is_ignored_and_reported(
    data: bytes, tail: bytes
) -> None:
    tail = tail.replace(b"\n", b"\0")
    reading = _read_journal(data + tail)
    assert reading.events == EVENTS
    assert reading.torn_tail == tail
    assert any("cut short" in remark for remark in reading.remarks) == bool(tail)


@pytest.mark.parametrize("byte", [b"a", b"\0", b"\xff"])
def test_an_end_longer_than_any_line_that_is_written_is_damage(path: Path, byte: bytes) -> None:
    longest = JOURNAL + byte * LARGEST_LINE_BYTES
    assert _read_journal(longest).torn_tail == longest[len(JOURNAL) :]
    with pytest.raises(SessionError, match=f"line {len(EVENTS) + 1}: damaged"):
        _read_journal(longest + byte)
    path.write_bytes(longest)
    with writer(path) as journal:
        note = journal.events[len(EVENTS)]
    assert byte.decode(errors="backslashreplace") * 1000 in note.facts["cut_short"]
    assert read_journal_file(path).events[len(EVENTS)] == note


def test_a_note_longer_than_a_line_is_refused_and_nothing_is_written(path: Path) -> None:
    with writer(path) as journal:
        journal.append("note", {"text": "short"})
        before = path.read_bytes()
        with pytest.raises(SessionError, match="at most 1 MiB"):
            journal.append("note", {"text": "a" * LARGEST_LINE_BYTES})
        assert path.read_bytes() == before
        journal.append("note", {"text": "short"})
    assert len(read_journal_file(path).events) == 2


def test_a_remark_names_the_line() -> None:
    assert any("line 3" in remark for remark in _read_journal(JOURNAL[:-5]).remarks)


@pytest.mark.parametrize(
    "bad",
    [
        b"{",
        b"",
        b"[]",
        b"\xff",
        b'{"event": "start", "utc": "t"}',
        b'{"event": "dance", "utc": "t", "uid": "u"}',
    ],
)
@both
def test_damage_before_the_last_line_is_an_error_that_names_the_line(
    data: bytes, bad: bytes
) -> None:
    lines = data.splitlines()
    lines[1] = bad
    with pytest.raises(SessionError) as refused:
        _read_journal(b"\n".join(lines) + b"\n")
    assert (refused.value.fault, refused.value.line) == ("damaged", 2)


def test_every_line_is_durable_before_append_returns(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[bytes] = []
    monkeypatch.setattr(os, "fsync", lambda _: synced.append(path.read_bytes()))
    with writer(path) as journal:
        synced.clear()
        journal.append("note", {"text": "x"})
    assert synced[0] == path.read_bytes() != b""


def test_the_head_never_counts_a_line_that_is_not_durable(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced = [b""]
    replaced: list[int] = []
    fsync, replace = os.fsync, Path.replace

    def record_fsync(descriptor: int) -> None:
        fsync(descriptor)
        synced.append(path.read_bytes())

    def record_replace(part: Path, target: Path) -> Path:
        replaced.append(JournalHead.from_bytes(part.read_bytes()).lines)
        assert replaced[-1] <= synced[-1].count(b"\n")
        return replace(part, target)

    monkeypatch.setattr(os, "fsync", record_fsync)
    monkeypatch.setattr(Path, "replace", record_replace)
    with writer(path) as journal:
        for _ in range(3):
            journal.append("note", {"text": "x"})
    assert replaced == [1, 2, 3]


def test_a_full_disk_takes_the_half_written_line_back(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = os.write

    def half_then_full(descriptor: int, data: bytes) -> int:
        if len(data) < 40:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data[:40])

    with writer(path) as journal:
        before = journal.append("note", {"text": "first"})
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", half_then_full)
            with pytest.raises(SessionError) as refused:
                journal.append("note", {"text": "second"})
            assert refused.value.fault == "unwritable"
        after = journal.append("note", {"text": "third"})
        assert journal.events == (before, after)
    assert _read_journal(path.read_bytes()).events == (before, after)


def test_facts_cannot_take_the_place_of_the_kind() -> None:
    with pytest.raises(ValueError):
        JournalEvent(kind="note", utc="t", uid="u", facts={"event": "capture"})


def test_a_second_writer_is_refused_until_the_first_has_closed(path: Path) -> None:
    with writer(path), pytest.raises(SessionError) as refused:
        writer(path)
    assert refused.value.fault == "in use"
    writer(path).close()


@pytest.mark.slow
def test_the_lock_holds_between_processes_and_ends_with_them(path: Path) -> None:
    script = (
        "import sys, pathlib\n"
        "from acquisition.session._journal import JournalWriter\n"
        "journal = JournalWriter(pathlib.Path(sys.argv[1]))\n"
        "print('locked', flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "locked\n"
        with pytest.raises(SessionError) as refused:
            writer(path)
        assert refused.value.fault == "in use"
        other.kill()
        other.wait()
    writer(path).close()


def test_a_journal_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    with pytest.raises(SessionError) as refused:
        writer(tmp_path / "absent" / "journal.jsonl")
    assert refused.value.path == tmp_path / "absent" / "journal.jsonl"


UTC = "2025-03-04T05:06:07.000000Z"
CHAINED_EVENTS = (
    JournalEvent(kind="start", utc=UTC, uid="a", facts={"operator": "Zoë", "session_sha256": "e"}),
    JournalEvent(kind="plan", utc=UTC, uid="b", facts={"name": "p", "captures": 2}),
    JournalEvent(kind="capture", utc=UTC, uid="u7", facts={"record": RECORD.to_json()}),
    JournalEvent(kind="exclude", utc=UTC, uid="d", facts={"capture": "u7", "reason": "dust"}),
    JournalEvent(kind="include", utc=UTC, uid="e", facts={"capture": "u7", "reason": ""}),
    JournalEvent(kind="height", utc=UTC, uid="i", facts={"capture": "u7", "height_mm": 9.0}),
    JournalEvent(kind="retake", utc=UTC, uid="f", facts={"supersedes": "u7", "index": 7}),
    JournalEvent(kind="note", utc=UTC, uid="g", facts={"text": "seen"}),
    JournalEvent(kind="stop", utc=UTC, uid="h", facts={}),
)
CHAINED = chained_journal(CHAINED_EVENTS)
LINES = CHAINED.splitlines(keepends=True)
HEAD = JournalHead(lines=len(LINES), chain=json.loads(LINES[-1])["chain"])


def altered(count: int, seed: int) -> Iterator[tuple[str, bytes, bytes]]:
    """Alterations of the journal or of its head: what was done, and both files."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        lines, head = list(LINES), HEAD.to_bytes()
        line = int(rng.integers(len(lines)))
        kind = ("flip", "flip", "flip", "delete", "double", "swap", "edit", "head")[number % 8]
        if kind == "flip":
            data = bytearray(CHAINED)
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
            lines = [bytes(data)]
        elif kind == "delete":
            del lines[line : line + int(rng.integers(1, 3))]
        elif kind == "double":
            lines.insert(int(rng.integers(len(lines) + 1)), lines[line])
        elif kind == "swap":
            other = (line + int(rng.integers(1, len(lines)))) % len(lines)
            lines[line], lines[other] = lines[other], lines[line]
        elif kind == "edit":
            lines[line] = edited(lines[line], rng)
        else:
            bits = bytearray(head)
            bits[rng.integers(len(bits))] ^= 1 << int(rng.integers(8))
            head = bytes(bits)
        yield f"{kind} {line + 1}", b"".join(lines), head


def edited(line: bytes, rng: np.random.Generator) -> bytes:
    """The line with one of its fields changed, at any depth."""
    document = json.loads(line)
    place = document
    while True:
        key = list(place)[rng.integers(len(place))]
        if not (isinstance(place[key], dict) and place[key]):
            break
        place = place[key]
    value = place[key]
    if isinstance(value, int | float):
        place[key] = value + 1
    else:
        place[key] = f"{value}x"
    return json.dumps(document, ensure_ascii=False).encode() + b"\n"


@pytest.mark.slow
def test_of_10000_alterations_none_that_changes_an_event_is_read() -> None:
    found = 0
    for what, journal, head in altered(10_000, 1):
        try:
            reading = _read_journal(journal, head=JournalHead.from_bytes(head))
        except (SessionError, ValueError):
            found += 1
            continue
        assert reading.events == CHAINED_EVENTS, what
        assert journal.rstrip() == CHAINED.rstrip(), what
    # A swap of equal lines and the like do not exist here; a lost last newline changes nothing.
    assert found >= 9_990


@pytest.mark.parametrize("line", range(1, len(LINES) + 1))
def test_the_line_that_was_altered_is_named(line: int) -> None:
    lines = list(LINES)
    lines[line - 1] = lines[line - 1].replace(b'"utc": "2025', b'"utc": "2026')
    with pytest.raises(SessionError) as refused:
        _read_journal(b"".join(lines), head=HEAD)
    assert (refused.value.fault, refused.value.line) == ("damaged", line)


@pytest.mark.parametrize("line", range(1, len(LINES) + 1))
def test_the_line_that_is_missing_is_named(line: int) -> None:
    with pytest.raises(SessionError) as refused:
        _read_journal(b"".join([*LINES[: line - 1], *LINES[line:]]), head=HEAD)
    assert (refused.value.fault, refused.value.line) == ("damaged", line)


def test_a_head_that_lags_behind_is_no_fault() -> None:
    for lines in range(1, len(LINES)):
        head = JournalHead(lines=lines, chain=json.loads(LINES[lines - 1])["chain"])
        assert _read_journal(CHAINED, head=head).events == CHAINED_EVENTS


def test_a_journal_of_an_older_version_is_read_and_said_to_be_unchained() -> None:
    reading = _read_journal(unchained_journal(CHAINED_EVENTS))
    assert (reading.events, reading.unchained) == (CHAINED_EVENTS, len(CHAINED_EVENTS))
    assert any("unchained" in remark for remark in reading.remarks)


def test_what_is_added_to_an_older_journal_vouches_for_all_of_it(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    old = unchained_journal(CHAINED_EVENTS[:4])
    path.write_bytes(old)
    with JournalWriter(path, Stamps(utc_now=FakeUtc(), new_uid=FakeUids())) as journal:
        journal.append("note", {"text": "new"})
    assert path.read_bytes() == old + chained_journal(journal.events[4:], first=5, before=old)
    assert read_journal_file(path).unchained == 4
    path.write_bytes(path.read_bytes().replace(b"dust", b"rust"))
    with pytest.raises(SessionError):
        read_journal_file(path)


def test_a_repeated_key_in_an_unchained_line_is_damage() -> None:
    line = unchained_journal(CHAINED_EVENTS[:1])
    repeated = line.replace(b'"uid": "a"', b'"uid": "a", "uid": "z"')
    with pytest.raises(SessionError) as refused:
        _read_journal(repeated + line)
    assert refused.value.line == 1


def test_a_missing_head_is_told_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(CHAINED)
    assert read_journal_file(path).is_head_missing
    with JournalWriter(path):
        pass
    mended = read_journal_file(path)
    assert not mended.is_head_missing
    assert HEAD_NAME in mended.events[-1].facts["text"]


@pytest.mark.parametrize("stage", ["line", "head"])
def test_an_append_that_is_interrupted_leaves_a_journal_that_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    path = tmp_path / "journal.jsonl"

    def interrupted(part: Path, target: Path) -> Path:
        if stage == "head":
            part.rename(target)
        raise KeyboardInterrupt

    with JournalWriter(path) as journal:
        journal.append("note", {"text": "first"})
        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", interrupted)
            with pytest.raises(KeyboardInterrupt):
                journal.append("note", {"text": "second"})
        journal.append("stop", {})
    reading: JournalReading = read_journal_file(path)
    assert [event.kind for event in reading.events] == ["note", "note", "stop"]
    assert reading.head == JournalHead(lines=3, chain=reading.chain)
