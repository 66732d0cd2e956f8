"""The whole on a phone's screen: Chromium, whose camera plays an approach."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("axe_playwright_python", reason="axe-playwright-python is not installed")


from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, Request, Route, sync_playwright

import standoff
from standoff.console.bench_hub import ConsoleHub
from tests.standoff.console.console_rig import CHROMIUM_OPTIONS, chromium_path, wait_until
from tests.standoff.console.guide.fake_camera import SCREEN, SIZE, camera_options, write_film
from tests.standoff.console.guide.scenes import Stills, wall
from tests.standoff.console.guide.serving import TOKEN, ServedGuide, served_guide
from tests.standoff.console.hub_fixtures import DEADLINE_S
from tests.standoff.console.served import served

pytestmark = [pytest.mark.slow(minutes=1.0), pytest.mark.waits]

APPROACH = [*np.linspace(0.2, 1, 20), *[1.0] * 40]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    film = tmp_path_factory.mktemp("film") / "approach.mjpeg"
    write_film(film, wall().resized(SIZE), APPROACH)
    with sync_playwright() as playwright:
        options = [*CHROMIUM_OPTIONS, *camera_options(film)]
        opened = playwright.chromium.launch(executable_path=chromium_path(), args=options)
        yield opened
        opened.close()


@pytest.fixture
def guide(stills: Stills, tmp_path: Path) -> Iterator[ServedGuide]:
    with served_guide(stills.reference, tmp_path / "guided") as made:
        yield made


@contextmanager
def opened(browser: Browser, guide: ServedGuide, **options: Any) -> Iterator[Page]:
    """A paired phone; a fault in a script of the page fails the test."""
    faults: list[str] = []
    context = browser.new_context(**SCREEN, **options)
    try:
        page = context.new_page()
        page.set_default_timeout(1e3 * DEADLINE_S)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(guide.entry)
        page.wait_for_selector("#use-camera:enabled")
        yield page
    finally:
        context.close()
    assert faults == []


def violations(page: Page) -> list[str]:
    found = Axe().run(page).response["violations"]
    return [
        f"{fault['id']}: {node['target']}: {node['failureSummary']}"
        for fault in found
        for node in fault["nodes"]
    ]


def assert_fits(page: Page) -> None:
    width = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert width[0] <= width[1]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_camera_guides_to_a_still_whose_changes_are_blinked(
    browser: Browser, guide: ServedGuide, scheme: str
) -> None:
    with opened(browser, guide, color_scheme=scheme) as page:
        assert violations(page) == []
        assert_fits(page)
        page.click("#use-camera")
        page.wait_for_selector("#verdict.no >> text=further away")
        page.wait_for_selector("#verdict.no:has-text('further away') ~ #arrows li")
        assert page.locator("#arrows li").count() <= 2
        assert_fits(page)
        page.wait_for_selector("#verdict.go")
        assert violations(page) == []
        assert page.locator("#arrows li").count() == 0
        assert page.evaluate("window.guide.drawn") > 0
        if scheme == "dark":
            return
        page.click("#shutter")
        page.wait_for_selector(".still .tag.go")
        page.wait_for_selector(".still .blink:visible")
        hold = page.locator(".hold")
        hold.dispatch_event("pointerdown")
        assert page.locator(".pair.past .which").inner_text() == "before"
        hold.dispatch_event("pointerup")
        assert page.locator(".pair .which").inner_text() == "after"
        assert violations(page) == []
        assert_fits(page)
        page.click("#end-camera")
        assert page.is_visible("#start")
    (record,) = guide.store.records()
    assert standoff.verify_session(guide.store.folder / record.name).is_ok


@pytest.fixture
def not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is tested is how a still arrives."""
    monkeypatch.setattr(
        "standoff.console.guide._stills.StillStore._compared", lambda _store, _, record: record
    )


def test_a_change_of_colour_is_told_by_its_colour_difference(
    browser: Browser, guide: ServedGuide, stills: Stills, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = {"x": 0.25, "y": 0.5, "radius": 0.02, "area_px": 209.0, "significance": 69.8}
    colour = at | {"what": "colour", "side": "brighter", "amplitude_dn": 6.3e-17, "delta_e": 3.33}
    brighter = at | {"what": "new", "side": "brighter", "amplitude_dn": 21.2, "delta_e": None}
    earlier = at | {"what": "darker", "side": "darker", "amplitude_dn": -4.0}
    listed = (colour, brighter, earlier)
    monkeypatch.setattr(
        "standoff.console.guide._stills.StillStore._compared",
        lambda _store, _, record: replace(record, state="done", changes=listed),
    )
    with opened(browser, guide) as page:
        page.route("**/*.jpg?*", lambda route: route.fulfill(path=stills.again))
        page.set_input_files("#photograph", stills.again)
        page.wait_for_selector(".still .blink:visible")
        where = "209 px, 25 % from the left, 50 % from the top"
        assert page.locator(".still .changes li").all_inner_texts() == [
            f"another colour, ΔE 3.3, {where}",
            f"new, brighter by 21 DN, {where}",
            f"darker by 4.0 DN, {where}",
        ]


@pytest.mark.usefixtures("not_compared")
def test_a_link_that_is_lost_loses_nothing(
    browser: Browser, guide: ServedGuide, stills: Stills
) -> None:
    lost: list[str] = []

    def lose_two(route: Route, request: Request) -> None:
        if request.method == "PUT" and len(lost) < 2:
            lost.append(request.url)
            route.abort()
        else:
            route.continue_()

    with opened(browser, guide) as page:
        page.route("**/stills/**", lose_two)
        page.set_input_files("#photograph", stills.again)
        page.wait_for_selector(".still .tag.go")
    assert len(lost) == 2
    (record,) = guide.store.records()
    kept = guide.store.folder / record.name / "results" / "photograph.jpg"
    assert kept.read_bytes() == stills.again.read_bytes()


WAITING = """() => new Promise((resolve) => {
    const asked = indexedDB.open("standoff-guide", 1);
    asked.onsuccess = () => {
        const store = asked.result.transaction("waiting").objectStore("waiting");
        store.count().onsuccess = (event) => resolve(event.target.result);
    };
})"""


UNANSWERED = """() => {
    window.before = window.fetch;
    window.fetch = (path, { signal }) => new Promise((resolve, reject) => {
        signal.addEventListener("abort", () => reject(signal.reason));
    });
}"""
"""As where packets vanish, until the page itself gives up."""


def test_green_goes_as_soon_as_nothing_is_known_any_more(
    browser: Browser, guide: ServedGuide
) -> None:
    with opened(browser, guide) as page:
        page.click("#use-camera")
        page.wait_for_selector("#verdict.go")
        page.evaluate(UNANSWERED)
        # An answer that was on its way may still come.
        page.wait_for_selector("#verdict.no:has-text('Waiting for the computer') >> text=…")
        page.wait_for_function("document.querySelectorAll('#arrows li').length === 0")
        page.wait_for_selector("#fault >> text=The link to the computer is lost")
        page.evaluate("() => { window.fetch = window.before; }")
        page.wait_for_selector("#verdict.go")
        page.context.clear_cookies()  # as after the guide was started again
        page.wait_for_selector("#fault >> text=scan the code again")
        page.wait_for_selector("#verdict.no")
        page.click("#end-camera")
        page.click("#use-camera")
        assert page.inner_text("#verdict-word") == "…"


LATE = """(lateMs) => {
    window.before ??= window.fetch;
    window.fetch = async (...asked) => {
        const answer = await window.before(...asked);
        await new Promise((resolve) => setTimeout(resolve, lateMs));
        return answer;
    };
    window.greens = 0;
    const seen = new MutationObserver((changes) => {
        for (const { oldValue, target } of changes) if (target.className.endsWith(" go") && !oldValue.endsWith(" go")) window.greens += 1;
    });
    seen.observe(document.getElementById("verdict"), { attributeFilter: ["class"], attributeOldValue: true });
}"""  # noqa: E501  # a line of the page's script


def test_green_does_not_flicker_where_answers_are_always_late(
    browser: Browser, guide: ServedGuide
) -> None:
    with opened(browser, guide) as page:
        page.click("#use-camera")
        page.wait_for_selector("#verdict.go")
        page.evaluate(LATE, 500)
        page.wait_for_selector("#verdict.no >> text=the computer answers late")
        page.evaluate("() => { window.greens = 0; }")
        answered = page.evaluate("window.guide.newest")
        late = f"window.guide.newest > {answered + 8}"
        wait_until(lambda: page.evaluate(late), "some more are answered")
        is_go = "window.guide.guidance.verdict === 'go'"
        wait_until(lambda: page.evaluate(is_go), "the null: the pose is good")
        assert page.evaluate("window.greens") == 0
        page.evaluate("() => { window.fetch = window.before; }")
        page.wait_for_selector("#verdict.go")


def test_a_camera_that_was_taken_away_is_opened_again(browser: Browser, guide: ServedGuide) -> None:
    with opened(browser, guide) as page:
        page.click("#use-camera")
        page.wait_for_selector("#verdict.go")
        page.evaluate("""() => {
            window.first = window.guide.track;
            window.first.stop();
            window.first.dispatchEvent(new Event("ended"));
        }""")
        page.wait_for_selector("#fault >> text=opens it again")
        page.wait_for_selector("#verdict.no >> text=Waiting for the computer")
        other = "window.guide.track !== window.first && window.guide.track.readyState === 'live'"
        wait_until(lambda: page.evaluate(other), "the camera is opened again")
        page.wait_for_selector("#verdict.go")
        assert page.is_hidden("#fault")


def test_a_camera_that_is_mute_is_waited_for(browser: Browser, guide: ServedGuide) -> None:
    with opened(browser, guide) as page:
        page.click("#use-camera")
        page.wait_for_selector("#verdict.go")
        page.evaluate("""() => {
            const { track } = window.guide;
            Object.defineProperty(track, "muted", { value: true, configurable: true });
            track.dispatchEvent(new Event("mute"));
        }""")
        page.wait_for_selector("#verdict.no >> text=Waiting for the computer")
        wait_until(lambda: page.evaluate("window.guide.inFlight") == 0, "nothing is on its way")
        sent = page.evaluate("window.guide.sent")
        page.wait_for_timeout(500)
        assert page.evaluate("window.guide.sent") == sent  # an old picture is not sent as a new one
        assert page.inner_text("#verdict-word") == "…"
        page.evaluate("() => { delete window.guide.track.muted; }")
        page.wait_for_selector("#verdict.go")
        assert page.is_hidden("#fault")


def test_what_was_being_compressed_when_the_camera_went_mute_is_not_sent(
    browser: Browser, guide: ServedGuide
) -> None:
    with opened(browser, guide) as page:
        page.click("#use-camera")
        page.wait_for_selector("#verdict.go")
        page.evaluate("""() => {
            const compress = HTMLCanvasElement.prototype.toBlob;
            HTMLCanvasElement.prototype.toBlob = function (done, ...how) {
                window.compressing = (window.compressing ?? 0) + 1;
                const late = (blob) => setTimeout(() => {
                    window.compressing -= 1;
                    done(blob);
                }, 2000);
                compress.call(this, late, ...how);
            };
        }""")
        wait_until(lambda: page.evaluate("window.compressing ?? 0") > 0, "a frame is compressed")
        sent = page.evaluate("""() => {
            const { track, sent } = window.guide;
            Object.defineProperty(track, "muted", { value: true, configurable: true });
            return sent;
        }""")
        wait_until(lambda: page.evaluate("window.compressing") == 0, "it is compressed")
        page.wait_for_timeout(100)
        assert page.evaluate("window.guide.sent") == sent
        page.evaluate("() => { delete window.guide.track.muted; }")
        wait_until(lambda: page.evaluate("window.guide.sent") > sent, "the next frame is sent")


def test_the_screen_stays_lit_while_the_camera_is_open(
    browser: Browser, guide: ServedGuide
) -> None:
    with opened(browser, guide) as page:
        page.evaluate("""() => {
            window.locks = [];
            const ask = navigator.wakeLock.request.bind(navigator.wakeLock);
            navigator.wakeLock.request = async (kind) => {
                const lock = await ask(kind);
                window.locks.push(lock);
                return lock;
            };
        }""")
        held = "window.locks.filter(({ released }) => !released).length"
        page.click("#use-camera")
        wait_until(lambda: page.evaluate(held) == 1, "the screen is kept lit")
        page.evaluate("window.locks[0].release()")  # as when the page was hidden
        wait_until(lambda: page.evaluate(held) == 0, "the lock is lost")
        page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
        wait_until(lambda: page.evaluate(held) == 1, "it is asked for again")
        page.click("#end-camera")
        wait_until(lambda: page.evaluate(held) == 0, "the screen may go dark")


SERIES = """async () => {
    const { drawSeries } = await import("/static/series.js");
    const svg = document.getElementById("series-plot");
    const still = (name, count, state = "done") => ({ name, count, state, pose: { verdict: "go" } });
    const isDrawn = [
        drawSeries(svg, [still("20260101-120000-aaaaaaaa", 3), still("other", 1)]),
        drawSeries(svg, [
            still("20260301-120000-cccccccc", 6), still("20260101-120000-aaaaaaaa", 0),
            still("20260131-000000-bbbbbbbb", 3), still("20260201-000000-dddddddd", 1, "failed"),
        ]),
    ];
    document.getElementById("series").hidden = false;
    const circles = [...svg.querySelectorAll("circle")];
    return { isDrawn, at: circles.map((one) => [Number(one.getAttribute("cx")), Number(one.getAttribute("cy"))]), says: svg.getAttribute("aria-label") };
}"""  # noqa: E501  # a line of the page's script


def test_photographs_over_time_are_drawn_where_they_belong(
    browser: Browser, guide: ServedGuide
) -> None:
    with opened(browser, guide) as page:
        found = page.evaluate(SERIES)
        assert violations(page) == []
    assert found["isDrawn"] == [False, True]
    (x0, y0), (x1, y1), (x2, y2) = found["at"]
    # 1 January 12:00, 31 January 0:00, 1 March 12:00: after 29.5 of 59 days; 0, 3 and 6 changes.
    assert x1 - x0 == pytest.approx((x2 - x0) * 29.5 / 59)
    assert y0 - y1 == pytest.approx(y1 - y2)
    assert found["says"] == "Changes found in 3 photographs, in order of time: 0, 3, 6"


def test_a_photograph_that_is_refused_stays_in_the_phone_until_it_is_thrown_away(
    browser: Browser, guide: ServedGuide, stills: Stills
) -> None:
    with opened(browser, guide) as page:
        refusal = {"status": 422, "json": {"text": "it is too good"}}
        page.route("**/stills?sha256**", lambda route: route.fulfill(**refusal))
        page.set_input_files("#photograph", stills.again)
        page.wait_for_selector("#refused-list >> text=it is too good")
        page.goto(guide.url)
        page.wait_for_selector("#refused-list >> text=it is too good")
        assert page.evaluate(WAITING) == 1
        assert violations(page) == []
        assert_fits(page)
        page.click("text=Throw it away")
        page.wait_for_selector("#refused", state="hidden")
        assert page.evaluate(WAITING) == 0


@pytest.mark.usefixtures("not_compared")
def test_a_photograph_for_which_there_is_no_room_yet_is_sent_again_by_itself(
    browser: Browser, guide: ServedGuide, stills: Stills
) -> None:
    with opened(browser, guide) as page:
        wait = {"status": 409, "json": {"text": "wait until one is compared"}}
        page.route("**/stills?sha256**", lambda route: route.fulfill(**wait))
        page.set_input_files("#photograph", stills.again)
        page.wait_for_selector("#sending-words >> text=wait until one is compared")
        assert page.evaluate(WAITING) == 1
        page.unroute("**/stills?sha256**")
        page.wait_for_selector(".still .tag.go")


SHARPER = """async () => {
    const { measured } = await import("/static/camera.js");
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [300, 200];
    const drawing = canvas.getContext("2d");
    const found = {};
    for (const [name, along, across] of [["plain", 0, 0], ["upright", 8, 0], ["level", 0, 8]]) {
        drawing.fillStyle = "white";
        drawing.fillRect(0, 0, 300, 200);
        drawing.fillStyle = "black";
        if (along) for (let x = 0; x < 300; x += 2 * along) drawing.fillRect(x, 0, along, 200);
        if (across) for (let y = 0; y < 200; y += 2 * across) drawing.fillRect(0, y, 300, across);
        const blob = await new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
        found[name] = await measured(blob);
    }
    return found;
}"""


def test_the_sharpest_of_a_burst_is_found_along_and_across(
    browser: Browser, guide: ServedGuide
) -> None:
    with opened(browser, guide) as page:
        found = page.evaluate(SHARPER)
    assert found["plain"] == {"pixels": 60_000, "sharpness": 0}
    # An edge every 8 px, of 255 levels.
    for name in ("upright", "level"):
        assert found[name]["sharpness"] == pytest.approx(255**2 / 8, rel=0.05)


@pytest.mark.usefixtures("not_compared")
def test_a_phone_that_sleeps_sends_when_the_page_is_opened_again(
    browser: Browser, guide: ServedGuide, stills: Stills
) -> None:
    with opened(browser, guide) as page:
        page.route("**/stills/**", lambda route: route.abort())
        page.set_input_files("#photograph", stills.again)
        page.wait_for_selector("#sending-words >> text=kept here")
        assert guide.store.records() == []
        page.unroute("**/stills/**")
        page.goto("about:blank")
        page.goto(guide.url)
        page.wait_for_selector(".still .tag.go")
        wait_until(lambda: page.evaluate(WAITING) == 0, "nothing waits in the phone any more")
    assert len(guide.store.records()) == 1


def test_of_several_references_the_one_that_the_camera_sees_is_opened(
    browser: Browser, stills: Stills, tmp_path: Path
) -> None:
    references = stills.other, stills.reference
    with served_guide(references[0], tmp_path, *references[1:]) as guide:
        context = browser.new_context(**SCREEN)
        try:
            page = context.new_page()
            page.set_default_timeout(1e3 * DEADLINE_S)
            page.goto(guide.entry)
            assert page.locator(".references li").count() == 2
            assert violations(page) == []
            assert_fits(page)
            page.click("#find")
            page.wait_for_selector("#start")
            assert "reference.jpg" in page.inner_text("#start")
            page.click("text=All references")
            page.wait_for_selector("#find")
        finally:
            context.close()


def test_the_console_guides_any_camera_to_a_photograph_that_was_imported(
    browser: Browser, stills: Stills, tmp_path: Path
) -> None:
    hub = ConsoleHub(sessions=tmp_path / "sessions")
    standoff.import_photographs(
        [stills.other, stills.reference], hub.sessions.folder / "wall", kind="texture", height_mm=0
    )
    hub.start()
    try:
        with served(hub, token=TOKEN) as (host, port):
            context = browser.new_context(viewport={"width": 1280, "height": 900})
            page = context.new_page()
            page.set_default_timeout(1e3 * DEADLINE_S)
            page.goto(f"http://{host}:{port}/guide/")
            assert page.is_visible("input[name=token]")
            page.goto(f"http://{host}:{port}/login?token={TOKEN.replace(' ', '%20')}")
            page.goto(f"http://{host}:{port}/guide/")
            assert page.is_visible("text=No photograph is chosen yet")
            assert violations(page) == []
            page.click("text=The console's photographs")
            page.click(".picture-choice:has-text('reference.jpg')")
            page.click("#guide")
            page.wait_for_selector("#start >> text=reference.jpg of wall")
            assert violations(page) == []
            page.click("#use-camera")
            page.wait_for_selector("#verdict.go")
            page.click("#shutter")
            page.wait_for_selector(".still .tag.go")
            page.wait_for_selector(".still .blink:visible")
            page.goto(f"http://{host}:{port}/sessions")
            assert page.locator("tbody tr").count() == 2
            context.close()
    finally:
        hub.close()
    (one,) = [each.name for each in hub.sessions.summaries() if each.name != "wall"]
    assert standoff.verify_session(hub.sessions.folder / one).is_ok


def test_without_the_code_the_page_asks_for_the_token(browser: Browser, guide: ServedGuide) -> None:
    context = browser.new_context(**SCREEN)
    try:
        page = context.new_page()
        page.goto(guide.url)
        assert "not paired" in page.inner_text("main")
        assert violations(page) == []
        page.fill("#token", "a wrong token")
        page.click("button")
        assert "Wrong token" in page.inner_text("main")
    finally:
        context.close()
