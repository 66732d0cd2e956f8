"""What an ordinary user may not: root may all, so that a test must give that up for a while."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

NOBODY = 65534


@contextmanager
def ordinary_user() -> Iterator[None]:
    """Let the block run as a user whom permissions bind; skip the test where that cannot be.

    What the block imports must be loaded: a user may not be permitted to read root's Python.
    """
    if os.geteuid() != 0:
        yield
        return
    groups = os.getgroups()
    try:
        os.setgroups([])
        os.setresgid(NOBODY, NOBODY, 0)
        os.setresuid(NOBODY, NOBODY, 0)
    except (AttributeError, OSError) as error:
        pytest.skip(f"root cannot become an ordinary user here: {error}")
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)
        os.setresgid(0, 0, 0)
        os.setgroups(groups)
