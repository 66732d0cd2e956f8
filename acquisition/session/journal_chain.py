"""The chain that holds the lines of a journal together, and the head that says where it ends.

Each line ends in ``"chain"``: the SHA-256 of the chain before it and of the line without it. What
was altered, removed, added or moved since is then at odds with it. The head holds the number of
lines and the last chain, so that the end cannot go unnoticed either. It guards against accidents;
whoever makes all hashes anew is not found out.
"""

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_json

JOURNAL_NAME = "journal.jsonl"
HEAD_NAME = "journal.head"
NO_LINES = hashlib.sha256().hexdigest()
"""Chain before the first line."""

LARGEST_LINE_BYTES = 1 << 20
"""Of what is appended; a capture takes 1 kB, and a note fits into a command line of 128 kB."""

_SCHEMA = "standoff.journal-head/1"
_TAIL = re.compile(rb', "chain": "([0-9a-f]{64})"\}')
_TAIL_BYTES = len(b', "chain": ""}') + 64
_SEQ = re.compile(rb'\{"seq": ([0-9]{1,9}), ')


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainedLine:
    """A line taken apart: its JSON object without the chain, and the chain that it states."""

    text: bytes
    chain: str

    @classmethod
    def parse(cls, line: bytes) -> Self | None:
        """Take a line apart; None if it has no chain."""
        line = line.removesuffix(b"\n")
        found = _TAIL.fullmatch(line[-_TAIL_BYTES:])
        if found is None:
            return None
        return cls(text=line[:-_TAIL_BYTES] + b"}", chain=found[1].decode())

    @property
    def number(self) -> int | None:
        """The line's number when it was written."""
        found = _SEQ.match(self.text)
        return None if found is None else int(found[1])

    def to_bytes(self) -> bytes:
        """The line, newline included."""
        return self.text[:-1] + f', "chain": "{self.chain}"}}\n'.encode()


def chain_after(previous: str, text: bytes) -> str:
    """Chain of a line of this text after one with the chain ``previous``."""
    return hashlib.sha256(previous.encode() + text).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalHead:
    """Number of lines of a journal and the chain of the last one."""

    lines: int
    chain: str

    def to_bytes(self) -> bytes:
        """The file's text."""
        document = {"schema": _SCHEMA, "lines": self.lines, "chain": self.chain}
        return json.dumps(document).encode() + b"\n"

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read the file's text.

        Raises
        ------
        ValueError
            If it is not that of a head.
        """
        document = parse_json(data)
        if not isinstance(document, dict) or document.get("schema") != _SCHEMA:
            raise ValueError(f"its schema is not {_SCHEMA}")
        head = cls(lines=document.get("lines", 0), chain=document.get("chain", ""))
        if head.to_bytes() != data:
            raise ValueError("it was altered")
        return head

    @classmethod
    def of_journal(cls, journal: Path) -> Self | None:
        """Read the head beside a journal; None if there is none.

        Raises
        ------
        ValueError
            If it is damaged or cannot be read.
        """
        try:
            data = read_regular_file(journal.with_name(HEAD_NAME))
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ValueError(error.strerror or str(error)) from error
        return cls.from_bytes(data)
