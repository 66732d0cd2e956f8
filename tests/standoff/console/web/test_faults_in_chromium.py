"""Long exposures, a camera that was lost, and reports of changes, in a real browser."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import Browser

from acquisition.session import MANIFEST_NAME
from hil_mocks.camera import CameraFaults, SimulatedCamera
from standoff.console.bench_hub import BenchHub
from tests.analysis.reports.changes.test_pages import page as changes_page
from tests.standoff.console.console_rig import chromium_browser, text, wait_until
from tests.standoff.console.hub_fixtures import idle_hub, running_hub
from tests.standoff.console.web.live_page import live_page

pytestmark = [pytest.mark.slow, pytest.mark.waits]

LARGE_LAYER = """() => [...document.querySelectorAll(".view-large svg > use:not(.masks)")]
    .findIndex((layer) => layer.style.display === "")"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium_browser() as opened:
        yield opened


def exposure_us(hub: BenchHub) -> float:
    assert hub.camera.settings is not None
    return hub.camera.settings.exposure_us


def test_a_minute_of_exposure_is_asked_for_counted_down_and_broken_off(
    browser: Browser, tmp_path: Path
) -> None:
    with running_hub(tmp_path) as hub, live_page(browser, hub) as live:
        page, before = live.page, exposure_us(hub)
        wait_until(lambda: page.is_enabled("#exposure"), "free to set")
        page.fill("#exposure", "60000000")
        page.press("#exposure", "Enter")
        page.wait_for_selector("#ask-exposure:visible")
        assert "Each picture will take 60 s" in text(page, "#ask-exposure-text")
        page.click("#keep-exposure")
        assert not page.is_visible("#ask-exposure")
        assert exposure_us(hub) == before

        page.fill("#exposure", "60000000")
        page.press("#exposure", "Enter")
        page.click("#expose-long")
        page.wait_for_selector("#exposing:visible")
        assert exposure_us(hub) == 60e6
        first = text(page, "#exposing-text")
        assert "s left of 60 s" in first
        wait_until(lambda: text(page, "#exposing-text") != first, "counted down")

        page.click("#auto-exposure")
        wait_until(lambda: hub.jobs.current is not None, "a job")
        page.keyboard.press("Escape")
        wait_until(lambda: hub.jobs.current is None, "stopped, not after the frame")
        assert hub.camera.status.is_ready

        wait_until(lambda: page.is_visible("#break-off"), "free to break off")
        seen = hub.frames.counts.complete
        page.click("#break-off")
        wait_until(lambda: hub.frames.counts.complete > seen, "a picture")
        wait_until(lambda: not page.is_visible("#exposing"), "no countdown")
        assert exposure_us(hub) == before


def test_a_lost_camera_is_shown_and_gone_from_the_page_when_it_is_back(
    browser: Browser, tmp_path: Path
) -> None:
    with running_hub(tmp_path) as hub, live_page(browser, hub) as live:
        page = live.page
        camera = hub.camera._camera
        assert isinstance(camera, SimulatedCamera)
        camera.faults = CameraFaults(disconnect_at=0)
        page.wait_for_selector("#alert-camera:visible")
        page.wait_for_selector("#alert-camera", state="hidden")
        drawn = live.asked("standoff.picture.drawn")
        wait_until(lambda: live.asked("standoff.picture.drawn") > drawn, "pictures again")


def served_report(hub: BenchHub, document: str) -> str:
    """Put a report of changes into a session of the hub; return its address below the console."""
    folder = hub.sessions.folder / "today" / "results" / "changes" / "1 against 0"
    folder.mkdir(parents=True)
    (hub.sessions.folder / "today" / MANIFEST_NAME).write_text("{}")
    found = {"changes": [{}], "changed_px": 7, "compared_px": 100}
    (folder / "changes.json").write_text(json.dumps(found))
    (folder / "report.html").write_text(document, encoding="utf-8")
    return "sessions/today/results/changes/1%20against%200/report.html"


def test_rows_and_blink_of_a_report_of_changes_work_in_the_console(
    browser: Browser, tmp_path: Path
) -> None:
    hub = idle_hub(tmp_path)
    address = served_report(hub, changes_page()[0])
    with live_page(browser, hub) as live:
        page = live.page
        page.goto(f"{page.url}{address}")
        whole = page.get_attribute("section.views svg", "viewBox")
        page.click("table.changes tbody tr:nth-child(1)")
        assert page.get_attribute("section.views svg", "viewBox") != whole
        assert page.get_attribute("table.changes tbody tr:nth-child(1)", "class") == "chosen"
        page.keyboard.press("b")
        for layer in (0, 1):
            wait_until(lambda: page.evaluate(LARGE_LAYER) == layer, "it blinks")  # noqa: B023
        # In an origin of its own: neither the console's cookie nor its pages are within its reach.
        assert page.evaluate("self.origin") == "null"
        assert not page.is_visible("text=does not run in the console")


def test_a_script_of_another_kind_does_not_run_and_the_page_says_so(
    browser: Browser, tmp_path: Path
) -> None:
    hub = idle_hub(tmp_path)
    address = served_report(hub, "<body><script>document.title = 'ran'</script>changes</body>")
    with live_page(browser, hub) as live:
        page = live.page
        page.goto(f"{page.url}{address}")
        assert page.is_visible("text=does not run in the console")
        assert page.title() != "ran"
        live.faults.clear()  # the browser's own line about what it blocked
