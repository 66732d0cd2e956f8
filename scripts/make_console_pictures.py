"""Make the pictures of docs/console.md: the console over a practice bench, in Chromium.

Run with ``python -m scripts.make_console_pictures [--folder docs/images]``; it takes some minutes.
"""

import argparse
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page

from tests.standoff.console.console_rig import (
    ConsoleRig,
    console_rig,
    move_to,
    text,
    wait_at,
    wait_until,
)

BENCH = (
    "simulated.width_px=780",
    "simulated.height_px=580",
    "simulated.focus_distance_mm=300.0",
    "simulated.f_number=1.0",
)
PLAN = """
schema = "standoff.plan/1"
name = "edges"
heights_mm = [284.0, 287.0, 290.0]
frames_per_capture = 4

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0, 50.0, 95.0]
"""
WIDTH_PX, QUALITY = 1280, 82
DRAWN = "standoff.picture.drawn"


class _Photographer:
    """Stores what pages show in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def take(self, page: Page, name: str, height_px: int) -> None:
        """Store the upper part of a page, once nothing is told any more."""
        page.set_viewport_size({"width": WIDTH_PX, "height": height_px})
        page.evaluate("scrollTo(0, 0)")
        wait_until(lambda: page.locator("#notices li").count() == 0, "no notices")
        page.wait_for_timeout(600)
        page.screenshot(path=self._folder / f"console-{name}.jpg", quality=QUALITY, type="jpeg")
        print(f"console-{name}.jpg")


def _see(page: Page, pictures: int) -> None:
    """Wait for new pictures: the practice camera takes its time for each new scene."""
    drawn = page.evaluate(DRAWN)
    wait_until(lambda: page.evaluate(DRAWN) >= drawn + pictures, "new pictures")


def _focus_about(page: Page, peak_mm: float) -> None:
    """Leave a trace of the focus to both sides of its peak."""
    for height_mm in (-6, -3, 0, 3, 6, 3, 0):
        move_to(page, peak_mm + height_mm)
        wait_at(page, peak_mm + height_mm)
        _see(page, 12)


def _draw_region(page: Page) -> None:
    """Draw a region over the edge in the middle."""
    bounds = page.locator("#picture").bounding_box()
    assert bounds is not None
    for share, act in (((0.47, 0.36), page.mouse.down), ((0.61, 0.58), page.mouse.up)):
        page.mouse.move(
            bounds["x"] + share[0] * bounds["width"], bounds["y"] + share[1] * bounds["height"]
        )
        act()
    wait_until(lambda: page.is_visible("#edge"), "an edge is measured")


def _align(rig: ConsoleRig, page: Page) -> None:
    """Show the edges of a reference over the picture of a camera that has moved since."""
    rig.tell_mock("place coins")
    page.uncheck("#watch-field")
    page.click("#clear-region")
    _see(page, 40)
    page.click("#pose-here")
    move_to(page, 281.0)
    wait_at(page, 281.0)
    _see(page, 20)
    page.select_option("#reference-how", "edges")
    page.wait_for_selector("#reference-edges:visible")


def _run_session(rig: ConsoleRig, page: Page, photographer: _Photographer) -> None:
    """Capture the plan; the operator places each target when asked."""
    page.fill("#session-name", "monday")
    page.click("#run")
    for number, degrees in enumerate((5, 50, 95)):
        wait_until(lambda: page.is_visible("#prompt"), "asked to place")
        if number == 1:
            photographer.take(page, "prompt", 940)
        rig.tell_mock(f"place edge {degrees}")
        page.click("#prompt-choices button >> nth=0")
        wait_until(lambda: not page.is_visible("#prompt"), "answered")
        if number == 1:
            wait_until(lambda: page.locator("#plan-table tr.done").count() >= 4, "some are done")
            page.click("#pause")
            wait_until(lambda: text(page, "#run-state") == "paused", "paused")
            photographer.take(page, "session", 940)
            page.click("#go-on")
    wait_until(lambda: text(page, "#run-state") == "finished", "finished")


def _look_through_results(rig: ConsoleRig, page: Page, photographer: _Photographer) -> None:
    """Calibrate, and show what there is of the session."""
    page.goto(f"{rig.url}sessions")
    photographer.take(page, "sessions", 330)
    page.click("text=monday")
    page.click("button[data-result=calibrate]")
    page.wait_for_selector("text=σx")
    photographer.take(page, "one-session", 940)
    page.goto(f"{rig.url}doctor")
    photographer.take(page, "doctor", 500)


@contextmanager
def _dark_page(rig: ConsoleRig) -> Iterator[Page]:
    """Open the bench page in dark colours."""
    with rig.page(color_scheme="dark", viewport={"width": WIDTH_PX, "height": 940}) as page:
        wait_until(lambda: page.evaluate(DRAWN) > 5, "pictures")
        yield page


def main() -> None:
    """Make them all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("docs/images"))
    photographer = _Photographer(parser.parse_args().folder)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "edges.toml").write_text(PLAN)
        with console_rig(folder, mock_keys=BENCH) as rig:
            rig.tell_mock("place edge 5")
            with rig.operator(viewport={"width": WIDTH_PX, "height": 1060}) as page:
                page.select_option("#plan", "edges")
                _run_session(rig, page, photographer)
                rig.tell_mock("place edge 5")
                _see(page, 40)
                _draw_region(page)
                page.check("#watch-field")
                _focus_about(page, 287.5)
                page.hover("#picture", position={"x": 300, "y": 400})
                photographer.take(page, "bench", 1060)
                _align(rig, page)
                photographer.take(page, "align", 900)
                _look_through_results(rig, page, photographer)
            with _dark_page(rig) as page:
                rig.tell_mock("fault is_dead=true")
                page.wait_for_selector("#alert-camera:visible")
                photographer.take(page, "lost-dark", 940)


if __name__ == "__main__":
    main()
