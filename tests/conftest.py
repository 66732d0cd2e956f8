"""Hypothesis for every folder: no deadlines, and on a build machine the same examples each time.

At the desk the search goes on with new examples; what it finds gets an ``@example``.
"""

import os

import pytest
from hypothesis import settings

from standoff.terminal.compiled_cache import drop_stale_code

settings.register_profile("desk", deadline=None)
settings.register_profile("build", deadline=None, derandomize=True)
settings.load_profile("build" if os.environ.get("CI") else "desk")


def pytest_configure(config: pytest.Config) -> None:
    """Let no test run on compiled code that is older than its sources."""
    if not hasattr(config, "workerinput"):
        drop_stale_code()
