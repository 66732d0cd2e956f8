"""Make the picture of docs/phone.md: three screens of a phone, in Chromium with a fake camera.

Run with ``python -m scripts.make_phone_pictures [--folder docs/images]``; it takes a minute.
"""

import argparse
import io
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from benchmarks.studies.guided_hand import FOCAL_PER_SIDE, reference_of, scene_levels
from benchmarks.truth.hand_held import HeldPose, Wall
from tests.standoff.console.console_rig import CHROMIUM_OPTIONS, chromium_path
from tests.standoff.console.guide.fake_camera import SCREEN, SIZE, camera_options, write_film
from tests.standoff.console.guide.serving import served_guide

SCENE = "coffee"
GAP_PX, QUALITY = 24, 85
APPROACH = [*np.linspace(0.3, 0.6, 90)]
STILL = (1280, 960)


def main() -> None:
    """Take the three screens and set them side by side."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("docs/images"))
    asked = parser.parse_args()
    rng = np.random.default_rng(4)
    levels = scene_levels(SCENE)
    wall = Wall.of(levels, SIZE, FOCAL_PER_SIDE)
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        reference = reference_of(wall, folder / "last-year.jpg", rng).path
        write_film(folder / "approach.mjpeg", wall, APPROACH)
        changed = levels.copy()
        changed[120:132, 250:262] += 70  # a spot that was not there
        after = Wall.of(np.clip(changed, 0, 255), STILL, FOCAL_PER_SIDE)
        pose = HeldPose(centre=np.array([0.01, 0.0, -0.01]))
        Image.fromarray(after.seen([pose], rng)).save(folder / "today.jpg", quality=92)
        browser = playwright.chromium.launch(
            executable_path=chromium_path(),
            args=[*CHROMIUM_OPTIONS, *camera_options(folder / "approach.mjpeg")],
        )
        with served_guide(reference, folder / "guided") as guide:
            page = browser.new_page(**SCREEN)
            page.set_default_timeout(300_000)
            page.goto(guide.entry)
            screens = [_screen(page)]
            page.click("#use-camera")
            page.wait_for_selector("#arrows li:nth-child(2)")
            screens.append(_screen(page))
            page.click("#end-camera")
            page.set_input_files("#photograph", folder / "today.jpg")
            page.wait_for_selector(".still .blink:visible")
            page.wait_for_selector(".numbers span")
            page.evaluate("document.querySelector('.still').scrollIntoView()")
            page.wait_for_timeout(500)
            screens.append(_screen(page))
        browser.close()
    width = sum(screen.width for screen in screens) + GAP_PX * (len(screens) - 1)
    picture = Image.new("RGB", (width, screens[0].height), "white")
    for number, screen in enumerate(screens):
        picture.paste(screen, (number * (screen.width + GAP_PX), 0))
    picture.save(asked.folder / "phone-guide.jpg", quality=QUALITY)
    print("phone-guide.jpg")


def _screen(page: Page) -> Image.Image:
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


if __name__ == "__main__":
    main()
