"""Journals as bytes: as this version writes them, and as those before it did."""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

from acquisition.session._journal import HEAD_NAME, JournalEvent, JournalHead


def unchained_journal(events: Iterable[JournalEvent]) -> bytes:
    """Lines without a number and a chain."""
    return b"".join(_text(event).encode() + b"\n" for event in events)


def chained_journal(events: Iterable[JournalEvent], first: int = 1, before: bytes = b"") -> bytes:
    """Lines from a number on, after other bytes that are not chained.

    Written out from the definition of the format, so as not to share its code.
    """
    chain = hashlib.sha256(before).hexdigest()
    lines = b""
    for number, event in enumerate(events, start=first):
        text = f'{{"seq": {number}, {_text(event)[1:]}'
        chain = hashlib.sha256((chain + text).encode()).hexdigest()
        lines += f'{text[:-1]}, "chain": "{chain}"}}\n'.encode()
    return lines


def _text(event: JournalEvent) -> str:
    document = {"event": event.kind, "utc": event.utc, "uid": event.uid, **event.facts}
    return json.dumps(document, ensure_ascii=False)


def cut_last_line(journal: Path, size: int) -> None:
    """Take the last bytes off a journal as a power cut does: its head does not count the line."""
    data = journal.read_bytes()[:-size]
    journal.write_bytes(data)
    whole = data.splitlines()[:-1]
    head = JournalHead(lines=len(whole), chain=json.loads(whole[-1])["chain"])
    journal.with_name(HEAD_NAME).write_bytes(head.to_bytes())
