"""One event of a session's journal."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self, get_args

from acquisition.untrusted import parse_json

EventKind = Literal[
    "start",
    "plan",
    "capture",
    "skip",
    "error",
    "resume",
    "stop",
    "retake",
    "exclude",
    "include",
    "height",
    "note",
]

CHAIN_KEYS = ("seq", "chain")
"""What a line has besides its event."""

_OWN_KEYS = ("event", "utc", "uid", *CHAIN_KEYS)


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalEvent:
    """One event: kind, time (UTC, ISO 8601), its own uid, and facts that depend on the kind."""

    kind: EventKind
    utc: str
    uid: str
    facts: Mapping[str, Any]

    def __post_init__(self) -> None:
        if not self.facts.keys().isdisjoint(_OWN_KEYS):
            raise ValueError(f"facts must not be named {_OWN_KEYS}, got {list(self.facts)}")

    def to_text(self, number: int) -> bytes:
        """JSON object of the event as line ``number`` of a journal, without a newline."""
        document = {
            "seq": number,
            "event": self.kind,
            "utc": self.utc,
            "uid": self.uid,
            **self.facts,
        }
        return json.dumps(document, ensure_ascii=False, allow_nan=False).encode()

    @classmethod
    def from_line(cls, line: bytes) -> Self:
        """Read one line, chained or not.

        Raises
        ------
        ValueError
            If it is not an event; the message says why.
        """
        document = parse_json(line)
        if not isinstance(document, dict):
            raise ValueError("not a JSON object")  # noqa: TRY004
        facts = {key: value for key, value in document.items() if key not in _OWN_KEYS}
        utc, uid = document.get("utc"), document.get("uid")
        if not (isinstance(utc, str) and isinstance(uid, str) and uid):
            raise ValueError("an event needs utc and uid")
        for kind in get_args(EventKind):
            if kind == document.get("event"):
                return cls(kind=kind, utc=utc, uid=uid, facts=facts)
        raise ValueError(f"unknown event {document.get('event')!r}")
