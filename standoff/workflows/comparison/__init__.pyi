from .alignment_hints import (
    AlignmentHints as AlignmentHints,
    HintFiles as HintFiles,
    read_hints as read_hints,
)
from .change_page import page_of_changes as page_of_changes
from .change_search import (
    CHANGE_FILES as CHANGE_FILES,
    ComparedPair as ComparedPair,
    ComparisonRequest as ComparisonRequest,
    compared as compared,
    find_changes_of_files as find_changes_of_files,
    write_changes as write_changes,
)

__all__ = [
    "CHANGE_FILES",
    "AlignmentHints",
    "ComparedPair",
    "ComparisonRequest",
    "HintFiles",
    "compared",
    "find_changes_of_files",
    "page_of_changes",
    "read_hints",
    "write_changes",
]
