"""Hypothesis for every folder: the same examples in every run, and no deadlines.

``make fuzz`` searches on with new examples; what it finds gets an ``@example``.
"""

import signal

import pytest
from hypothesis import settings

from standoff.terminal import drop_stale_code

SEARCH_PROFILE = "search"

settings.register_profile("fixed", deadline=None, derandomize=True)
settings.register_profile(SEARCH_PROFILE, deadline=None, derandomize=False)
settings.load_profile("fixed")


def pytest_configure(config: pytest.Config) -> None:
    """Let no test run on stale compiled code, or with Ctrl-C ignored as in a background job."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if not hasattr(config, "workerinput"):
        drop_stale_code()
