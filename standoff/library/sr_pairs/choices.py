"""Layouts that callers choose from; imports no library."""

from typing import Literal

PairFormat = Literal["folder", "webdataset"]
"""Two image files for each pair in folders, or tar files of the pairs of many photographs."""
