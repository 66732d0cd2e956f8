"""Live guidance on a phone's page: verdicts a second, and how old they are when they are shown.

Chromium, with a fake camera that plays an approach of 640 x 480 px, and the guide run on the same
computer; the link between them is slowed by Chromium. The picture is the browser's own video; the
overlay is drawn as often as the screen is.

    python -m benchmarks.speed.guide [--seconds 15]
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from playwright.sync_api import Page, sync_playwright

from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.hand_held import HeldPose
from tests.standoff.console.console_rig import CHROMIUM_OPTIONS, chromium_path
from tests.standoff.console.guide.fake_camera import SCREEN, SIZE, camera_options, write_film
from tests.standoff.console.guide.scenes import save, wall
from tests.standoff.console.guide.serving import served_guide

LINKS: dict[str, dict[str, Any]] = {
    "no limit": {},
    "1 MB/s, 100 ms": {"latency": 100, "uploadThroughput": 1e6, "downloadThroughput": 1e6},
}
ROUND_TRIP = """async () => {
    const begin = performance.now();
    await fetch("/stills");
    return performance.now() - begin;
}"""
WATCH = """() => {
    const guide = window.guide;
    const show = guide.show;
    [guide.drawn, guide.allMs] = [0, []];
    guide.show = (told) => { show(told); if (told.found) guide.allMs.push(guide.ageMs); };
}"""
APPROACH = [*np.linspace(0.2, 1, 60), *[1.0] * 40]
_BEGINNING_S = 4.0


def _slow(page: Page, conditions: dict[str, Any]) -> None:
    if conditions:
        protocol = page.context.new_cdp_session(page)
        protocol.send("Network.enable")
        protocol.send("Network.emulateNetworkConditions", {"offline": False, **conditions})


def _measure(record: Recorder, page: Page, name: str, seconds: float) -> None:
    round_trip_ms = min(page.evaluate(ROUND_TRIP) for _ in range(5))
    record.say(f"{name}: an empty answer takes {round_trip_ms:.0f} ms")
    page.click("#use-camera")
    while page.evaluate("window.guide?.answersMs.length ?? 0") <= 3:
        time.sleep(0.1)
    time.sleep(_BEGINNING_S)  # until the rate has adapted
    page.evaluate(WATCH)
    time.sleep(seconds)
    ages = np.array(page.evaluate("window.guide.allMs"))
    drawn = page.evaluate("window.guide.drawn")
    record.say(f"{name}: {len(ages) / seconds:.1f} verdicts a second, "
               f"{np.median(ages):.0f} ms old (95 %: {np.percentile(ages, 95):.0f}), "
               f"{drawn / seconds:.0f} overlays a second")  # fmt: skip
    record.figure(f"verdicts, {name}", len(ages) / seconds, "per s")
    record.figure(f"age, median, {name}", float(np.median(ages)), "ms")
    record.figure(f"age, 95 %, {name}", float(np.percentile(ages, 95)), "ms")
    record.figure(f"overlays, {name}", drawn / seconds, "per s")


@benchmark("playwright")
def main(record: Recorder, *, seconds: Annotated[float, "of each measurement"] = 15.0) -> None:
    """Measure each link."""
    with TemporaryDirectory() as folder, sync_playwright() as playwright:
        film = Path(folder) / "approach.mjpeg"
        write_film(film, wall().resized(SIZE), APPROACH)
        seen = wall().seen([HeldPose()], np.random.default_rng(1))
        reference = save(seen, Path(folder) / "reference.jpg")
        browser = playwright.chromium.launch(
            executable_path=chromium_path(), args=[*CHROMIUM_OPTIONS, *camera_options(film)]
        )
        for name, conditions in LINKS.items():
            with served_guide(reference, Path(folder) / "guided") as guide:
                context = browser.new_context(**SCREEN)
                page = context.new_page()
                page.goto(guide.entry)
                _slow(page, conditions)
                _measure(record, page, name, record.pick(seconds, 5.0))
                context.close()
        browser.close()
