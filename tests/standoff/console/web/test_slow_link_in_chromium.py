"""The bench page over slow connections: pictures that keep up, and STOP before them."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import Browser, Page

from tests.standoff.console.console_rig import chromium_browser, text, wait_until
from tests.standoff.console.hub_fixtures import DEADLINE_S
from tests.standoff.console.served import served
from tests.standoff.console.slow_link import slow_link
from tests.standoff.console.textured_camera import textured_hub

pytestmark = [pytest.mark.slow, pytest.mark.waits]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium_browser() as opened:
        yield opened


@contextmanager
def slow_page(
    browser: Browser, folder: Path, rate_bytes_per_s: float, one_way_s: float
) -> Iterator[Page]:
    with (
        textured_hub(folder) as hub,
        served(hub) as address,
        slow_link(address, rate_bytes_per_s, one_way_s) as link,
    ):
        context = browser.new_context(viewport={"width": 1440, "height": 900})
        try:
            page = context.new_page()
            page.set_default_timeout(1e3 * DEADLINE_S)
            page.goto(link.url)
            page.wait_for_selector("body.mine")
            page.evaluate("() => { standoff.first = standoff.connection.socket; }")
            yield page
            assert page.evaluate("standoff.connection.socket === standoff.first"), "disconnected"
        finally:
            context.close()


def stop_heard_ms(page: Page) -> float:
    """Time from STOP to the console's word that it was heard, of the best of three."""
    return float(
        page.evaluate("""async () => {
            const took = [];
            for (let time = 0; time < 3; time++) {
                const pressed = performance.now();
                const heard = new Promise((done) =>
                    standoff.connection.addEventListener("stop-heard", done, { once: true }));
                document.getElementById("stop").click();
                await heard;
                took.push(performance.now() - pressed);
            }
            return Math.min(...took);
        }""")
    )


@pytest.mark.parametrize(
    ("rate_bytes_per_s", "one_way_s", "least_hz", "most_ms"),
    [(1e6, 0.1, 8.0, 400.0), (60e3, 0.1, 1.0, 1000.0)],
)
def test_pictures_keep_up_with_the_link_and_stop_comes_before_them(
    browser: Browser,
    tmp_path: Path,
    rate_bytes_per_s: float,
    one_way_s: float,
    least_hz: float,
    most_ms: float,
) -> None:
    with slow_page(browser, tmp_path, rate_bytes_per_s, one_way_s) as page:
        wait_until(
            lambda: bool(
                page.evaluate(
                    "standoff.picture.times.length === 30"
                    f" && standoff.picture.rate() >= {least_hz}"
                    f" && standoff.picture.latencyMs() <= {most_ms}"
                )
            ),
            f"{least_hz:g} pictures a second, {most_ms:g} ms old",
        )
        shown = text(page, "#picture-rate")
        assert "compressed" in shown or "the connection is slow" in shown
        # Saturated pixels are red, and only they, whatever the form of the picture.
        canvas = "standoff.picture.context.getImageData"
        assert page.evaluate(f"[...{canvas}(30, 30, 1, 1).data]") == [255, 32, 32, 255]
        red, green, blue, _ = page.evaluate(f"[...{canvas}(400, 300, 1, 1).data]")
        assert red == green == blue
        assert stop_heard_ms(page) < 1000.0


def test_a_fast_link_shows_every_pixel_as_it_is(browser: Browser, tmp_path: Path) -> None:
    with textured_hub(tmp_path, noise_dn=0.0) as hub, served(hub) as (host, port):
        context = browser.new_context(viewport={"width": 1440, "height": 900})
        try:
            page = context.new_page()
            page.set_default_timeout(1e3 * DEADLINE_S)
            page.goto(f"http://{host}:{port}/")
            page.wait_for_selector("body.mine")
            wait_until(lambda: bool(page.evaluate("standoff.picture.isExact")), "exact pictures")
            shown = page.evaluate(
                "[...standoff.picture.context.getImageData(0, 0, 780, 580).data]"
                ".filter((_, index) => index % 4 === 1)"
            )
            latest = hub.frames.latest
            assert latest is not None
            expected = np.rint(latest.image_dn * (254 / 4095))
            expected[latest.image_dn == 4095] = 32  # red
            assert np.array_equal(np.array(shown).reshape(580, 780), expected)
        finally:
            context.close()


def test_the_age_of_a_picture_is_by_the_consoles_clock(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with textured_hub(tmp_path) as hub:
        monkeypatch.setattr(hub.frames, "_clock", lambda: time.time() - 3600.0)
        monkeypatch.setattr("standoff.console.web.viewer.wall_s", lambda: time.time() - 3600.0)
        with served(hub) as (host, port):
            context = browser.new_context(viewport={"width": 1440, "height": 900})
            try:
                page = context.new_page()
                page.set_default_timeout(1e3 * DEADLINE_S)
                page.goto(f"http://{host}:{port}/")
                page.wait_for_selector("body.mine")
                wait_until(
                    lambda: (
                        abs(page.evaluate("standoff.picture.latencyMs()")) < 5e3
                        and page.evaluate("standoff.picture.times.length") == 30
                    ),
                    "an age without the difference of the clocks",
                )
            finally:
                context.close()
