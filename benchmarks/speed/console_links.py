"""The live picture over slow connections: pictures a second, their age, their form, and STOP.

Run with ``python -m benchmarks.speed.console_links``. The console and the camera, a noisy texture
of 780 x 580 pixels at 25 Hz, are this process; Chromium is another one. Between them stands a link
that carries so many bytes a second towards the page, and keeps what does not fit without a limit.
The peer of each link is the connection without it, in the same run.
"""

import statistics
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Browser, Page

from benchmarks.harness import Recorder, benchmark
from tests.standoff.console.console_rig import chromium_browser, text, wait_until
from tests.standoff.console.hub_fixtures import textured_hub
from tests.standoff.console.networks import slow_link
from tests.standoff.console.served import Address, served

LINKS = ((1e7, 0.02), (1e6, 0.0), (1e6, 0.1), (2.5e5, 0.1), (6e4, 0.0), (6e4, 0.1))
"""Bytes a second, and seconds each way."""

SETTLING_S, SECONDS, STOPS = 10.0, 15.0, 5
DRAWN = "standoff.picture.drawn"
LOSSES = """() => {
    standoff.losses = 0;
    standoff.connection.addEventListener("lost", () => { standoff.losses += 1; });
}"""
STOP = """() => new Promise((done) => {
    const pressed = performance.now();
    standoff.connection.addEventListener(
        "stop-heard", () => done(performance.now() - pressed), { once: true });
    document.getElementById("stop").click();
})"""


def _measure_page(record: Recorder, page: Page, name: str) -> None:
    """Keep what a page shows for some time over a link."""
    wait_until(lambda: page.evaluate(DRAWN) > 0, "a picture")
    time.sleep(SETTLING_S)
    page.evaluate(LOSSES)
    drawn, begun_s = page.evaluate(DRAWN), time.monotonic()
    ages_ms = []
    while time.monotonic() - begun_s < SECONDS:
        time.sleep(0.5)
        ages_ms.append(page.evaluate("standoff.picture.latencies.at(-1)"))
    rate_hz = (page.evaluate(DRAWN) - drawn) / (time.monotonic() - begun_s)
    form = text(page, "#picture-rate").partition(" ms")[2].strip(" ,") or "as they are"
    stops_ms = [page.evaluate(STOP) for _ in range(STOPS)]
    age_ms, stop_ms = statistics.median(ages_ms), statistics.median(stops_ms)
    losses = page.evaluate("standoff.losses")
    record.say(
        f"{name}: {rate_hz:.1f} a second, age {age_ms:.0f} ms (at most {max(ages_ms):.0f}), "
        f"STOP answered in {stop_ms:.0f} ms, connection lost {losses} times; {form}"
    )
    record.figure(f"pictures a second, {name}", rate_hz, "1/s")
    record.figure(f"age of a picture, median, {name}", age_ms, "ms")
    record.figure(f"age of a picture, most, {name}", max(ages_ms), "ms")
    record.figure(f"STOP answered, median, {name}", stop_ms, "ms")
    record.figure(f"connections lost, {name}", losses, "")


def _opened(browser: Browser, url: str) -> Page:
    page = browser.new_context(viewport={"width": 1440, "height": 900}).new_page()
    page.goto(url, timeout=120e3)
    return page


def _measure(record: Recorder, browser: Browser, address: Address) -> None:
    host, port = address
    direct = _opened(browser, f"http://{host}:{port}/")
    _measure_page(record, direct, "no link between")
    direct.context.close()
    for rate_bytes_per_s, one_way_s in LINKS:
        with slow_link(address, rate_bytes_per_s, one_way_s) as link:
            page = _opened(browser, link.url)
            name = f"{1e-3 * rate_bytes_per_s:.0f} kB/s, {2e3 * one_way_s:.0f} ms there and back"
            _measure_page(record, page, name)
            page.context.close()


@benchmark("starlette", "uvicorn")
def main(record: Recorder) -> None:
    with (
        tempfile.TemporaryDirectory() as folder,
        textured_hub(Path(folder)) as hub,
        served(hub) as address,
        chromium_browser() as browser,
    ):
        _measure(record, browser, address)
