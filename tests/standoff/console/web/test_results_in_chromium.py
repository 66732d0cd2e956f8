"""From captures to results without a terminal, in a real browser."""

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from acquisition.plan import load_plan
from acquisition.session import Session
from tests.standoff.console.console_rig import (
    FEW_PICTURES,
    ConsoleRig,
    console_rig,
    take_control,
    text,
    wait_until,
)

pytestmark = [pytest.mark.slow(minutes=0.3), pytest.mark.waits]


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleRig]:
    folder: Path = tmp_path_factory.mktemp("results")
    with console_rig(folder, *FEW_PICTURES) as made:
        yield made
        assert made.faults == []
        assert {urlsplit(url).hostname for url in made.requests} == {"127.0.0.1"}


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
