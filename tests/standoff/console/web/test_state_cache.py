"""Documents that are made once for all pages."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from acquisition.plan import load_plan
from standoff.console.bench_hub import BenchHub
from standoff.console.jobs.session_run import RunView, rows_of
from standoff.console.web import state_cache
from standoff.console.web.state_cache import STATE_S, StateCache
from standoff.console.web.view_model import plan_document
from tests.standoff.console.hub_fixtures import idle_hub


@pytest.fixture
def hub(tmp_path: Path) -> BenchHub:
    return idle_hub(tmp_path)


def test_the_plans_table_is_made_when_the_run_has_changed_and_not_before(
    hub: BenchHub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[RunView] = []

    def counted(view: RunView) -> dict[str, object]:
        made.append(view)
        return plan_document(view)

    monkeypatch.setattr(state_cache, "plan_document", counted)
    cache = StateCache(hub)
    assert json.loads(cache.plan())["rows"] == []
    rows = rows_of(tmp_path / "new", load_plan(tmp_path / "two.toml"))
    for revision, shown in enumerate((rows, (replace(rows[0], state="done"), rows[1])), 1):
        view = RunView(session="new", plan="two", rows=shown, revision=revision)
        monkeypatch.setattr(hub.run, "_view", view)
        assert [json.loads(cache.plan()) for _ in range(3)] == [plan_document(view)] * 3
    assert [view.revision for view in made] == [0, 1, 2]


def test_the_state_is_made_once_for_all_pages_that_ask_within_its_interval(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 50.0
    monkeypatch.setattr("time.monotonic", lambda: now_s)
    cache = StateCache(hub)
    first = cache.state()
    hub.tell("the lamp was changed")
    now_s += STATE_S
    assert cache.state() is first
    now_s += 0.001
    assert "the lamp was changed" in cache.state()["notices"]
