"""The plan editor's page and its commands."""

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")

from starlette.testclient import TestClient

from acquisition.plan import load_plan
from standoff.console.plan_drafts import DraftError
from standoff.console.web.application import console_app
from standoff.console.web.command_handler import CommandHandler, NotInControlError
from standoff.console.web.messages import CheckPlan, SavePlan
from tests.standoff.console.hub_fixtures import idle_hub

DRAFT: dict[str, Any] = {
    "name": "typed",
    "heights": "250 to 300 step 25",
    "targets": [{"kind": "edge", "target": "edge", "orientations": "5 95"}],
}


def check(draft: dict[str, Any]) -> CheckPlan:
    return CheckPlan.model_validate_json(_json(draft))


def _json(draft: dict[str, Any], **fields: object) -> str:
    return json.dumps({"do": "plan-check", "draft": draft} | fields)


def save(**fields: object) -> SavePlan:
    return SavePlan.model_validate_json(_json(DRAFT, do="plan-save", **fields))


def test_a_draft_is_checked_for_whoever_looks_and_saved_by_whoever_is_in_control(
    tmp_path: Path,
) -> None:
    hub = idle_hub(tmp_path)
    handler = CommandHandler(hub)
    hub.control.join("Ada", "Ada")
    cost = handler.carry_out("Ben", check(DRAFT))
    assert cost is not None
    assert (cost["type"], cost["is_ok"], cost["captures"], cost["placements"]) == (
        "draft", True, 6, 2,
    )  # fmt: skip
    assert "rows" not in cost
    wrong = handler.carry_out("Ben", check(DRAFT | {"heights": "high"}))
    assert wrong is not None
    assert (wrong["is_ok"], wrong["keys"]) == (False, ["heights_mm"])
    with pytest.raises(NotInControlError):
        handler.carry_out("Ben", save(name="mine"))
    saved = handler.carry_out("Ada", save(name="mine"))
    assert saved is not None
    assert saved["type"] == "plan-saved"
    assert len(load_plan(tmp_path / "mine.toml").heights_mm or ()) == 3
    assert "mine" in hub.plans.names()
    before = (tmp_path / "two.toml").read_text()
    asked = handler.carry_out("Ada", save(name="two"))
    assert asked == {"type": "plan-exists", "name": "two"}
    assert (tmp_path / "two.toml").read_text() == before
    handler.carry_out("Ada", save(name="two", is_replacing=True))
    assert load_plan(tmp_path / "two.toml").name == "typed"
    bad = SavePlan.model_validate_json(_json(DRAFT | {"targets": []}, do="plan-save", name="none"))
    with pytest.raises(DraftError):
        handler.carry_out("Ada", bad)
    assert not (tmp_path / "none.toml").exists()


def test_the_editor_begins_with_an_empty_plan_or_one_that_is_there(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    with TestClient(
        console_app(hub), client=("127.0.0.1", 1), base_url="http://127.0.0.1"
    ) as client:
        assert "New plan" in client.get("/plans/edit").text
        page = client.get("/plans/edit?plan=two").text
        assert "two heights" in page
        assert "300 301" in page
        assert client.get("/plans/edit?plan=nothing").status_code == 404
        assert client.get("/plans/edit?plan=../two").status_code == 404
