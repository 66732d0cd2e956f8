"""Header, STOP and notices where there is little room: on a phone, held upright and on its side."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


from playwright.sync_api import Browser, Page

from standoff.console.devices import DeviceStatus
from tests.standoff.console.chromium.pages import DESK, PHONE, opened_page
from tests.standoff.console.console_rig import text, wait_until
from tests.standoff.console.hub_fixtures import idle_hub, running_hub
from tests.standoff.console.served import served

pytestmark = [pytest.mark.slow, pytest.mark.waits]

SIDE = {"width": 844, "height": 390}
MOST_PX = 110.0
NAME = "Wilhelmina Featherstonehaugh-Montgomery of the optics bench!"
TOUCH: dict[str, Any] = {"has_touch": True, "is_mobile": True}
SIZES: tuple[dict[str, Any], ...] = (
    {"viewport": DESK},
    {"viewport": {"width": 1000, "height": 700}},
    {"viewport": {"width": 600, "height": 900}},
    {"viewport": PHONE} | TOUCH,
    {"viewport": SIDE} | TOUCH,
)
PATHS = ("", "photographs", "sessions", "doctor", "plans/edit", "nothing")

STOP_IS_HIT = """() => {
    const stop = document.getElementById("stop");
    const { left, top, width, height } = stop.getBoundingClientRect();
    const corners = [[4, 4], [width - 4, 4], [4, height - 4], [width - 4, height - 4], [width / 2, height / 2]];
    return corners.every(([x, y]) => stop.contains(document.elementFromPoint(left + x, top + y)));
}"""  # noqa: E501  # a line of a script of the page

COVERED = """() => {
    const notices = document.getElementById("notices");
    const covered = [];
    const look = (control) => {
        const { left, top, width, height } = control.getBoundingClientRect();
        const points = [[.5, .5], [.1, .1], [.9, .1], [.1, .9], [.9, .9]];
        return points.some(([x, y]) => notices.contains(document.elementFromPoint(left + x * width, top + y * height)));
    };
    for (const control of document.querySelectorAll("button, input, select, a[href], summary")) {
        if (!control.getClientRects().length) continue;
        control.scrollIntoView({ block: "nearest" });
        if (look(control)) covered.push(control.id || control.textContent);
    }
    return covered;
}"""  # noqa: E501  # a line of a script of the page

HIT = """() => {
    scrollTo(0, 0);
    const hit = [];
    for (let y = 2; y < innerHeight; y += 9) for (let x = 2; x < innerWidth; x += 9) {
        const control = document.elementFromPoint(x, y)?.closest("button, input, select, a, summary, label");
        if (control) hit.push(`${x} ${y} ${control.id || control.textContent}`);
    }
    return hit;
}"""  # noqa: E501  # a line of a script of the page


@contextmanager
def connected(browser: Browser, url: str, **options: Any) -> Iterator[Page]:
    with opened_page(browser, url, name=NAME, **options) as page:
        wait_until(lambda: text(page, "#control-text") != "connecting …", "connected")
        yield page


def assert_low(page: Page, state: str) -> None:
    """The header is low, and all of STOP is hit wherever the page is scrolled to."""
    for scrolled in ("0", "document.body.scrollHeight / 2", "document.body.scrollHeight"):
        page.evaluate(f"scrollTo(0, {scrolled})")
        box = page.locator("header").bounding_box()
        assert box is not None
        assert box["y"] == 0, state
        assert box["height"] <= MOST_PX, state
        assert page.evaluate(STOP_IS_HIT), state
    width = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert width[0] <= width[1], state  # nothing beside the screen
    for button in page.locator("header button:visible").all():
        box = button.bounding_box()
        assert box is not None
        assert box["x"] >= 0, state
        assert box["x"] + box["width"] <= width[1], state


@pytest.mark.parametrize("size", [PHONE, SIDE], ids=["upright", "on its side"])
def test_the_header_of_a_phone_is_low_in_every_state(
    browser: Browser, tmp_path: Path, size: dict[str, int]
) -> None:
    hub = idle_hub(tmp_path)
    phone = {"viewport": size} | TOUCH
    with served(hub) as (host, port):
        url = f"http://{host}:{port}/"
        with connected(browser, url, **phone) as first, connected(browser, url, **phone) as second:
            first.wait_for_selector("body.mine")
            assert_low(first, "in control")
            first.wait_for_selector("#release-control:visible")
            assert_low(first, "in control of several")
            second.wait_for_selector("#take-control:visible")
            assert_low(second, "watching")
            second.click("#take-control")
            second.wait_for_selector("#stop-asking:visible")
            second.evaluate("document.getElementById('chip-latency').hidden = false")
            assert_low(second, "asking, late")
            first.wait_for_selector("#asked:visible")
            assert_low(first, "asked")
            hub.camera.status = DeviceStatus(
                state="lost", text="the camera is gone", remedy="Plug it in. " * 12
            )
            first.wait_for_selector("#alert-camera:visible")
            assert_low(first, "asked, and the camera lost")
            first.click("#grant")
            second.wait_for_selector("body.mine")
            assert_low(second, "in control, and the camera lost")
            for path in PATHS:
                second.goto(f"{url}{path}")
                wait_until(lambda: text(second, "#control-text") != "connecting …", "connected")
                assert_low(second, path)


@pytest.mark.parametrize(
    ("path", "options"),
    [
        pytest.param(path, options, id=f"{path or 'bench'} {options['viewport']['width']}")
        for path in ("", "plans/edit")
        for options in SIZES
    ],
)
def test_four_long_notices_cover_no_control(
    browser: Browser, tmp_path: Path, path: str, options: dict[str, Any]
) -> None:
    with (
        running_hub(tmp_path) as hub,
        served(hub) as (host, port),
        connected(browser, f"http://{host}:{port}/{path}", **options) as page,
    ):
        page.wait_for_selector("body.mine")
        page.evaluate("for (const each of document.querySelectorAll('details')) each.open = true")
        page.wait_for_timeout(300)
        before = page.evaluate(HIT)
        for number in range(4):
            hub.tell(f"Notice {number}: {'what happened on the bench and what to do, ' * 8}")
        wait_until(lambda: page.locator("#notices li").count() == 4, "all are told")
        assert page.evaluate(HIT) == before  # what a click meets is as without them
        assert page.evaluate(COVERED) == []
        assert page.evaluate(STOP_IS_HIT)
        assert page.is_visible("#notices li >> nth=0")
        assert text(page, "#notices li >> nth=0").startswith("Notice 3")
