"""The commit of one follow-up: what it gave, or why it gave nothing."""

from typing import Any, Literal

from pydantic import Field

from analysis.sweep import CommittedRecord


class FollowupRecord(CommittedRecord):
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

    format: Literal["standoff.followup/1"] = "standoff.followup/1"
    settings: str
    item: str
    row: dict[str, Any]
    is_refused: bool = False
    is_unread: bool = False
    notes: dict[str, str] = Field(default_factory=dict)
    files: dict[str, int] = Field(default_factory=dict)
