"""The documents that every page is sent, made once for all of them."""

import json
import time
from collections.abc import Callable
from typing import Any

from standoff.console.bench_hub import BenchHub
from standoff.console.web.figure_ages import figure_ages
from standoff.console.web.measure_model import measure_document, sweep_document
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
        self._state_s, self._state = float("-inf"), dict[str, str]()
        self._texts: dict[str, tuple[float, str]] = {}
        self._documents: dict[str, tuple[tuple[object, ...], str]] = {}

    def state(self) -> dict[str, str]:
        """The state that is common to all pages, part by part."""
        now_s = time.monotonic()
        if now_s - self._state_s > STATE_S:
            self._state_s = now_s
            self._state = {
                name: json.dumps(part, allow_nan=False)
                for name, part in state_document(self._hub).items()
            }
        return self._state

    def levels(self) -> str | None:
        """Histogram and focus trace; None without a picture, or with none but an old one."""
        facts = self._hub.picture.facts
        if facts.levels is None or figure_ages(self._hub)["levels"].validity == "none":
            return None
        return self._cached("levels", LEVELS_S, lambda: levels_document(facts))

    def measure(self) -> str:
        """Live measurements."""
        sharpness, square = self._hub.sharpness, self._hub.squareness.view
        view, has_field = sharpness.view, sharpness.is_field_wanted
        return self._made_of(
            "measure",
            (view, square),
            lambda: measure_document(view, square, has_field=has_field),
        )

    def sweep(self) -> str:
        """The focus sweep."""
        view = self._hub.sweep.view
        return self._made_of("sweep", (view,), lambda: sweep_document(view))

    def plan(self) -> str:
        """The plan's table."""
        view = self._hub.run.view
        return self._made_of("plan", (view,), lambda: plan_document(view))

    def _made_of(
        self, name: str, views: tuple[object, ...], make: Callable[[], dict[str, Any]]
    ) -> str:
        """The document of some views, made anew when one of them is another."""
        seen, text = self._documents.get(name, ((), ""))
        if len(seen) != len(views) or any(a is not b for a, b in zip(seen, views, strict=True)):
            text = json.dumps(make(), allow_nan=False)
            self._documents[name] = (views, text)
        return text

    def _cached(self, name: str, age_s: float, make: Callable[[], dict[str, Any] | None]) -> str:
        made_s, text = self._texts.get(name, (float("-inf"), ""))
        now_s = time.monotonic()
        if now_s - made_s > age_s:
            text = json.dumps(make(), allow_nan=False)
            self._texts[name] = (now_s, text)
        return text
