"""Every page as axe-core judges it, by all of its rules: light and dark, on desk and phone."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("axe_playwright_python", reason="axe-playwright-python is not installed")


from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page

from tests.standoff.console.chromium.pages import DESK, PHONE, live_page, opened_page
from tests.standoff.console.console_rig import text, wait_until
from tests.standoff.console.hub_fixtures import idle_hub, running_hub
from tests.standoff.console.served import served

pytestmark = [pytest.mark.slow(minutes=0.3), pytest.mark.waits]

VIEWS = [
    pytest.param({"viewport": DESK}, id="desk"),
    pytest.param({"viewport": PHONE, "has_touch": True, "is_mobile": True}, id="phone"),
]
NAME = "Wilhelmina Featherstonehaugh-Montgomery of the optics bench!"
TOKEN = "a long enough secret"

View = dict[str, Any]


@pytest.fixture(params=VIEWS)
def view(request: pytest.FixtureRequest) -> View:
    asked: View = request.param
    return asked


def faults(page: Page) -> list[str]:
    """What axe-core finds, whatever its impact: one line for each element."""
    found = Axe().run(page).response["violations"]
    return [
        f"{fault['id']}: {' '.join(map(str, node['target']))}: {node['failureSummary']}"
        for fault in found
        for node in fault["nodes"]
    ]


def judged(page: Page, what: str) -> None:
    """Have a page judged as it is now, in light and in dark colours."""
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme)
        found = faults(page)
        assert found == [], f"{what}, {scheme}: " + "\n".join(found)


def test_a_fault_is_found(browser: Browser, tmp_path: Path) -> None:
    with live_page(browser, idle_hub(tmp_path)) as live:
        judged(live.page, "as it is served")
        live.page.evaluate("document.getElementById('move-to').removeAttribute('aria-label')")
        live.page.evaluate("document.getElementById('move-to').removeAttribute('placeholder')")
        assert [fault.split(":")[0] for fault in faults(live.page)] == ["label"]


def test_the_bench_page_has_no_fault(browser: Browser, tmp_path: Path, view: View) -> None:
    keys: dict[str, Any] = {
        "simulated__width_px": 320,
        "simulated__height_px": 240,
        "camera__frame_rate_hz": 5.0,
    }
    with running_hub(tmp_path, **keys) as hub, live_page(browser, hub, **view) as live:
        page = live.page
        wait_until(lambda: live.asked("standoff.picture.drawn") > 3, "pictures")
        judged(page, "in control")
        page.click("#sweep-box summary")
        for box in ("#watch-field", "#watch-square", "#cross", "#brighten"):
            page.check(box)
        page.focus("#frame")
        page.keyboard.press("ArrowRight")
        page.wait_for_selector("#region:visible")
        page.click("#profile-on")
        wait_until(lambda: page.locator(".corner:visible").count() == 4, "four corners")
        for number in range(4):
            hub.tell(f"Notice {number}: {'what happened, and what to do about it, ' * 4}")
        page.wait_for_selector("#notices li")
        judged(page, "with a region, a sweep and notices")
        page.fill("#exposure", "60000000")
        page.press("#exposure", "Enter")
        page.wait_for_selector("#ask-exposure:visible")
        with opened_page(browser, page.url, name=NAME, **view) as watcher:
            watcher.wait_for_selector("#take-control:visible")
            judged(watcher, "watching")
            watcher.click("#take-control")
            watcher.wait_for_selector("#stop-asking:visible")
            judged(watcher, "asking for control")
            page.wait_for_selector("#asked:visible")
            judged(page, "asked for control and about a long exposure")
            page.click("#refuse")
        page.click("#keep-exposure")
        page.wait_for_selector("#home:enabled")
        page.click("#home")
        wait_until(lambda: text(page, "#stage-homed") == "homed", "homed")
        wait_until(lambda: page.is_enabled("#run"), "free to run")
        page.click("#run")
        page.wait_for_selector("#prompt:visible")
        judged(page, "asked to place a target")
        page.click("#prompt-choices button >> nth=0")
        wait_until(lambda: text(page, "#run-state") == "finished", "finished")
        judged(page, "with a session that is finished")


def test_the_bench_page_without_a_picture_or_a_console_has_no_fault(
    browser: Browser, tmp_path: Path, view: View
) -> None:
    with opened_page(browser, "about:blank", **view) as page:
        with served(idle_hub(tmp_path)) as (host, port):
            page.goto(f"http://{host}:{port}/")
            page.wait_for_selector("body.mine")
            judged(page, "without a picture")
        page.wait_for_selector("#alert-connection:visible")
        page.click("#stop")
        page.wait_for_selector("#alert-stop:visible")
        judged(page, "without a console")


def test_the_bench_page_of_a_lost_camera_has_no_fault(
    browser: Browser, tmp_path: Path, view: View
) -> None:
    with running_hub(tmp_path) as hub, live_page(browser, hub, **view) as live:
        page = live.page
        wait_until(lambda: live.asked("standoff.picture.drawn") > 3, "pictures")
        hub.camera._take_turn()  # no more pictures
        try:
            page.wait_for_selector(".big.stale")
            judged(page, "with figures that are old")
            wait_until(lambda: text(page, "#focus-percent") == "–", "nothing is shown")
            judged(page, "with figures that are nothing")
        finally:
            hub.camera._give_turn()
        wait_until(lambda: not page.is_visible("#no-picture"), "pictures again")
        page.evaluate(KEEP_ALERTS)
        judged(page, "with every alert")


KEEP_ALERTS = """() => {
    for (const alert of document.querySelectorAll("#alerts > .alert")) {
        alert.removeAttribute("hidden");
        for (const span of alert.querySelectorAll(".what, .remedy, #asked-by")) span.textContent ||= "What happened.";
        Object.defineProperty(alert, "hidden", { set() {}, get() { return false; } });
    }
}"""  # noqa: E501  # a line of the page's script


def test_the_pages_beside_the_bench_have_no_fault(
    browser: Browser, tmp_path: Path, session_dir: Path, view: View
) -> None:
    hub = idle_hub(tmp_path)
    with live_page(browser, hub, **view) as live:
        page, home = live.page, live.page.url
        page.goto(f"{home}sessions")
        judged(page, "no sessions")
        hub.sessions.folder.mkdir(exist_ok=True)
        session_dir.rename(hub.sessions.folder / "first")
        for path in ("sessions", "sessions/first", "doctor", "plans/edit", "plans/edit?plan=two"):
            page.goto(f"{home}{path}")
            page.wait_for_selector("body.mine")
            judged(page, path)
        page.fill("[name=heights] >> nth=0", "x")
        page.wait_for_selector("#draft-fault:visible")
        judged(page, "a plan with a fault")
        page.goto(f"{home}sessions/first/captures/3")
        wait_until(lambda: "pixels" in text(page, "#reading"), "its levels")
        judged(page, "a capture")
        page.goto(f"{home}nothing")
        judged(page, "a fault")
        live.faults.clear()  # the browser's own line about the status of the page that is none


@pytest.mark.parametrize("token", [None, TOKEN])
def test_the_pages_that_let_nobody_in_have_no_fault(
    browser: Browser, tmp_path: Path, view: View, token: str | None
) -> None:
    with served(idle_hub(tmp_path), token=token) as (host, port):
        # A name that resolves to this computer, but is not one of it.
        name = host if token else "console.localhost"
        with opened_page(browser, f"http://{name}:{port}/", name=NAME, **view) as page:
            assert "standoff console" in page.content()
            judged(page, "refused")
            if token:
                page.fill("[name=token]", "wrong")
                page.click("button")
                page.wait_for_selector("text=Wrong token.")
                judged(page, "a wrong token")
