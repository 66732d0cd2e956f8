"""The documents that every page is sent, made once for all of them."""

import json
import time
from collections.abc import Callable
from typing import Any

from standoff.console.bench_hub import BenchHub
from standoff.console.jobs import RunView
from standoff.console.web.view_model import levels_document, plan_document, state_document

STATE_S = 0.08
LEVELS_S = 0.15


class StateCache:
    """JSON texts, each no older than the interval at which pages are sent it.

    Parameters
    ----------
    hub
        The bench.
    """

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub
        self._texts: dict[str, tuple[float, str]] = {}
        self._planned: tuple[RunView | None, str] = (None, "")

    def state(self) -> str:
        """The state that is common to all pages."""
        return self._cached("state", STATE_S, lambda: state_document(self._hub))

    def levels(self) -> str | None:
        """Histogram and focus trace; None before the first picture."""
        facts = self._hub.picture.facts
        if facts.levels is None:
            return None
        return self._cached("levels", LEVELS_S, lambda: levels_document(facts))

    def plan(self) -> str:
        """The plan's table."""
        view = self._hub.run.view
        if view is not self._planned[0]:
            self._planned = (view, json.dumps(plan_document(view), allow_nan=False))
        return self._planned[1]

    def _cached(self, name: str, age_s: float, make: Callable[[], dict[str, Any] | None]) -> str:
        made_s, text = self._texts.get(name, (float("-inf"), ""))
        now_s = time.monotonic()
        if now_s - made_s > age_s:
            text = json.dumps(make(), allow_nan=False)
            self._texts[name] = (now_s, text)
        return text
