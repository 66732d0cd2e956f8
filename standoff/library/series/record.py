"""The commit of one follow-up: what it gave, or why it gave nothing."""

import json
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_json
from analysis.sweep import commit_file


class FollowupRecord(BaseModel):
    """What is remembered of a follow-up.

    Parameters
    ----------
    settings
        Hash of what was done with it.
    item
        The photograph as it was on disk.
    row
        Its line in the summary.
    is_refused, is_unread
        Whether it gave nothing, and whether that may be otherwise another time.
    notes
        What is worth saying once of photographs of its kind.
    files
        Sizes of the files that were written, by their paths below the folder of results.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: Literal["standoff.followup/1"] = "standoff.followup/1"
    settings: str
    item: str
    row: dict[str, Any]
    is_refused: bool = False
    is_unread: bool = False
    notes: dict[str, str] = {}
    files: dict[str, int] = {}

    def write(self, path: Path) -> None:
        """Commit.

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
