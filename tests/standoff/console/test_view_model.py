"""What the pages show, without a page."""

import time
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.errors import SessionError
from acquisition.focus import FocusReading
from acquisition.plan import PlanEntry, PlanEstimate, parse_plan
from acquisition.session import SessionWriter
from analysis.pose import PoseVerdict, Verdict
from standoff.console.control_arbiter import ControlView
from standoff.console.frames import FrameCounts
from standoff.console.reference_picture import ReferencePicture
from standoff.console.session_run import PlanRow, RunView
from tests.standoff.console import hub_fixtures

pytest.importorskip("starlette", reason="the console's extra is not installed")


from acquisition.focus import Region
from standoff.console.devices import DeviceStatus
from standoff.console.monitors import Levels, PictureFacts, PoseView
from standoff.console.stage_service import StageView
from standoff.console.web._live_sockets import StateCache
from standoff.console.web._view_model import (
    Validity,
    camera_document,
    control_document,
    disk_document,
    figure_age,
    figure_ages,
    focus_document,
    levels_document,
    plan_document,
    pose_document,
    preview_document,
    run_document,
    saturation_text,
    stage_document,
)
from tests.acquisition.fakes import SETTINGS, frame
from tests.standoff.console.hub_fixtures import idle_hub, pose_verdict


@pytest.mark.parametrize(
    ("age_s", "period_s", "validity"),
    [
        (0.5, 0.02, "valid"),
        (0.51, 0.02, "stale"),
        (3.0, 0.02, "stale"),
        (3.01, 0.02, "none"),
        (2.9, 1.0, "valid"),  # three frames of a second
        (3.1, 1.0, "stale"),
        (6.1, 1.0, "none"),
    ],
)
def test_a_figure_is_stale_after_three_frames_or_half_a_second_and_then_nothing(
    age_s: float, period_s: float, validity: Validity
) -> None:
    assert figure_age(100.0, 100.0 + age_s, period_s=period_s).validity == validity


def test_what_was_never_measured_is_no_figure() -> None:
    age = figure_age(None, 100.0)
    assert age.validity == "none"
    assert age.document()["age_s"] is None


@given(st.floats(0, 1e6), st.floats(-10, 1e3), st.floats(0, 60))
def test_a_figure_never_becomes_valid_again_by_waiting(
    measured_s: float, passed_s: float, period_s: float
) -> None:
    order = ("valid", "stale", "none")
    now, later = (
        order.index(figure_age(measured_s, measured_s + each, period_s=period_s).validity)
        for each in (passed_s, passed_s + 1)
    )
    assert now <= later


def test_every_figure_has_the_age_of_its_own_frame(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    assert {age.age_s for age in figure_ages(hub).values()} == {None}
    cache = StateCache(hub)
    hub.frames.publish(frame(np.full((48, 64), 700, np.uint16), 1), SETTINGS)
    first = hub.frames.latest
    assert first is not None
    hub.picture.look(first)
    hub.sharpness.look_at(Region(x_px=0, y_px=0, width_px=64, height_px=48))
    hub.sharpness.look(first)
    assert cache.levels(hub) is not None
    hub.frames.publish(frame(np.full((48, 64), 700, np.uint16), 2), SETTINGS)
    ages = figure_ages(hub)
    now_s = time.monotonic()
    for name in ("levels", "edge"):
        assert ages[name].age_s == pytest.approx(now_s - first.arrived_s, abs=0.5)
    camera_s, edge_s = ages["camera"].age_s, ages["edge"].age_s
    assert camera_s is not None
    assert edge_s is not None
    assert camera_s < edge_s  # its frame is the second
    assert ages["pose"].age_s is None


def test_a_height_or_focus_that_is_too_old_is_not_told() -> None:
    ready = DeviceStatus(state="ready")
    view = StageView(status=ready, state="idle", height_mm=250.0, is_homed=True)
    assert stage_document(view, "stale")["height"] == "250.000"
    assert stage_document(view, "none")["height"] == "–"
    assert focus_document(PictureFacts(), "none")["value"] == "–"


PLAN = parse_plan(tomllib.loads(hub_fixtures.PLAN), source="the fixture")
READY = DeviceStatus(state="ready")
BEFORE = ReferencePicture(
    number=1, name="before", image_dn=np.zeros((4, 6), np.uint16), max_level_dn=4095
)


def reading(**changes: object) -> FocusReading:
    facts: dict[str, object] = {
        "value": 0.0191,
        "peak": 0.02,
        "trend": "steady",
        "is_past_peak": False,
        "noise": 1e-4,
    }
    return FocusReading(**(facts | changes))  # type: ignore[arg-type]  # names are FocusReading's


def levels(fraction: float) -> Levels:
    return Levels(
        counts=np.array([5, 0, 7]), max_level_dn=4095, mean_dn=1234.5, saturated_fraction=fraction
    )


def test_focus_is_told_in_percent_and_in_words() -> None:
    shown = focus_document(PictureFacts(focus=reading()))
    assert (shown["percent_text"], shown["value"], shown["peak"]) == ("95.5", "0.0191", "0.02")
    assert shown["hint"] == "steady"


@pytest.mark.parametrize(
    ("trend", "is_past", "hint"),
    [
        ("rising", False, "getting sharper"),
        ("falling", False, "getting softer"),
        ("falling", True, "past the peak: go back"),
        ("steady", True, "past the peak: go back"),
    ],
)
def test_the_hint_says_where_to_turn(trend: str, is_past: bool, hint: str) -> None:
    facts = PictureFacts(focus=reading(trend=trend, is_past_peak=is_past))
    assert focus_document(facts)["hint"] == hint


def test_nothing_to_focus_on_is_no_number() -> None:
    shown = focus_document(PictureFacts(focus=reading(has_detail=False)))
    assert (shown["hint"], shown["percent"]) == ("nothing to focus on", None)
    assert (shown["value"], shown["percent_text"]) == ("–", "–")


def test_no_focus_is_no_number() -> None:
    shown = focus_document(PictureFacts(region=Region(x_px=1, y_px=2, width_px=30, height_px=40)))
    assert shown["percent"] is None
    assert shown["region"] == [1, 2, 30, 40]


@pytest.mark.parametrize(
    ("fraction", "text"), [(0.0, "none"), (1e-6, "< 0.01 %"), (0.0123, "1.23 %"), (1.0, "100.00 %")]
)
def test_saturation_is_told_as_a_share(fraction: float, text: str) -> None:
    assert saturation_text(levels(fraction)) == text


def test_levels_wait_for_the_first_picture() -> None:
    assert levels_document(PictureFacts()) is None
    shown = levels_document(PictureFacts(levels=levels(0.5), trace=(0.123456789,)))
    assert shown is not None
    assert shown["counts"] == [5, 0, 7]
    assert shown["is_saturated"]
    assert shown["trace"] == [0.12346]


def test_a_stage_that_does_not_know_its_height_shows_none() -> None:
    shown = stage_document(StageView(status=READY, state="idle", limits_mm=(120.0, 500.0)))
    assert (shown["height"], shown["homed_text"]) == ("–", "not homed")
    assert shown["limits"] == "120 to 500 mm"


def test_a_stage_on_its_way_says_where_to() -> None:
    view = StageView(status=READY, state="moving", height_mm=200.5, target_mm=300.0, is_homed=True)
    shown = stage_document(view)
    assert (shown["height"], shown["motion_text"]) == ("200.500", "moving")
    assert shown["target"] == "moving to 300.000 mm"


def test_a_stage_in_alarm_says_to_home_it() -> None:
    shown = stage_document(StageView(status=READY, state="alarm"))
    assert shown["motion_text"] == "ALARM"
    assert shown["target"].startswith("locked until it is homed: press Home")


def test_a_lost_stage_is_not_at_rest() -> None:
    lost = DeviceStatus(state="lost", text="the serial port is gone", remedy="Plug it in.")
    shown = stage_document(StageView(status=lost, state="idle"))
    assert shown["motion_text"] == "not connected"
    assert shown["remedy"] == "Plug it in."


def test_a_camera_shows_its_settings_and_its_losses() -> None:
    counts = FrameCounts(complete=100, incomplete=1, lost=2, rate_hz=49.96)
    shown = camera_document(READY, SETTINGS, counts, None)
    assert (shown["format"], shown["rate"], shown["lost"]) == ("6 × 4 Mono12", "50.0", 2)
    assert camera_document(READY, None, FrameCounts(), None)["exposure_us"] is None


def test_control_says_who_has_it() -> None:
    def told(**facts: object) -> str:
        view = {"is_mine": False, "holder": "", "is_away": False, "viewers": 1, **facts}
        return str(control_document(ControlView(**view))["text"])  # type: ignore[arg-type]  # names are ControlView's

    assert told(is_mine=True, holder="Ada") == "You are in control as"
    assert told() == "Nobody is in control"
    assert told(holder="Ada") == "Ada is in control"
    assert told(holder="Ada", is_away=True) == "Ada is in control, but not connected"


def test_the_plan_is_a_table_of_what_is_done_next_and_failed() -> None:
    entries = [
        PlanEntry(index=i, kind="edge", target="Kante", orientation_deg=5.0, height_mm=300.0 + i)
        for i in range(3)
    ]
    view = RunView(
        session="s",
        state="failed",
        rows=(
            PlanRow(entry=entries[0], state="done", height_mm=300.0016, focus_value=0.012345),
            PlanRow(entry=entries[1], state="failed", note="the camera was lost"),
            PlanRow(entry=entries[2]),
        ),
        seconds_left=61.0,
    )
    rows = plan_document(view)["rows"]
    assert [row["state"] for row in rows] == ["done", "failed", "pending"]
    assert [row["height"] for row in rows] == ["300.002", "301", "302"]
    assert rows[0]["focus"] == "0.0123"
    shown = run_document(view, is_pause_wanted=False)
    assert (shown["captured"], shown["planned"], shown["left"]) == (1, 3, "1 min 01 s left")


@pytest.mark.parametrize(
    ("verdict", "margin", "probability", "texts"),
    [
        ("go", 0.31, 0.98, ("GO", "+31 %", "98 %")),
        ("no go", -0.204, 0.012, ("NO GO", "-20 %", "1 %")),
        ("unsure", 0.02, 0.61, ("UNSURE", "+2 %", "61 %")),
        ("no go", None, None, ("NO GO", "", "")),
    ],
)
def test_the_pose_is_go_no_go_or_unsure_with_its_margin_and_probability(
    verdict: Verdict, margin: float | None, probability: float | None, texts: tuple[str, str, str]
) -> None:
    found = pose_verdict(
        accepted=margin is not None and margin >= 0,
        verdict=verdict,
        probability=probability,
        dprime=None if margin is None else 2 * (1 + margin),
        margin=margin,
    )
    shown = pose_document(PoseView(is_possible=True, picture=BEFORE, verdict=found))
    assert (shown["verdict"], shown["margin"], shown["probability"]) == texts
    assert shown["reason"] == "because"
    assert pose_document(PoseView(is_possible=True))["verdict"] == ""


LOST = pose_verdict(accepted=False, verdict="no go", anchored=True)
GOOD = pose_verdict(dprime=3.0, margin=3.0, anchored=True)


@pytest.mark.parametrize(
    ("verdict", "is_searching", "validity", "shown"),
    [
        (None, False, "valid", ("…", "waiting for a picture")),
        (None, True, "valid", ("…", "searching the picture for the reference")),
        (GOOD, False, "valid", ("GO", "because")),
        (GOOD, True, "valid", ("…", "searching the picture for the reference")),
        (GOOD, True, "none", ("…", "searching the picture for the reference")),
        (GOOD, False, "none", ("…", "waiting for a picture")),
        (LOST, True, "valid", ("NO GO", "because")),
        (LOST, True, "none", ("…", "searching the picture for the reference")),
    ],
)
def test_a_go_from_before_the_reference_was_lost_is_not_shown_while_it_is_searched_for(
    verdict: PoseVerdict | None, is_searching: bool, validity: Validity, shown: tuple[str, str]
) -> None:
    view = PoseView(is_possible=True, picture=BEFORE, verdict=verdict, is_searching=is_searching)
    document = pose_document(view, validity)
    assert (document["verdict"], document["reason"]) == shown


@pytest.mark.parametrize(
    ("free_bytes", "is_room"), [(10**6 + 64 * 2**20 - 1, False), (10**6 + 64 * 2**20, True)]
)
def test_a_plan_has_room_by_the_rule_by_which_a_session_is_refused(
    free_bytes: int, is_room: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    estimate = PlanEstimate(captures=1, placements=1, seconds=1.0, bytes_=10**6)
    shown = preview_document("p", PLAN, (), estimate, (), free_bytes=free_bytes)
    assert shown["is_room"] is is_room
    assert shown["disk"] == "1 MB"
    usage = SimpleNamespace(free=free_bytes)
    monkeypatch.setattr("acquisition.session._writer.shutil.disk_usage", lambda _: usage)
    writer = SessionWriter.__new__(SessionWriter)
    writer.path = tmp_path
    if is_room:
        writer.require_space(10**6)
    else:
        with pytest.raises(SessionError, match="need 1 MB, and 67 MB must stay free"):
            writer.require_space(10**6)


@pytest.mark.parametrize(("free", "level"), [(10**8 - 1, "fail"), (10**9, "warn"), (10**10, "ok")])
def test_little_room_is_shown(free: int, level: str) -> None:
    assert disk_document(free)["level"] == level
