"""An operator's work at the console, in a real browser over the real protocols."""

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import Browser, Page

from acquisition.plan import load_plan
from acquisition.session import Session, verify
from tests.standoff.console.console_rig import (
    FEW_PICTURES,
    ConsoleRig,
    console_rig,
    move_to,
    number,
    take_control,
    text,
    wait_at,
    wait_until,
)

pytestmark = [pytest.mark.slow(minutes=0.4), pytest.mark.waits]

PLAN = """
schema = "standoff.plan/1"
name = "{name}"
heights_mm = {heights}
frames_per_capture = 4

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0]
"""


@pytest.fixture(scope="module")
def rig(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleRig]:
    folder: Path = tmp_path_factory.mktemp("console")
    (folder / "two.toml").write_text(PLAN.format(name="two", heights=[300.0, 303.0]))
    (folder / "five.toml").write_text(
        PLAN.format(name="five", heights=[300.0, 301.0, 302.0, 303.0, 304.0])
    )
    with console_rig(folder, *FEW_PICTURES, browser=browser) as made:
        yield made
        assert made.faults == []
        assert {urlsplit(url).hostname for url in made.requests} == {"127.0.0.1"}


def test_a_fresh_grbl_in_alarm_says_to_home_it_beside_the_button(rig: ConsoleRig) -> None:
    with rig.page() as page:  # the first one of this bench: nobody has homed it yet
        take_control(page)
        wait_until(lambda: text(page, "#stage-motion") == "ALARM", "it is locked")
        assert text(page, "#stage-target").startswith("locked until it is homed: press Home")
        assert text(page, "#stage-homed") == "not homed"
        page.wait_for_selector("#stage #home.primary:enabled")  # the one that stands out
        assert page.locator("#stage .primary").count() == 1
        assert not page.is_enabled("[data-step='10']")
        page.click("#home")
        wait_until(lambda: text(page, "#stage-homed") == "homed", "homed")
        wait_until(lambda: text(page, "#stage-motion") == "at rest", "no alarm")
        wait_until(lambda: text(page, "#stage-target") == "", "nothing is left to do")
        assert page.locator("#stage .primary").count() == 0
        assert not page.is_visible("#unlock")


def draw_region(page: Page) -> None:
    """Drag the mouse over the middle of the picture."""
    box = page.locator("#picture").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.3 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.7 * box["height"])
    page.mouse.up()


def test_an_operator_finds_the_focus_with_a_region_drawn_by_the_mouse(rig: ConsoleRig) -> None:
    with rig.operator() as page:
        move_to(page, 260)
        wait_at(page, 260)
        draw_region(page)
        wait_until(lambda: page.is_visible("#region"), "the region is shown")
        page.click("#forget-peak")
        wait_until(lambda: number(page, "#focus-percent") > 95, "focus is measured")
        heights = list(range(270, 350, 10))
        for height in heights:
            page.click("[data-step='10']")
            wait_at(page, height)
            page.wait_for_timeout(400)  # the readings smooth over three pictures
            if "past the peak" in text(page, "#focus-hint"):
                break
        assert "past the peak" in text(page, "#focus-hint")
        assert number(page, "#focus-percent") < 97
        # The lens is focused at 300 mm from the pupil, which is 12.5 mm above the height zero.
        assert 290 <= height <= 330
        for back in range(height - 10, 250, -10):
            page.click("[data-step='-10']")
            wait_at(page, back)
            page.wait_for_timeout(400)
            if number(page, "#focus-percent") > 97:
                break
        assert number(page, "#focus-percent") > 97
        page.click("#clear-region")
        wait_until(lambda: not page.is_visible("#region"), "the region is gone")


def test_a_session_of_two_heights_is_captured_and_shown(rig: ConsoleRig) -> None:
    with rig.operator() as page:
        page.select_option("#plan", "two")
        wait_until(lambda: text(page, "#preview").startswith("2 captures"), "preview")
        page.fill("#session-name", "two heights")
        page.click("#run")
        wait_until(lambda: "Place edge 'edge' at 5" in text(page, "#prompt-text"), "asked to place")
        rig.tell_mock("place edge 5")
        page.click("#prompt-choices button >> nth=0")
        wait_until(lambda: text(page, "#run-state") == "finished", "session finished")
        assert text(page, "#run-count") == "2 of 2"
        wait_until(lambda: page.locator("#plan-table tr.done").count() == 2, "both are done")
        page.click("nav a[href='/sessions']")
        page.click("text=two heights")
        assert "2 of 2 captured" in text(page, "main")
        page.wait_for_selector("#write-report:enabled")
        page.click("#write-report")
        page.wait_for_selector("text=Open report")
        page.goto(f"{rig.url}sessions/two%20heights/report")
        assert "two heights" in page.content()
    session = Session(rig.sessions / "two heights")
    assert session.is_complete
    assert session.manifest.operator == "Ada"
    assert verify(session.path).is_ok


BEYOND_170_MM = """async () => {
    const height = document.querySelector("#stage-height");
    while (!(parseFloat(height.textContent) > 170)) {
        await new Promise(resolve => setTimeout(resolve, 20));
    }
}"""


def test_stop_ends_a_move_from_the_keyboard_and_from_a_page_that_only_watches(
    rig: ConsoleRig,
) -> None:
    with rig.operator() as page, rig.page() as watcher:
        for stopping in (page, watcher):
            move_to(page, 150)
            wait_at(page, 150)
            move_to(page, 480)
            # Within the page: on a busy machine a question from here takes seconds of the move.
            stopping.evaluate(BEYOND_170_MM)
            if stopping is page:
                page.focus("#move-to")
                page.keyboard.press("Escape")
            else:
                watcher.click("#stop")
            wait_until(
                lambda: text(page, "#stage-motion") == "at rest" and page.is_enabled("#home"),
                "the stage stands",
            )
            stopped_mm = number(page, "#stage-height")
            assert 170 < stopped_mm < 400
            assert text(page, "#stage-homed") == "homed"
            page.wait_for_timeout(500)
            assert number(page, "#stage-height") == stopped_mm
        assert not watcher.is_enabled("#home")


def test_an_unplugged_camera_is_shown_and_comes_back_by_itself(rig: ConsoleRig) -> None:
    with rig.operator() as page:
        drawn = "standoff.picture.drawn"
        wait_until(lambda: page.evaluate(drawn) > 3, "pictures")
        rig.tell_mock("fault is_dead=true")
        wait_until(lambda: page.is_visible("#alert-camera"), "the camera is shown as lost")
        assert "cable" in text(page, "#alert-camera .remedy")
        wait_until(lambda: page.is_visible("#no-picture"), "the picture is shown as old")
        rig.tell_mock("fault none")
        wait_until(lambda: not page.is_visible("#alert-camera"), "the camera is back")
        before = page.evaluate(drawn)
        wait_until(lambda: page.evaluate(drawn) > before + 5, "pictures again")


def test_a_session_outlives_its_tab_and_resumes_after_a_stop(rig: ConsoleRig) -> None:
    with rig.operator() as page:
        page.select_option("#plan", "five")
        page.fill("#session-name", "five")
        page.click("#run")
        wait_until(lambda: page.is_visible("#prompt"), "asked to place")
        page.click("#prompt-choices button >> nth=0")
        page.click("#pause")
        wait_until(lambda: text(page, "#run-state") == "paused", "paused")
    with rig.operator() as page:
        assert text(page, "#run-state") == "paused"
        captured = int(text(page, "#run-count").split()[0])
        assert captured < 5
        wait_until(lambda: page.locator("#plan-table tr.next").count() == 1, "one is next")
        page.click("#stop")
        wait_until(lambda: text(page, "#run-state") == "stopped", "stopped")
    with rig.operator() as page:
        page.click("#resume-last")
        wait_until(lambda: page.is_visible("#prompt"), "asked to place again")
        page.click("#prompt-choices button >> nth=0")
        wait_until(lambda: text(page, "#run-state") == "finished", "finished")
        page.click("#plan-table tr.done >> nth=1 >> text=Retake")
        wait_until(lambda: page.is_visible("#prompt"), "asked to place for the retake")
        page.click("#prompt-choices button >> nth=0")
        wait_until(lambda: text(page, "#run-state") == "finished", "finished again")
    session = Session(rig.sessions / "five")
    assert session.is_complete
    assert [event.kind for event in session.events].count("stop") == 1
    assert len(session.captures) == 6
    assert verify(session.path).is_ok


def test_control_is_asked_for_and_handed_over(rig: ConsoleRig) -> None:
    with rig.operator() as first, rig.page() as second:
        wait_until(lambda: "is in control" in text(second, "#control-text"), "second watches")
        assert not second.is_enabled("#home")
        second.click("#take-control")
        wait_until(lambda: first.is_visible("#asked"), "the first page is asked")
        assert text(first, "#asked").startswith("Ada asks for control.")
        first.click("#refuse")
        wait_until(lambda: second.is_visible("#take-control"), "the second is told")
        assert not second.is_enabled("#home")
        second.click("#take-control")
        first.click("#grant")
        wait_until(lambda: "Ada is in control" in text(first, "#control-text"), "first watches")
        assert not first.is_enabled("#home")
        wait_until(lambda: second.is_enabled("#home"), "second is in control")


def test_a_dead_pages_control_is_free(rig: ConsoleRig) -> None:
    with rig.page() as second:
        with rig.operator():
            wait_until(lambda: "is in control" in text(second, "#control-text"), "second watches")
        wait_until(lambda: text(second, "#take-control") == "Take control", "control is free")
        take_control(second)


def test_the_edge_under_the_region_is_measured_and_a_sweep_finds_the_focus(
    rig: ConsoleRig,
) -> None:
    rig.tell_mock("place edge 5")
    with rig.operator() as page:
        move_to(page, 280)
        wait_at(page, 280)
        draw_region(page)
        wait_until(lambda: page.is_visible("#edge"), "an edge is measured")
        away_px = float(text(page, "#edge-sigma").split(" ± ")[0])
        assert "°" in text(page, "#edge-note")
        page.check("#watch-field")
        wait_until(lambda: page.locator(".corner:visible").count() == 4, "four corners")
        page.click("#sweep-box summary")
        for field, value in (("low", 240), ("high", 335), ("steps", 12)):
            page.fill(f"#sweep-{field}", str(value))
        page.check("#sweep-corners")
        page.click("#sweep-form button")
        wait_until(lambda: text(page, "#sweep-message").startswith("sweeping"), "it sweeps")
        wait_until(
            lambda: not (page.is_enabled("#exposure") and page.is_enabled("#home")),
            "camera and stage are not to be touched",
        )
        wait_until(lambda: text(page, "#sweep-message").startswith("sharpest at"), "a peak")
        peak_mm, half_mm = (float(word) for word in text(page, "#sweep-message").split()[2:5:2])
        # The lens is focused at 300 mm from the pupil, which is 12.5 mm above the height zero.
        assert peak_mm == pytest.approx(287.5, abs=2 * half_mm + 0.5)
        wait_at(page, peak_mm)
        assert "four corners" in text(page, "#sweep-advice")  # the edge does not reach all
        wait_until(
            lambda: float(text(page, "#edge-sigma").split(" ± ")[0]) < away_px, "it is sharper"
        )
        page.uncheck("#watch-field")
        page.click("#clear-region")
        wait_until(lambda: not page.is_visible("#edge"), "nothing is measured")


@pytest.fixture(scope="module")
def captured(rig: ConsoleRig) -> ConsoleRig:
    """The console, after a plan was typed and run."""
    with rig.operator() as page:
        page.goto(f"{rig.url}plans/edit")
        heights = page.locator("#plan-form [name=heights]").first
        heights.fill("300 high")
        page.wait_for_selector("#draft-fault:visible")
        assert "'high' is not a number" in text(page, "#draft-fault")
        assert heights.get_attribute("aria-invalid") == "true"
        heights.fill("300 to 303 step 3")
        page.fill("#targets [name=orientations]", "5")
        wait_until(lambda: text(page, "#draft-cost").startswith("2 captures"), "cost")
        page.fill("#plan-form [name=file]", "typed")
        take_control(page)
        page.click("#save-plan")
        page.wait_for_selector("#plan-saved:visible")
        assert load_plan(rig.sessions.parent / "typed.toml").heights_mm == (300.0, 303.0)

        page.goto(rig.url)
        take_control(page)
        page.select_option("#plan", "typed")
        page.fill("#session-name", "typed once")
        wait_until(lambda: page.is_enabled("#run"), "free to run")
        page.click("#run")
        wait_until(lambda: "Place edge" in text(page, "#prompt-text"), "asked to place")
        rig.tell_mock("place edge 5")
        page.click("#prompt-choices button >> nth=0")
        wait_until(lambda: text(page, "#run-state") == "finished", "session finished")
    return rig


def test_a_typed_and_captured_plan_is_looked_at_and_calibrated(captured: ConsoleRig) -> None:
    rig = captured
    with rig.operator() as page:
        page.goto(f"{rig.url}sessions/typed%20once/captures/0")
        wait_until(lambda: "240 × 180 pixels" in text(page, "#reading"), "levels are loaded")
        page.hover("#levels")
        wait_until(lambda: text(page, "#reading").endswith(" DN"), "a level is read")
        page.keyboard.press("n")
        wait_until(lambda: page.get_attribute("[data-image=noise]", "aria-pressed") == "true", "N")
        page.keyboard.press("ArrowRight")
        page.wait_for_url("**/captures/1")

        page.goto(f"{rig.url}sessions/typed%20once")
        thumbnails = "[...document.querySelectorAll('.thumbnail img')].map(i => i.naturalWidth)"
        wait_until(lambda: page.evaluate(thumbnails) == [128, 128], "thumbnails")
        take_control(page)
        page.wait_for_selector("[data-result=calibrate]:enabled")
        page.click("[data-result=calibrate]")
        page.wait_for_selector("text=σy")  # of an edge in one direction
        wait_until(
            lambda: "no earlier calibration" in text(page, "#result-message"), "the comparison"
        )
        with page.context.expect_page() as opened:
            page.click("[aria-label='Open PSF']")
        opened.value.wait_for_selector("text=PSF calibration")


def test_a_capture_is_excluded_and_included_from_the_page(captured: ConsoleRig) -> None:
    rig = captured
    with rig.page("/sessions/typed%20once") as page:
        take_control(page)
        page.wait_for_selector("[data-exclude='1']:enabled")
        page.click("[data-exclude='1']")  # the rig answers every question with "Ada"
        page.wait_for_selector("text=excluded: Ada")
        assert len(Session(rig.sessions / "typed once").records) == 1
        page.wait_for_selector("[data-include='1']:enabled")
        page.click("[data-include='1']")
        page.wait_for_selector("[data-exclude='1']")
    assert len(Session(rig.sessions / "typed once").records) == 2


def test_on_a_phone_nothing_is_too_small_or_too_wide(captured: ConsoleRig) -> None:
    rig = captured
    small = """() => [...document.querySelectorAll("main a, main button, main select, main input")]
        .filter(e => e.type !== "checkbox" && !e.closest("h2") && e.getBoundingClientRect().width)
        .filter(e => e.getBoundingClientRect().height < 44).map(e => e.outerHTML)"""
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True}
    for path in (
        "/sessions",
        "/sessions/typed%20once",
        "/sessions/typed%20once/captures/0",
        "/plans/edit?plan=typed",
    ):
        with rig.page(path, **phone) as page:
            take_control(page)
            assert page.evaluate("document.documentElement.scrollWidth") == 390
            assert page.evaluate(small) == []
