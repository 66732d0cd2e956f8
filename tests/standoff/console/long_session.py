"""A session with as many captures as one likes, made from a short one."""

from dataclasses import replace
from pathlib import Path
from uuid import UUID

from acquisition.session import JOURNAL_NAME
from acquisition.session._journal import HEAD_NAME, read_journal_file
from tests.acquisition.journals import chained_journal


def lengthen(session: Path, captures: int) -> None:
    """Give the session ``captures`` captures: its last one, again and again under new indices.

    Only the journal is written, as a session's page reads nothing else: `verify` finds no files.
    """
    journal = session / JOURNAL_NAME
    reading = read_journal_file(journal)
    begin = [event for event in reading.events if event.kind != "capture"]
    last = next(event for event in reversed(reading.events) if event.kind == "capture")
    for number in range(captures):
        uid = UUID(int=number).hex
        record = last.facts["record"] | {"index": number, "uid": uid}
        begin.append(replace(last, uid=uid, facts={"record": record}))
    journal.write_bytes(chained_journal(begin))
    journal.with_name(HEAD_NAME).unlink()
