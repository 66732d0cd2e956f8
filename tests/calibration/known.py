"""A result that may be None, where a test needs it."""

from typing import TypeVar

Result = TypeVar("Result")


def known(result: Result | None) -> Result:
    assert result is not None
    return result
