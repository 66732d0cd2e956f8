"""Bench pages in a real Chromium, over consoles in this process whose pictures a test makes."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

from acquisition.devices import CameraSettings, Frame, FrameImage
from standoff.console.bench_hub import BenchHub
from standoff.console.devices import DeviceStatus
from tests.acquisition.fakes import SETTINGS, frame
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
def opened_page(browser: Browser, url: str, *, name: str = "Ada", **options: Any) -> Iterator[Page]:
    """Open a page in a browser of its own, for an operator of that name."""
    context = browser.new_context(**({"viewport": DESK} | options))
    try:
        # A report is sandboxed and has no storage.
        context.add_init_script(f"try {{ localStorage.setItem('operator', '{name}') }} catch {{}}")
        page = context.new_page()
        page.set_default_timeout(1e3 * DEADLINE_S)
        page.on("dialog", lambda dialog: dialog.accept(name))
        page.goto(url)
        yield page
    finally:
        context.close()


@contextmanager
def live_page(browser: Browser, hub: BenchHub, **options: Any) -> Iterator[LivePage]:
    """Serve a hub and open its bench page; a fault in a script of the page fails the test."""
    with served(hub) as (host, port), opened_page(browser, "about:blank", **options) as page:
        made = LivePage(page, hub)
        page.goto(f"http://{host}:{port}/")
        page.wait_for_selector("body.mine")
        yield made
        assert made.faults == []


ROWS, COLS = 90, 120
PERIOD_S = 0.1


class Streaming:
    """Ten pictures a second, all the same, until ``is_dead`` is set."""

    def __init__(self, hub: BenchHub, image_dn: FrameImage) -> None:
        self.image_dn = image_dn
        self.is_dead = Event()
        self._hub = hub
        hub.camera.status = DeviceStatus(state="ready")
        self._thread = Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        """End the pictures."""
        self.is_dead.set()
        self._thread.join()

    def _run(self) -> None:
        count = 0
        while not self.is_dead.wait(PERIOD_S):
            count += 1
            self._hub.frames.publish(frame(self.image_dn, count), SETTINGS)


@contextmanager
def streaming(hub: BenchHub, image_dn: FrameImage) -> Iterator[Streaming]:
    """Pictures of a hub whose camera is never opened."""
    made = Streaming(hub, image_dn)
    try:
        yield made
    finally:
        made.close()


def even_dn(level: float, rows: int = ROWS, cols: int = COLS) -> NDArray[np.uint16]:
    """A picture that is shown with this level of 0 to 254."""
    return np.full((rows, cols), round(level * SETTINGS.max_level_dn / 254), np.uint16)


def step_dn(column_px: float) -> NDArray[np.uint16]:
    """Dark up to a column, bright from there on."""
    x_px = np.broadcast_to(np.arange(COLS), (ROWS, COLS))
    share = 0.5 + 0.5 * erf((x_px - column_px) / np.sqrt(2))
    return np.asarray(np.rint(600 + 1500 * share), dtype=np.uint16)


def seen(live: LivePage) -> NDArray[np.int64]:
    """What is in the frame of the picture on the screen: rows, columns, and blue, green, red."""
    data = live.page.locator("#frame").screenshot()
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image, np.int64)


def level_at(live: LivePage, x_px: float, y_px: float) -> list[int]:
    """Blue, green and red that are seen at a place of the picture."""
    right, down = live.asked(f"standoff.view.shown([{x_px}, {y_px}])")
    return [int(value) for value in seen(live)[int(down), int(right)]]
