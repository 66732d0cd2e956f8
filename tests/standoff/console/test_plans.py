"""Plans as they are typed on a page: read, checked, shown in the editor and written as files."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from standoff.errors import ApplicationError
from standoff.shipped_configs import shipped_config

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")


from acquisition.plan import load_plan, plan_entries
from standoff.console.plans import (
    MOST_CAPTURES,
    DraftError,
    PlanDraft,
    PlanLibrary,
    TargetDraft,
    captures_in,
    draft_of,
    plan_of,
    plan_toml,
)
from standoff.console.web._command_handler import CommandHandler, parse_message
from standoff.console.web._messages import PageMessage
from standoff.console.web._session_commands import NotInControlError
from tests.standoff.console.hub_fixtures import idle_hub
from tests.standoff.console.served import page_client

PROGRAMMERS_WORDS = re.compile(r"Value error|Input|should|\b[a-z]+_[a-z]+|[a-z]\.[a-z0-9]")
PLANS = ("demo_plan.toml", "noise_plan.toml", "bracket_plan.toml", "paper_validation.toml")


def draft(*targets: dict[str, Any], **fields: Any) -> PlanDraft:
    made = tuple(TargetDraft(**{"kind": "edge", "target": "edge"} | each) for each in targets)
    return PlanDraft(**{"name": "typed", "heights": "300"} | fields, targets=made)


def test_numbers_are_a_list_or_a_series() -> None:
    plan = plan_of(
        draft(
            {"orientations": "5, 95"},
            {"kind": "flat", "heights": "1;2 3"},
            heights="180 to 400 step 20",
        )
    )
    assert plan.heights_mm is not None
    assert plan.heights_mm[:2] == (180.0, 200.0)
    assert len(plan.heights_mm) == 12
    assert plan.targets[0].orientations_deg == (5.0, 95.0)
    assert plan.targets[1].heights_mm == (1.0, 2.0, 3.0)
    assert captures_in(plan) == len(plan_entries(plan)) == 27


@pytest.mark.parametrize(
    ("made", "key", "text"),
    [
        (draft({}, heights="250 x"), "heights_mm", "heights: 'x' is not a number"),
        (draft({}, heights=""), "targets.0.heights_mm", "target 1, heights: set neither"),
        (draft({}, heights="180 to 400 step 0"), "heights_mm", "step must be positive"),
        (draft({"target": " "}), "targets.0.target", "printable"),
        (draft({}, {}), "targets.1", "target 2: edge 'edge' at 0 degrees is planned twice"),
        (draft({"bracket_exposures": 13}), "targets.0.bracket.exposures",
         "target 1, exposures of the bracket must be at most 12"),
        (draft({"exposures": "-4"}), "targets.0.exposure_us.0",
         "target 1, exposures must be more than 0 µs"),
        (draft({"exposures": "1 to 9 step 2"}), "targets.0.exposure_us", "list the exposures"),
        (draft(), "targets", "targets must not be empty"),
        (draft({}, frames=1), "frames_per_capture", "frames of a capture must be at least 2"),
        (draft({}, repeats=0), "repeats", "repeats must be at least 1"),
        (draft({}, settle_s=-1.0), "settle_s", "wait after a move must be at least 0 s"),
        (draft({}, name=""), "name", "name: must be printable text"),
        (draft({"bracket_exposures": 2, "bracket_ratio": 99.0}), "targets.0.bracket.ratio",
         "target 1, ratio of the bracket must be at most 32"),
        (draft({"orientations": "400"}), "targets.0.orientations_deg.0", "less than 360°"),
        (draft({}, heights="5 5"), "heights_mm", "heights: 5 is given twice"),
        (draft({}, heights="1 to 9000 step 1", repeats=12), "repeats", "108000 captures"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line_with_its_field(
    made: PlanDraft, key: str, text: str
) -> None:
    with pytest.raises(DraftError) as error:
        plan_of(made)
    assert text in str(error.value)
    assert "\n" not in str(error.value)
    assert key in error.value.keys
    assert not PROGRAMMERS_WORDS.search(str(error.value))
    assert MOST_CAPTURES < 108000


@pytest.mark.parametrize("name", PLANS)
def test_shipped_plans_go_through_the_editor_unchanged(name: str, tmp_path: Path) -> None:
    plan = load_plan(shipped_config(name))
    again = plan_of(draft_of(plan))
    assert plan_entries(again) == plan_entries(plan)
    path = tmp_path / name
    path.write_text(plan_toml(plan))
    assert load_plan(path) == plan


@pytest.mark.parametrize(
    "heights", ["300", "250 300 350", "180 to 400 step 20", "0.1 to 0.7 step 0.1", "1 2 3 5"]
)
def test_heights_are_shown_as_one_would_type_them(heights: str) -> None:
    assert draft_of(plan_of(draft({}, heights=heights))).heights == heights


def test_a_file_keeps_names_with_quotes_and_other_alphabets(tmp_path: Path) -> None:
    plan = plan_of(draft({"target": 'Münze "7" \\ π'}, name="本"))
    path = tmp_path / "plan.toml"
    path.write_text(plan_toml(plan), encoding="utf-8")
    assert load_plan(path) == plan


def test_plans_are_saved_in_the_first_folder_and_nothing_else_is_replaced(tmp_path: Path) -> None:
    own, bench = tmp_path / "own", tmp_path / "bench"
    bench.mkdir()
    library, plan = PlanLibrary((own, bench)), plan_of(draft({}))
    assert not library.has("first")
    assert library.save("first", plan) == own / "first.toml"
    assert library.has("first")
    assert library.load("first") == plan
    assert library.folder_of(plan) == own
    (own / "bench.toml").write_text("[camera]\n")
    (own / "link.toml").symlink_to(bench / "elsewhere.toml")
    for name in ("bench", "link", "../up", ".hidden", "a/b", ""):
        with pytest.raises(ApplicationError):
            library.save(name, plan)
    assert library.has("bench")
    assert library.has("link")
    assert (own / "bench.toml").read_text() == "[camera]\n"
    assert not (bench / "elsewhere.toml").exists()
    with pytest.raises(ApplicationError):
        PlanLibrary(()).save("first", plan)


DRAFT: dict[str, Any] = {
    "name": "typed",
    "heights": "250 to 300 step 25",
    "targets": [{"kind": "edge", "target": "edge", "orientations": "5 95"}],
}


def check(draft: dict[str, Any]) -> PageMessage:
    return parse_message(json.dumps({"do": "plan-check", "draft": draft}))


def save(draft: dict[str, Any] = DRAFT, **fields: object) -> PageMessage:
    return parse_message(json.dumps({"do": "plan-save", "draft": draft} | fields))


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
    with pytest.raises(DraftError):
        handler.carry_out("Ada", save(DRAFT | {"targets": []}, name="none"))
    assert not (tmp_path / "none.toml").exists()


def test_the_editor_begins_with_an_empty_plan_or_one_that_is_there(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    with page_client(hub) as client:
        assert "New plan" in client.get("/plans/edit").text
        page = client.get("/plans/edit?plan=two").text
        assert "two heights" in page
        assert "300 301" in page
        assert client.get("/plans/edit?plan=nothing").status_code == 404
        assert client.get("/plans/edit?plan=../two").status_code == 404
