"""Hypothesis for every folder: the same examples in every run, and no deadlines.

``make fuzz`` searches on with new examples; what it finds gets an ``@example``.
"""

import gc
import os
import signal
import sys
from collections import defaultdict

import pytest
from hypothesis import settings

from analysis.design_cache import LIMIT_VARIABLE
from analysis.sweep.worker_process import keep_freed_memory
from standoff.compiled_cache import drop_stale_code

SEARCH_PROFILE = "search"

settings.register_profile("fixed", deadline=None, derandomize=True)
settings.register_profile(SEARCH_PROFILE, deadline=None, derandomize=False)
settings.load_profile("fixed")


def pytest_configure(config: pytest.Config) -> None:
    """Let no test run on stale compiled code, or with Ctrl-C ignored as in a background job.

    Freed memory is kept: a tenth of the time of all tests would go into page faults. Cycles are
    looked for as often as the command line does, not at every 700th object. No kernels are kept in
    the user's cache folder, nor taken from there. Byte code is kept whatever the shell says: every
    worker rewrites the asserts of all modules otherwise, and the tests start hundreds of processes.
    """
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    os.environ[LIMIT_VARIABLE] = "0"
    gc.set_threshold(10_000)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    keep_freed_memory()
    if not hasattr(config, "workerinput"):
        drop_stale_code()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put the fast tests of every worker before its slow ones, of which modules of minutes lead.

    With ``--dist worksteal`` each worker begins with a run of neighbours in this order, and who
    has none left takes from the others' ends: what is long must not be left for last. The last
    worker begins with the tests that wait most of their time, while others keep the processor busy.
    """
    minutes = defaultdict[pytest.Collector | None, float](float)
    for item in items:
        minutes[item.parent] += _minutes(item)
    workers = getattr(config, "workerinput", {"workercount": 1})["workercount"]
    waiting = [item for item in items if workers > 1 and item.get_closest_marker("waits")]
    others = [item for item in items if item not in waiting]
    slow = [item for item in others if item.get_closest_marker("slow")]
    fast = [item for item in others if not item.get_closest_marker("slow")]
    for some in (waiting, slow):
        some.sort(key=lambda item: -minutes[item.parent])
    items.clear()
    for workers_left in range(workers, 1, -1):
        share = (len(waiting) + len(fast) + len(slow)) // workers_left
        first = share * len(fast) // max(len(fast) + len(slow), 1)
        items += fast[:first] + slow[: share - first]
        del fast[:first], slow[: share - first]
    items += waiting + fast + slow


@pytest.fixture
def widths_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out a calibration's transfer over both axes, which takes nine tenths of its time."""
    from calibration.psf import _calibration  # for the few tests that ask for it

    monkeypatch.setattr(_calibration, "measure_transfer_2d", lambda *_, **__: None)


def pytest_collection_finish() -> None:
    """Look for cycles among what tests make, not among the million objects that stay."""
    gc.freeze()


def _minutes(item: pytest.Item) -> float:
    marker = item.get_closest_marker("slow")
    return 0.0 if marker is None else float(marker.kwargs.get("minutes", 0.0))
