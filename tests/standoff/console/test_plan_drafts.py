"""Plans as they are typed on a page: read, checked, and written as files."""

import re
from pathlib import Path
from typing import Any

import pytest

from acquisition.plan import load_plan, plan_entries
from standoff.console.plan_drafts import (
    MOST_CAPTURES,
    DraftError,
    PlanDraft,
    TargetDraft,
    captures_in,
    draft_of,
    plan_of,
    plan_toml,
)
from standoff.console.plan_library import PlanLibrary
from standoff.errors import ApplicationError
from standoff.shipped_configs import shipped_config

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
        (draft({"exposures": "1 to 9 step 2"}), "targets.0.exposure_us", "a list"),
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
