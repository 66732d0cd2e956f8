"""A session with as many captures as one likes, made from a short one."""

import json
from pathlib import Path
from uuid import UUID

from acquisition.session import JOURNAL_NAME


def lengthen(session: Path, captures: int) -> None:
    """Give the session ``captures`` captures: its last one, again and again under new indices.

    Only the journal is written, as a session's page reads nothing else: `verify` finds no files.
    """
    journal = session / JOURNAL_NAME
    lines = journal.read_bytes().splitlines()
    begin: list[bytes] = []
    taken: list[bytes] = []
    for line in lines:
        (taken if json.loads(line)["event"] == "capture" else begin).append(line)
    last = json.loads(taken[-1])
    for number in range(captures):
        uid = UUID(int=number).hex
        record = last["record"] | {"index": number, "uid": uid}
        begin.append(json.dumps(last | {"uid": uid, "record": record}).encode())
    journal.write_bytes(b"\n".join(begin) + b"\n")
