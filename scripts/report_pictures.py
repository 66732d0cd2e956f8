"""Pictures of reports, as Chromium shows them."""

from pathlib import Path

from playwright.sync_api import sync_playwright

from tests.standoff.console.console_rig import CHROMIUM_OPTIONS, chromium_path

WIDTH_PX, HEIGHT_PX, QUALITY = 1000, 900, 85


def save_picture(report: Path, picture: Path, *, section: str | None = None) -> None:
    """Write a JPEG of the top of a report, or of its section with a heading."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium_path(), args=[*CHROMIUM_OPTIONS]
        )
        page = browser.new_page(viewport={"width": WIDTH_PX, "height": HEIGHT_PX})
        page.goto(report.resolve().as_uri())
        if section is None:
            page.screenshot(path=picture, quality=QUALITY, type="jpeg")
        else:
            shown = page.locator("section", has=page.get_by_role("heading", name=section))
            shown.screenshot(path=picture, quality=QUALITY, type="jpeg")
        browser.close()
