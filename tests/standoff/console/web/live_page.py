"""A bench page in a real Chromium, over a console in this process whose pictures a test makes."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from acquisition.devices import CameraSettings, Frame, FrameImage
from standoff.console.bench_hub import BenchHub
from tests.acquisition.fakes import SETTINGS
from tests.standoff.console.console_rig import wait_until
from tests.standoff.console.hub_fixtures import DEADLINE_S
from tests.standoff.console.served import served

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import Browser, Page

DESK = {"width": 1440, "height": 900}
PHONE = {"width": 390, "height": 844}


class LivePage:
    """The bench page of a hub, in control of it.

    Parameters
    ----------
    page
        Open in Chromium.
    hub
        Of the console that served it.
    """

    def __init__(self, page: Page, hub: BenchHub) -> None:
        self.page = page
        self.hub = hub
        self.faults: list[str] = []
        self._frame_id = 0
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on(
            "console",
            lambda message: self.faults.append(message.text) if message.type == "error" else None,
        )

    def show(self, image_dn: FrameImage, settings: CameraSettings = SETTINGS) -> None:
        """Publish a frame, and wait until the page has drawn it."""
        drawn = self.asked("standoff.picture.drawn")
        self._frame_id += 1
        self.hub.frames.publish(
            Frame(image_dn=image_dn, frame_id=self._frame_id, timestamp_ns=self._frame_id), settings
        )
        wait_until(lambda: self.asked("standoff.picture.drawn") > drawn, "the picture is drawn")
        rows, cols = image_dn.shape
        size = "[standoff.picture.canvas.height, standoff.picture.canvas.width]"
        wait_until(lambda: self.asked(size) == [rows, cols], "the canvas has its size")
        self.page.evaluate("() => new Promise(done => requestAnimationFrame(() => done()))")

    def asked(self, expression: str) -> Any:
        """Value of an expression in the page."""
        return self.page.evaluate(expression)

    def on_screen(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Where a place of the picture is on the screen; the centre of pixel 3 is at 3.5."""
        x, y = self.asked(
            f"(([x, y], box) => [x + box.left, y + box.top])(standoff.view.shown([{x_px}, {y_px}]),"
            " document.getElementById('frame').getBoundingClientRect())"
        )
        return x, y


@contextmanager
def live_page(browser: Browser, hub: BenchHub, **options: Any) -> Iterator[LivePage]:
    """Serve a hub and open its bench page; a fault in a script of the page fails the test."""
    with served(hub) as (host, port):
        context = browser.new_context(**({"viewport": DESK} | options))
        try:
            # A report is sandboxed and has no storage.
            context.add_init_script("try { localStorage.setItem('operator', 'Ada') } catch {}")
            page = context.new_page()
            page.set_default_timeout(1e3 * DEADLINE_S)
            made = LivePage(page, hub)
            page.goto(f"http://{host}:{port}/")
            page.wait_for_selector("body.mine")
            yield made
            assert made.faults == []
        finally:
            context.close()
