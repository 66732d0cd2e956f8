"""Hypothesis for every folder: the same examples in every run, and no deadlines.

``make fuzz`` searches on with new examples; what it finds gets an ``@example``.
"""

import signal
from collections import defaultdict

import pytest
from hypothesis import settings

from analysis.sweep.worker_process import keep_freed_memory
from standoff.terminal import drop_stale_code

SEARCH_PROFILE = "search"

settings.register_profile("fixed", deadline=None, derandomize=True)
settings.register_profile(SEARCH_PROFILE, deadline=None, derandomize=False)
settings.load_profile("fixed")


def pytest_configure(config: pytest.Config) -> None:
    """Let no test run on stale compiled code, or with Ctrl-C ignored as in a background job.

    Freed memory is kept: a tenth of the time of all tests would go into page faults.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    keep_freed_memory()
    if not hasattr(config, "workerinput"):
        drop_stale_code()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put the fast tests of every worker before its slow ones, of which modules of minutes lead.

    With ``--dist worksteal`` each worker begins with a run of neighbours in this order, and who
    has none left takes from the others' ends: what is long must not be left for last.
    """
    slow = [item for item in items if item.get_closest_marker("slow")]
    minutes = defaultdict[pytest.Collector | None, float](float)
    for item in slow:
        minutes[item.parent] += _minutes(item)
    slow.sort(key=lambda item: -minutes[item.parent])
    fast = [item for item in items if not item.get_closest_marker("slow")]
    items.clear()
    for workers_left in range(
        getattr(config, "workerinput", {"workercount": 1})["workercount"], 0, -1
    ):
        share, first = (len(fast) + len(slow)) // workers_left, len(fast) // workers_left
        items += fast[:first] + slow[: share - first]
        del fast[:first], slow[: share - first]


def _minutes(item: pytest.Item) -> float:
    marker = item.get_closest_marker("slow")
    return 0.0 if marker is None else float(marker.kwargs.get("minutes", 0.0))
