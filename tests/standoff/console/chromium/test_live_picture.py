"""The tools of the live picture in a real browser, on pictures whose every level is known."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


from playwright.sync_api import Browser

from acquisition.devices import FrameImage
from acquisition.focus import Region
from standoff.console.web._live_sockets import StateCache
from tests.standoff.console.chromium.pages import PHONE, LivePage, live_page
from tests.standoff.console.console_rig import wait_until
from tests.standoff.console.hub_fixtures import idle_hub, running_hub

pytestmark = [pytest.mark.slow, pytest.mark.waits]

ROWS, COLS = 90, 120


def numbered_dn() -> FrameImage:
    """A picture whose levels differ from pixel to pixel: 10 a column, 23 a row."""
    y_px, x_px = np.mgrid[:ROWS, :COLS]
    return np.asarray(100 + 10 * x_px + 23 * y_px, dtype=np.uint16)


@pytest.fixture
def live(browser: Browser, tmp_path: Path) -> Iterator[LivePage]:
    with live_page(browser, idle_hub(tmp_path)) as made:
        made.show(numbered_dn())
        yield made


def drag(live: LivePage, start: tuple[float, float], end: tuple[float, float], button: str) -> None:
    mouse = live.page.mouse
    mouse.move(*live.on_screen(*start))
    mouse.down(button="middle" if button == "middle" else "left")
    mouse.move(*live.on_screen(*end), steps=3)
    mouse.up(button="middle" if button == "middle" else "left")


def zoom_in(live: LivePage, x_px: float, y_px: float) -> None:
    """Turn the wheel over a place of the picture until nothing grows any more."""
    x, y = live.on_screen(x_px, y_px)
    live.page.mouse.move(int(x), int(y))  # a wheel's place comes in whole pixels of the screen
    for _ in range(40):
        live.page.mouse.wheel(0, -300)
    wait_until(lambda: live.asked("standoff.view.scale") == 64, "the largest scale")


def test_the_wheel_zooms_about_the_cursor_down_to_single_pixels(live: LivePage) -> None:
    x, y = live.on_screen(30.5, 20.5)
    point = f"standoff.view.at({{clientX: {int(x)}, clientY: {int(y)}}})"
    before = live.asked(point)
    zoom_in(live, 30.5, 20.5)
    assert live.asked(point) == pytest.approx(before, abs=1e-3)
    style = "getComputedStyle(standoff.picture.canvas).imageRendering"
    assert live.asked(style) == "pixelated"
    assert live.page.text_content("#zoom") == "6400 %"
    for _ in range(40):
        live.page.mouse.wheel(0, 300)
    wait_until(lambda: live.asked("standoff.view.scale") < 2, "zoomed out")
    # It cannot be lost from sight: what is smaller than the frame stands in its middle.
    left, _ = live.on_screen(0, 0)
    right, _ = live.on_screen(COLS, 0)
    box = live.page.locator("#frame").bounding_box()
    assert box is not None
    assert (left + right) / 2 == pytest.approx(box["x"] + box["width"] / 2, abs=0.5)


def test_buttons_and_keys_zoom_as_they_say(live: LivePage) -> None:
    fitted = live.asked("standoff.view.scale")
    live.page.click("#zoom-actual")
    assert live.asked("standoff.view.scale") == 1
    live.page.keyboard.press("0")
    assert live.asked("standoff.view.scale") == pytest.approx(fitted)
    live.page.keyboard.press("+")
    assert live.asked("standoff.view.scale") == pytest.approx(1.5 * fitted)
    live.page.keyboard.press("-")
    live.page.keyboard.press("1")
    assert live.asked("standoff.view.scale") == 1
    live.page.click("#zoom-fit")
    # Typing a number is no zoom.
    live.page.fill("#session-name", "")
    live.page.type("#session-name", "10-1")
    assert live.asked("standoff.view.scale") == pytest.approx(fitted)


@pytest.mark.parametrize("button", ["middle", "space"])
def test_the_picture_is_panned_and_no_region_is_drawn(live: LivePage, button: str) -> None:
    zoom_in(live, 60, 45)
    if button == "space":
        live.page.focus("#frame")
        live.page.keyboard.down(" ")
    x, y = live.on_screen(60, 45)
    drag(live, (60, 45), (62, 46), button)
    assert live.on_screen(60, 45) == pytest.approx((x + 128, y + 64), abs=0.01)
    assert live.hub.picture.facts.region is None
    assert not live.page.is_visible("#region")


def test_a_region_drawn_at_high_zoom_is_in_pixels_of_the_picture(live: LivePage) -> None:
    zoom_in(live, 60, 45)
    for _ in range(3):
        live.page.keyboard.press("-")
    drag(live, (55, 41), (67, 50), "left")
    wanted = Region(x_px=55, y_px=41, width_px=12, height_px=9)
    wait_until(lambda: live.hub.picture.facts.region == wanted, "the region is measured")
    box = live.page.locator("#region").bounding_box()
    assert box is not None
    assert (box["x"], box["y"]) == pytest.approx(live.on_screen(55, 41), abs=0.5)
    live.page.click("#zoom-fit")
    box = live.page.locator("#region").bounding_box()
    assert box is not None
    assert (box["x"], box["y"]) == pytest.approx(live.on_screen(55, 41), abs=0.5)


def test_two_fingers_zoom_and_pan_and_draw_no_region(browser: Browser, tmp_path: Path) -> None:
    phone = {"viewport": PHONE, "has_touch": True, "is_mobile": True}
    with live_page(browser, idle_hub(tmp_path), **phone) as live:
        live.show(numbered_dn())
        fitted = live.asked("standoff.view.scale")
        x, y = live.on_screen(60, 45)
        touch = live.page.context.new_cdp_session(live.page)

        def fingers(kind: str, *offsets: float) -> None:
            points = [{"x": x + each, "y": y, "id": at} for at, each in enumerate(offsets)]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        fingers("touchStart", -20.0)
        fingers("touchMove", -25.0)
        fingers("touchStart", -25.0, 25.0)
        fingers("touchMove", -75.0, 75.0)
        fingers("touchEnd")
        wait_until(
            lambda: live.asked("standoff.view.scale") == pytest.approx(3 * fitted, rel=1e-3),
            "three times as large",
        )
        assert live.on_screen(60, 45) == pytest.approx((x, y), abs=1)
        assert live.hub.picture.facts.region is None
        assert not live.page.is_visible("#region")


def test_the_picture_has_three_fifths_of_the_window_and_nothing_goes_sideways(
    live: LivePage,
) -> None:
    live.show(np.zeros((580, 780), dtype=np.uint16))
    height = "document.getElementById('picture').getBoundingClientRect().height"
    wait_until(lambda: live.asked(height) >= 0.6 * 900, "60 % of 900 px")
    bottom = "document.getElementById('picture').getBoundingClientRect().bottom"
    assert live.asked(bottom) < 900


def reading(live: LivePage) -> str:
    return live.page.text_content("#probe") or ""


def test_the_level_under_the_cursor_is_that_of_the_frame(live: LivePage) -> None:
    live.page.mouse.move(*live.on_screen(37.5, 5.5))
    level = 100 + 10 * 37 + 23 * 5
    wanted = f"x 37, y 5 px · {level} DN ({100 * level / 4095:.1f} %) · mean of 5 × 5: {level}.0 DN"
    wait_until(lambda: reading(live) == wanted, wanted)
    dark = np.zeros((ROWS, COLS), dtype=np.uint16)
    live.show(dark)  # also of a cursor that rests
    wait_until(lambda: " 0 DN (0.0 %)" in reading(live), "the level of the newest frame")
    live.page.mouse.move(5, 5)
    wait_until(lambda: live.page.is_hidden("#probe"), "nothing is read outside the picture")


def test_levels_are_read_with_the_keyboard(live: LivePage) -> None:
    live.page.focus("#frame")
    for _ in range(3):
        live.page.keyboard.press("Alt+ArrowLeft")
    live.page.keyboard.press("Alt+Shift+ArrowDown")
    x_px, y_px = COLS // 2 - 3, ROWS // 2 + 10
    wanted = f"x {x_px}, y {y_px}: {100 + 10 * x_px + 23 * y_px} DN"
    wait_until(lambda: live.page.text_content("#probe-spoken") == wanted, "spoken once")
    assert live.hub.picture.facts.region is None  # arrows without Alt move the region


def test_the_level_is_spoken_of_the_last_step_though_the_answer_to_an_earlier_one_comes_late(
    live: LivePage,
) -> None:
    live.page.focus("#frame")
    live.asked(
        """() => { window.late = []; const { connection } = standoff;
        const pass = connection.dispatchEvent;
        connection.dispatchEvent = function (event) {
          const isLate = event.type === "probe" && window.late;
          return isLate ? window.late.push(event) : pass.call(this, event);
        };
        window.comeNow = () => {
          const late = window.late;
          window.late = null;
          for (const event of late) pass.call(connection, event);
        }; }"""
    )
    live.page.keyboard.press("Alt+ArrowLeft")
    wait_until(lambda: live.asked("window.late.length") > 0, "the level of the first step")
    live.page.keyboard.press("Alt+ArrowLeft")
    live.asked("window.comeNow()")
    x_px, y_px = COLS // 2 - 2, ROWS // 2
    wanted = f"x {x_px}, y {y_px}: {100 + 10 * x_px + 23 * y_px} DN"
    wait_until(lambda: live.page.text_content("#probe-spoken") == wanted, "spoken of the second")


def test_a_page_asks_for_levels_ten_times_a_second_at_most(live: LivePage) -> None:
    live.asked(
        """() => { window.sent = {}; const { connection } = standoff; const send = connection.send;
        connection.send = function (what, fields) {
          (window.sent[what] ??= []).push(performance.now()); return send.call(this, what, fields);
        }; }"""
    )
    live.page.keyboard.press("l")
    for turn in range(60):
        live.page.mouse.move(*live.on_screen(20 + turn, 30))
    wait_until(lambda: len(live.asked("window.sent.profile ?? []")) > 3, "several profiles")
    for what, least_ms in (("probe", 100), ("profile", 200)):
        times_ms = live.asked(f"window.sent.{what}")
        # Timers of a busy machine come late, and then sooner after each other.
        assert len(times_ms) <= (times_ms[-1] - times_ms[0]) / least_ms + 2


def test_the_profile_of_a_dragged_line_shows_its_levels(live: LivePage) -> None:
    live.asked(
        "() => standoff.connection.addEventListener('profile', (e) => window.answered = e.detail)"
    )
    live.page.click("#profile-on")
    drag(live, (20.5, 30.5), (70.5, 30.5), "left")

    def is_measured() -> bool:
        found = live.asked("window.answered")
        return bool(found) and found["length_px"] == pytest.approx(50, abs=0.2)

    wait_until(is_measured, "the profile of the line")
    levels = live.asked("window.answered.levels_dn")
    start = 100 + 10 * 20 + 23 * 30
    # Within a quarter of a pixel: the mouse stands in whole pixels of the screen.
    assert levels[0] == pytest.approx(start, abs=9)
    assert levels[-1] == pytest.approx(start + 500, abs=9)
    assert np.diff(levels[:50]) == pytest.approx(10, abs=0.2)
    assert live.page.locator("#profile").bounding_box() is not None
    assert live.hub.picture.facts.region is None
    live.page.focus("#frame")
    live.page.keyboard.press("ArrowDown")
    wait_until(
        lambda: live.asked("window.answered.levels_dn[0]") == pytest.approx(levels[0] + 115, abs=1),
        "the line five pixels lower",
    )
    live.page.keyboard.press("l")
    assert live.page.is_hidden("#profile-panel")


LIT = """() => {
    const canvas = document.getElementById("overlay");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return data.some((value) => value > 0);
}"""


def test_grid_and_cross_hair_are_drawn_over_the_picture_not_in_it(live: LivePage) -> None:
    assert not live.asked(LIT)
    live.page.keyboard.press("c")
    assert live.page.is_checked("#cross")
    assert live.asked(LIT)
    live.page.keyboard.press("c")
    assert not live.asked(LIT)
    for parts in ("3", "8", "0"):
        live.page.keyboard.press("g")
        assert live.page.input_value("#grid") == parts
        assert live.asked(LIT) == (parts != "0")


def told(kind: str, document: str) -> str:
    """Expression by which a page hears a message of the console once more."""
    return f"standoff.connection.dispatchEvent(new CustomEvent('{kind}', {{ detail: {document} }}))"


@pytest.mark.parametrize("box", ["watch-field", "watch-square"])
def test_a_choice_is_not_undone_by_what_the_console_said_before_it(
    live: LivePage, box: str
) -> None:
    again = told("measure", StateCache(live.hub).measure(live.hub))
    chosen = f"document.getElementById('{box}')"
    # In one go: a second later what the console says counts, as it may have refused.
    assert live.asked(f"({chosen}.click(), {again}, {chosen}.checked)")
    wait_until(lambda: not live.asked(f"({again}, {chosen}.checked)"), "it counts later")


def test_exposure_is_lengthened_twice_though_the_console_told_the_old_one_between(
    browser: Browser, tmp_path: Path
) -> None:
    with running_hub(tmp_path) as hub, live_page(browser, hub) as live:
        wait_until(lambda: live.page.is_enabled("#exposure"), "the camera is ready")
        assert hub.camera.settings is not None
        old_us = hub.camera.settings.exposure_us
        heard = live.asked(
            "new Promise(done => standoff.connection.addEventListener("
            "'state', event => done(JSON.stringify(event.detail)), { once: true }))"
        )
        pressed = "document.querySelector('#exposure-form [data-scale=\"1.25\"]').click()"
        live.asked(f"({pressed}, {told('state', heard)}, {pressed}, {told('state', heard)})")
        wait_until(
            lambda: (
                hub.camera.settings is not None
                and hub.camera.settings.exposure_us == pytest.approx(1.25**2 * old_us, rel=1e-3)
            ),
            "1.25 times as long, twice",
        )


def test_exposure_is_found_and_set_by_a_slider_and_a_snapshot_is_downloaded(
    browser: Browser,
    tmp_path: Path,
) -> None:
    with running_hub(tmp_path) as hub, live_page(browser, hub) as live:
        page = live.page
        page.click("#auto-exposure")
        wait_until(
            lambda: "brightest parts reach" in (page.text_content("#notices") or ""), "found"
        )
        wait_until(lambda: page.is_enabled("#auto-exposure"), "the job has ended")
        assert hub.camera.settings is not None
        found_us = hub.camera.settings.exposure_us
        page.focus("#slider")
        # From 21 us to 60 s in a thousand equal ratios.
        step = float((60e6 / 21) ** 0.001)
        for _ in range(20):
            page.keyboard.press("ArrowLeft")
        wanted_us = found_us / step**20
        wait_until(
            lambda: (
                hub.camera.settings is not None
                and hub.camera.settings.exposure_us == pytest.approx(wanted_us, rel=0.01 + step - 1)
            ),
            "20 steps shorter",
        )
        assert float(page.input_value("#exposure")) == pytest.approx(wanted_us, rel=step - 1 + 0.01)
        page.keyboard.press("n")
        page.wait_for_selector("#snapshot-link:visible")
        with page.expect_download() as download:
            page.click("#snapshot-link")
        name = hub.snapshots.latest
        assert download.value.suggested_filename == name
        assert Path(download.value.path()).read_bytes() == hub.snapshots.read(name)
