"""Hypothesis for every folder: the same examples in every run, and no deadlines.

``make fuzz`` searches on with new examples; what it finds gets an ``@example``.
"""

import pytest
from hypothesis import settings

from standoff.terminal import drop_stale_code

SEARCH_PROFILE = "search"

settings.register_profile("fixed", deadline=None, derandomize=True)
settings.register_profile(SEARCH_PROFILE, deadline=None, derandomize=False)
settings.load_profile("fixed")


def pytest_configure(config: pytest.Config) -> None:
    """Let no test run on compiled code that is older than its sources."""
    if not hasattr(config, "workerinput"):
        drop_stale_code()
