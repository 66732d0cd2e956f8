"""Figures of a camera from which nothing comes any more, and charts of nothing, in Chromium."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest
from scipy.special import erf

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import Browser

from acquisition.devices import FrameImage
from acquisition.focus import Region
from standoff.console.bench_hub import BenchHub
from standoff.console.devices.device_status import DeviceStatus
from tests.acquisition.fakes import SETTINGS, frame
from tests.standoff.console.console_rig import chromium_browser, number, text, wait_until
from tests.standoff.console.hub_fixtures import idle_hub, running_hub
from tests.standoff.console.web.live_page import PHONE, LivePage, live_page

pytestmark = [pytest.mark.slow, pytest.mark.waits]

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


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium_browser() as opened:
        yield opened


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

    hub.camera._status = DeviceStatus(state="ready")  # the stream ends before anybody notices
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


def test_on_a_phone_the_header_is_low_and_stop_stays_in_reach(
    browser: Browser, tmp_path: Path
) -> None:
    phone = {"viewport": PHONE, "has_touch": True, "is_mobile": True}
    with live_page(browser, idle_hub(tmp_path), **phone) as live:
        live.page.evaluate("scrollTo(0, document.body.scrollHeight)")
        header = live.page.locator("header").bounding_box()
        stop = live.page.locator("#stop").bounding_box()
        assert header is not None
        assert stop is not None
        assert header["y"] == 0
        assert header["height"] <= 110
        assert 0 <= stop["y"] <= header["height"] - stop["height"]
        assert stop["x"] + stop["width"] <= PHONE["width"]
