"""The practice bench and the console as processes, and a real Chromium that looks at them."""

import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import pytest

from standoff.shipped_configs import shipped_config
from tests.hil_mocks.gige_bench import free_addresses
from tests.standoff.console.processes import first_line, pipe, standoff_process

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import Browser, Page, sync_playwright

CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM_OPTIONS = (
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--disable-gpu",
    "--js-flags=--expose-gc",
)
DEADLINE_S = 300.0
"""Of every wait: only a failure takes so long, whatever else this computer does."""

BENCH_KEYS = ("stage.feed_mm_per_min=3000", "stage.settle_s=0.1", "capture.frames_per_capture=4")
FEW_PICTURES = ("--set", "camera.frame_rate_hz=10")
"""Options of a console whose pictures are not what is tested: they take most of the processor."""

MOCK_KEYS = (
    "simulated.width_px=240",
    "simulated.height_px=180",
    "simulated.focus_distance_mm=300.0",
    "simulated.f_number=1.0",
)


def chromium_path() -> str:
    """Path of an installed Chromium; skips the test where there is none."""
    for name in CHROMIUM_NAMES:
        path = shutil.which(name)
        if path is not None:
            return path
    pytest.skip("no Chromium is installed: sudo apt-get install chromium")


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Wait for something to become true; a failure names it."""
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        if time.monotonic() > end_s:
            raise AssertionError(f"did not happen within {DEADLINE_S:g} s: {what}")
        time.sleep(0.05)


class ConsoleRig:
    """A practice bench, the console over it, and a browser.

    Parameters
    ----------
    mock
        The process of ``standoff mock``.
    url
        Of the console.
    sessions
        Its folder of sessions.
    browser
        Chromium.
    """

    def __init__(
        self,
        mock: subprocess.Popen[str],
        url: str,
        sessions: Path,
        browser: Browser,
    ) -> None:
        self.url = url
        self.sessions = sessions
        self._mock = mock
        self._browser = browser
        self.requests: list[str] = []
        self.faults: list[str] = []

    def tell_mock(self, line: str) -> None:
        """Be the operator at the practice bench."""
        pipe(self._mock.stdin).write(line + "\n")
        pipe(self._mock.stdin).flush()

    @contextmanager
    def page(self, path: str = "/", **options: Any) -> Iterator[Page]:
        """Open a page in a browser of its own; it is in control if it asks for it."""
        context = self._browser.new_context(**options)
        # The first page of a console is in control without being asked for a name.
        # A report is sandboxed and has no storage.
        context.add_init_script("try { localStorage.setItem('operator', 'Ada') } catch {}")
        page = context.new_page()
        page.set_default_timeout(1e3 * DEADLINE_S)
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on(
            "console",
            lambda message: self.faults.append(message.text) if message.type == "error" else None,
        )
        page.on("dialog", lambda dialog: dialog.accept("Ada"))
        page.goto(self.url + path.lstrip("/"))
        try:
            yield page
        finally:
            context.close()

    @contextmanager
    def operator(self, **options: Any) -> Iterator[Page]:
        """Open the bench page and take control; the stage is homed when it is yours."""
        with self.page(**options) as page:
            take_control(page)
            wait_until(lambda: text(page, "#stage-motion") in ("at rest", "ALARM"), "stage ready")
            if text(page, "#stage-homed") != "homed":
                page.click("#home")
                wait_until(lambda: text(page, "#stage-homed") == "homed", "stage homed")
            wait_until(lambda: text(page, "#stage-motion") == "at rest", "stage at rest")
            yield page


def take_control(page: Page) -> None:
    """Take control over unless this page has it."""
    wait_until(
        lambda: text(page, "#control-text") not in ("connecting …", "not connected"), "connected"
    )
    if page.is_visible("#take-control"):
        page.click("#take-control")
    wait_until(lambda: text(page, "#control-text").startswith("You are"), "in control")


def text(page: Page, selector: str) -> str:
    """Text of an element as it is now."""
    return (page.text_content(selector) or "").strip()


def number(page: Page, selector: str) -> float:
    """Number that an element shows; NaN where it shows none."""
    try:
        return float(text(page, selector))
    except ValueError:
        return float("nan")


def move_to(page: Page, height_mm: float) -> None:
    """Send the stage somewhere; does not wait for it."""
    page.fill("#move-to", f"{height_mm:g}")
    page.click("#move-form button[type=submit]")


def wait_at(page: Page, height_mm: float) -> None:
    """Wait until the stage stands there."""
    wait_until(
        lambda: (
            abs(number(page, "#stage-height") - height_mm) < 0.05
            and text(page, "#stage-motion") == "at rest"
            and page.is_enabled("#home")
        ),
        f"stage at {height_mm:g} mm",
    )


@contextmanager
def chromium_browser() -> Iterator[Browser]:
    """Chromium without a window; skips the test where there is none."""
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=chromium_path(), args=list(CHROMIUM_OPTIONS)
        )
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def console_rig(
    folder: Path,
    *options: object,
    mock_keys: tuple[str, ...] = MOCK_KEYS,
    browser: Browser | None = None,
) -> Iterator[ConsoleRig]:
    """Serve a small practice bench with a Grbl stage, and the console over it.

    Its pages open in the browser, or in one of its own.
    """
    pytest.importorskip("gi", reason="the practice camera needs Aravis")
    chromium_path()
    keys = [word for key in mock_keys for word in ("--set", key)]
    address = next(free_addresses())
    with standoff_process(
        "mock", "--stage-protocol", "grbl", "--address", address, "--json", *keys, cwd=folder
    ) as mock:
        ready = first_line(mock)
        bench_keys = (
            *BENCH_KEYS,
            f"camera.address={ready['camera_address']}",
            f"stage.port={ready['stage_port']}",
        )
        settings = [word for key in bench_keys for word in ("--set", key)]
        with standoff_process(
            "console", "--bench", shipped_config("grbl_stage.toml"), "--port", 0, "--json",
            "--sessions", folder / "sessions", "--plans", folder, *settings, *options, cwd=folder,
        ) as console:  # fmt: skip
            url = first_line(console)["url"]
            with chromium_browser() if browser is None else nullcontext(browser) as opened:
                yield ConsoleRig(mock, url, folder / "sessions", opened)
