"""Photographs as a sweep reads them, in any process: one that cannot be used is refused."""

from collections.abc import Iterator
from contextlib import contextmanager

from analysis.errors import RefusedPhotographError
from standoff.errors import HintError, ImageFileError


@contextmanager
def refusing() -> Iterator[None]:
    """Refuse the photograph of the block if it cannot be used, so that the sweep goes on."""
    try:
        yield
    except (HintError, ImageFileError) as error:
        is_unread = isinstance(error.__cause__, OSError)
        raise RefusedPhotographError(str(error), is_unread=is_unread) from error
