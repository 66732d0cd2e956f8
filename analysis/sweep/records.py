"""Commits as JSON documents, and what they say of photographs that gave nothing."""

import json
from pathlib import Path
from typing import Self

from pydantic import BaseModel, ConfigDict, ValidationError

from acquisition.printable import on_one_line
from acquisition.regular_files import read_regular_file
from acquisition.session import commit_file
from acquisition.untrusted import parse_json


class CommittedRecord(BaseModel):
    """What a commit says; subclasses state its values."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def write(self, path: Path) -> None:
        """Commit: the contents reach the disk before the name does.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        # Names of files may hold what UTF-8 does not.
        commit_file(path, json.dumps(self.model_dump()).encode("ascii"))

    @classmethod
    def read(cls, path: Path) -> Self | None:
        """Read a record; None if there is none, or none that can be believed."""
        try:
            return cls.model_validate(parse_json(read_regular_file(path), has_file_names=True))
        except (OSError, ValidationError, ValueError):
            return None


def size_of(path: Path) -> int | None:
    """Return the size of a file in bytes; None if there is none."""
    try:
        return path.stat().st_size
    except (OSError, ValueError):  # a name with a zero byte
        return None


def refusal_line(path: Path, text: str) -> str:
    """Say why a photograph gave nothing, with its name unless the text has it."""
    name = on_one_line(path)
    return text if name in text else f"{name}: {text}"
