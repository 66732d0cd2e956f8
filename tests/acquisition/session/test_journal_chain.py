"""What the chain of a journal finds out; each alteration is made to the bytes of the files."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from acquisition.errors import SessionError
from acquisition.session.journal import (
    HEAD_NAME,
    JournalEvent,
    JournalHead,
    JournalReading,
    JournalWriter,
    Stamps,
    read_journal,
    read_journal_file,
)
from tests.acquisition.fakes import FakeUids, FakeUtc
from tests.acquisition.journals import chained_journal, unchained_journal
from tests.acquisition.records import RECORD

UTC = "2025-03-04T05:06:07.000000Z"
EVENTS = (
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
JOURNAL = chained_journal(EVENTS)
LINES = JOURNAL.splitlines(keepends=True)
HEAD = JournalHead(lines=len(LINES), chain=json.loads(LINES[-1])["chain"])


def altered(count: int, seed: int) -> Iterator[tuple[str, bytes, bytes]]:
    """Alterations of the journal or of its head: what was done, and both files."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        lines, head = list(LINES), HEAD.to_bytes()
        line = int(rng.integers(len(lines)))
        kind = ("flip", "flip", "flip", "delete", "double", "swap", "edit", "head")[number % 8]
        if kind == "flip":
            data = bytearray(JOURNAL)
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
            reading = read_journal(journal, head=JournalHead.from_bytes(head))
        except (SessionError, ValueError):
            found += 1
            continue
        assert reading.events == EVENTS, what
        assert journal.rstrip() == JOURNAL.rstrip(), what
    # A swap of equal lines and the like do not exist here; a lost last newline changes nothing.
    assert found >= 9_990


@pytest.mark.parametrize("line", range(1, len(LINES) + 1))
def test_the_line_that_was_altered_is_named(line: int) -> None:
    lines = list(LINES)
    lines[line - 1] = lines[line - 1].replace(b'"utc": "2025', b'"utc": "2026')
    with pytest.raises(SessionError) as refused:
        read_journal(b"".join(lines), head=HEAD)
    assert (refused.value.fault, refused.value.line) == ("damaged", line)


@pytest.mark.parametrize("line", range(1, len(LINES) + 1))
def test_the_line_that_is_missing_is_named(line: int) -> None:
    with pytest.raises(SessionError) as refused:
        read_journal(b"".join([*LINES[: line - 1], *LINES[line:]]), head=HEAD)
    assert (refused.value.fault, refused.value.line) == ("damaged", line)


def test_a_head_that_lags_behind_is_no_fault() -> None:
    for lines in range(1, len(LINES)):
        head = JournalHead(lines=lines, chain=json.loads(LINES[lines - 1])["chain"])
        assert read_journal(JOURNAL, head=head).events == EVENTS


def test_a_journal_of_an_older_version_is_read_and_said_to_be_unchained() -> None:
    reading = read_journal(unchained_journal(EVENTS))
    assert (reading.events, reading.unchained) == (EVENTS, len(EVENTS))
    assert any("unchained" in remark for remark in reading.remarks)


def test_what_is_added_to_an_older_journal_vouches_for_all_of_it(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    old = unchained_journal(EVENTS[:4])
    path.write_bytes(old)
    with JournalWriter(path, Stamps(utc_now=FakeUtc(), new_uid=FakeUids())) as journal:
        journal.append("note", {"text": "new"})
    assert path.read_bytes() == old + chained_journal(journal.events[4:], first=5, before=old)
    assert read_journal_file(path).unchained == 4
    path.write_bytes(path.read_bytes().replace(b"dust", b"rust"))
    with pytest.raises(SessionError):
        read_journal_file(path)


def test_a_repeated_key_in_an_unchained_line_is_damage() -> None:
    line = unchained_journal(EVENTS[:1])
    repeated = line.replace(b'"uid": "a"', b'"uid": "a", "uid": "z"')
    with pytest.raises(SessionError) as refused:
        read_journal(repeated + line)
    assert refused.value.line == 1


def test_a_missing_head_is_told_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(JOURNAL)
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
