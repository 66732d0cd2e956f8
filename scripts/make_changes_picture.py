"""Make the picture of docs/changes.md: what the report shows of the lantern that was taken away.

Run with ``python -m scripts.make_changes_picture [--folder docs/images]``.
"""

import argparse
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

import standoff
from tests.standoff.console.console_rig import CHROMIUM_OPTIONS, chromium_path

WIDTH_PX, HEIGHT_PX, QUALITY = 980, 900, 85


def main() -> None:
    """Compare the photographs, and take the section with both from the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("docs/images"))
    asked = parser.parse_args()
    photographs = standoff.example_photographs()
    found = standoff.find_changes(photographs.before, photographs.after)
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        found.write(Path(name))
        browser = playwright.chromium.launch(
            executable_path=chromium_path(), args=[*CHROMIUM_OPTIONS]
        )
        page = browser.new_page(viewport={"width": WIDTH_PX, "height": HEIGHT_PX})
        page.goto((Path(name) / "report.html").as_uri())
        section = page.locator("section", has=page.get_by_role("heading", name="Before and after"))
        section.screenshot(path=asked.folder / "report-changes.jpg", quality=QUALITY, type="jpeg")
        browser.close()


if __name__ == "__main__":
    main()
