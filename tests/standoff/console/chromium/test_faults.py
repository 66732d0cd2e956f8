"""Long exposures, lost devices, old figures and reports of changes, in a real browser."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest
from scipy.special import erf

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


from playwright.sync_api import Browser, Page

from acquisition.devices import FrameImage
from acquisition.focus import Region
from acquisition.session import MANIFEST_NAME
from hil_mocks.devices import CameraFaults, SimulatedCamera, SimulatedStage, StageFaults
from standoff.console.bench_hub import BenchHub
from standoff.console.devices import DeviceStatus
from tests.acquisition.fakes import SETTINGS, frame
from tests.analysis.reports.test_changes import page as changes_page
from tests.standoff.console.chromium.pages import LivePage, live_page
from tests.standoff.console.console_rig import number, text, wait_until
from tests.standoff.console.hub_fixtures import idle_hub, running_hub

pytestmark = [pytest.mark.slow, pytest.mark.waits]

LARGE_LAYER = """() => [...document.querySelectorAll(".view-large svg > use:not(.masks)")]
    .findIndex((layer) => layer.style.display === "")"""


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


def classes(page: Page, selector: str) -> set[str]:
    return set((page.get_attribute(selector, "class") or "").split())


def test_a_stop_is_green_only_once_the_stage_was_seen_at_rest(
    browser: Browser, tmp_path: Path
) -> None:
    with running_hub(tmp_path) as hub, live_page(browser, hub) as live:
        page = live.page
        page.click("#stop")
        wait_until(lambda: "stopped" in classes(page, "#stop"), "green")
        assert not page.is_visible("#alert-moving")
        assert hub.stopping.view.outcome == "stopped"


def test_a_stage_that_cannot_be_told_to_stop_is_said_large_and_red_with_what_to_do(
    browser: Browser, tmp_path: Path
) -> None:
    with running_hub(tmp_path) as hub, live_page(browser, hub) as live:
        page = live.page
        stage = hub.stage._stage
        assert isinstance(stage, SimulatedStage)
        stage.faults = StageFaults(unplugged=True)
        page.wait_for_selector("#alert-stage:visible")
        page.click("#stop")
        page.wait_for_selector("#alert-moving:visible")
        assert "failed" in classes(page, "#stop")
        assert not {"stopped", "pressed"} & classes(page, "#stop")
        assert "emergency stop" in text(page, "#alert-moving strong")
        size = "Number.parseFloat(getComputedStyle(document.querySelector('#alert-moving strong'))"
        assert live.asked(f"{size}.fontSize)") > 30  # px; the text of the page has 16
        page.screenshot(path=tmp_path / "not-stopped.png")

        page.goto(page.url + "sessions")  # whichever page is open says so
        page.wait_for_selector("#alert-moving:visible")
        page.click("#stop-seen")
        page.wait_for_selector("#alert-moving", state="hidden")
        page.click("#stop")
        page.wait_for_selector("#alert-moving:visible")
        stage.faults, stage._is_open = StageFaults(), True  # plugged in, and opened again
        page.wait_for_selector("#alert-moving", state="hidden")
        assert hub.stopping.view.outcome == "stopped"


def test_a_plan_without_room_on_the_disk_cannot_be_run_until_there_is(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running_hub(tmp_path) as hub:
        free_bytes = [64 * 2**20]
        monkeypatch.setattr(hub, "free_bytes", lambda: free_bytes[0])
        with live_page(browser, hub) as live:
            page = live.page
            wait_until(lambda: "NOT ENOUGH" in text(page, "#preview"), "said")
            assert "67 MB free, of which 67 MB stay free" in text(page, "#preview")
            wait_until(lambda: page.is_enabled("#home"), "free to set")
            assert page.is_disabled("#run")
            page.screenshot(path=tmp_path / "no-room.png", full_page=True)
            free_bytes[0] = 10**9
            wait_until(lambda: page.is_enabled("#run"), "free to run")
            assert "NOT ENOUGH" not in text(page, "#preview")


def test_the_first_edge_says_that_it_waits_for_the_code_to_be_compiled(
    browser: Browser, tmp_path: Path
) -> None:
    with running_hub(tmp_path) as hub, live_page(browser, hub) as live:
        page = live.page
        assert not page.is_visible("#chip-compiling")
        hub.sharpness.view = replace(hub.sharpness.view, is_awaited=True, sequence=99)
        wait_until(lambda: "measuring" in text(page, "#edge-why"), "measuring")
        hub.compiling._begin("as the first edge does")
        page.wait_for_selector("#chip-compiling:visible")
        wait_until(lambda: "compiled once" in text(page, "#edge-why"), "said")
        page.screenshot(path=tmp_path / "compiling.png")
        hub.compiling._end()
        page.wait_for_selector("#chip-compiling", state="hidden")


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


ROWS, COLS = 120, 160
WHOLE = Region(x_px=0, y_px=0, width_px=COLS, height_px=ROWS)
PERIOD_S = 0.05
IS_BLANK = """(id) => {
    const canvas = document.getElementById(id);
    const { width, height } = canvas;
    return !canvas.getContext("2d").getImageData(0, 0, width, height).data.some(Boolean);
}"""
EMPTY_TRACE = """async () => {
    const { drawTrace } = await import("/static/charts.js");
    drawTrace(document.getElementById("trace"), [], [], 0, false);
}"""


def edge_dn(number: int) -> FrameImage:
    """A straight edge with noise."""
    y_px, x_px = np.mgrid[:ROWS, :COLS]
    share = 0.5 + 0.5 * erf((y_px - ROWS / 2 - 0.08 * (x_px - COLS / 2)) / 1.2)
    levels = np.random.default_rng(number).normal(500 + 2000 * share, 12)
    return np.asarray(np.rint(levels), dtype=np.uint16)


@contextmanager
def streaming(hub: BenchHub) -> Iterator[Event]:
    """Twenty pictures of an edge a second, until the event that is yielded is set."""
    is_dead = Event()

    def stream() -> None:
        count = 0
        while not is_dead.wait(PERIOD_S):
            count += 1
            hub.frames.publish(frame(edge_dn(count), count), SETTINGS)

    hub.camera.status = DeviceStatus(state="ready")  # the stream ends before anybody notices
    thread = Thread(target=stream)
    for each in (hub.picture, hub.sharpness, thread):
        each.start()
    try:
        yield is_dead
    finally:
        is_dead.set()
        thread.join()
        hub.picture.close()
        hub.sharpness.close()


def is_stale(live: LivePage, selector: str) -> bool:
    return bool(live.page.evaluate(f"document.querySelector('{selector}').matches('.stale')"))


def test_the_figures_of_a_dead_camera_are_stale_and_then_nothing(
    browser: Browser, tmp_path: Path
) -> None:
    hub = idle_hub(tmp_path)
    with streaming(hub) as is_dead, live_page(browser, hub) as live:
        page = live.page
        hub.picture.look_at(WHOLE)
        hub.sharpness.look_at(WHOLE)
        wait_until(lambda: page.is_visible("#edge"), "an edge is measured")
        wait_until(lambda: number(page, "#focus-percent") > 50, "focus is measured")
        aged = ("#focus .big", "#edge", ".levels .facts", "#camera-rate")
        wait_until(lambda: not any(is_stale(live, each) for each in aged), "all is new")
        assert "chip ok" in (page.get_attribute("#chip-camera", "class") or "")
        is_dead.set()
        wait_until(lambda: all(is_stale(live, each) for each in aged), "all is stale")
        assert (page.get_attribute("#focus .big", "data-old") or "").endswith(" s old")
        page.wait_for_selector("#chip-camera.warn")
        assert page.get_attribute("#chip-camera", "title") == "no new picture"
        page.wait_for_selector("#no-picture:visible")
        figures = ("#focus-percent", "#focus-value", "#mean", "#saturated")
        wait_until(lambda: {text(page, each) for each in figures} == {"–"}, "none is shown")
        assert text(page, "#focus-hint") == "no new picture"
        assert text(page, "#picture-rate") == "shown: –"
        page.wait_for_selector("#edge", state="hidden")
        assert text(page, "#edge-why") == "no new picture"
        wait_until(lambda: text(page, "#camera-rate").startswith("–"), "no rate")
        for chart in ("trace", "histogram"):
            assert page.evaluate(IS_BLANK, chart)


def test_a_measurement_that_lags_is_old_though_pictures_come(
    browser: Browser, tmp_path: Path
) -> None:
    hub = idle_hub(tmp_path)
    with streaming(hub), live_page(browser, hub) as live:
        hub.sharpness.look_at(WHOLE)
        wait_until(lambda: live.page.is_visible("#edge"), "an edge is measured")
        hub.sharpness.close()
        wait_until(lambda: is_stale(live, "#edge"), "the edge is stale")
        assert not is_stale(live, "#focus .big")
        live.page.wait_for_selector("#edge", state="hidden")


def test_a_chart_of_nothing_has_no_axes(browser: Browser, tmp_path: Path) -> None:
    with live_page(browser, idle_hub(tmp_path)) as live:
        live.page.evaluate(EMPTY_TRACE)
        assert live.page.evaluate(IS_BLANK, "trace")


def test_an_exposure_that_is_refused_is_set_back_and_the_reason_is_in_words(
    browser: Browser, tmp_path: Path
) -> None:
    with running_hub(tmp_path) as hub, live_page(browser, hub) as live:
        page = live.page
        wait_until(lambda: page.input_value("#exposure") != "", "the exposure is shown")
        before = page.input_value("#exposure")
        page.fill("#exposure", "999999999")
        page.keyboard.press("Enter")
        wait_until(lambda: "The exposure must be at most" in text(page, "#notices"), "refused")
        wait_until(lambda: page.input_value("#exposure") == before, "set back")
        page.fill("#exposure", "4321")  # what is being typed stays
        page.wait_for_timeout(400)
        assert page.input_value("#exposure") == "4321"
