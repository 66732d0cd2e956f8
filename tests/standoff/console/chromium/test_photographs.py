"""Photographs of one's own, from a browser alone: sent, imported, compared, noted and exported."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("axe_playwright_python", reason="axe-playwright-python is not installed")

from PIL import Image
from playwright.sync_api import Browser, Page, Request, Route

import standoff
from standoff.console.bench_hub import ConsoleHub
from tests.standoff.console.chromium.pages import PHONE, opened_page
from tests.standoff.console.chromium.test_accessibility import judged
from tests.standoff.console.console_rig import wait_until
from tests.standoff.console.guide.conftest import stills as stills
from tests.standoff.console.guide.scenes import Stills
from tests.standoff.console.hub_fixtures import idle_hub
from tests.standoff.console.served import served

pytestmark = [pytest.mark.slow(minutes=0.5), pytest.mark.waits]

SENT = "/sessions/my%20wall"


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[ConsoleHub]:
    """A console without a bench."""
    made = ConsoleHub(sessions=tmp_path / "sessions")
    made.start()
    yield made
    made.close()


def send(page: Page, *files: Path) -> None:
    page.wait_for_selector("#files:enabled", state="attached")
    before = page.locator("#sending li >> text=arrived").count()
    page.set_input_files("#files", files)
    wait_until(
        lambda: page.locator("#sending li >> text=arrived").count() == before + len(files),
        "they have arrived",
    )


def smaller(path: Path, folder: Path) -> Path:
    """A part of the same photograph."""
    made = folder / "smaller.jpg"
    Image.open(path).crop((20, 10, 380, 290)).save(made, quality=95)
    return made


def import_all(page: Page, session: str) -> None:
    page.wait_for_selector("#import button[type=submit]:enabled")
    page.fill("#import [name=session]", session)
    page.click("#import button[type=submit]")
    page.wait_for_selector("#arrived >> text=nothing to be imported")


def test_photographs_are_sent_imported_and_compared_without_a_terminal(
    browser: Browser, hub: ConsoleHub, stills: Stills, tmp_path: Path
) -> None:
    damaged = tmp_path / "damaged.jpg"
    damaged.write_bytes(b"no photograph at all")
    with served(hub) as (host, port), opened_page(browser, f"http://{host}:{port}/") as page:
        page.wait_for_selector("body.mine")
        judged(page, "nothing has arrived")
        page.set_input_files("#files", damaged)
        page.wait_for_selector("#sending >> text=damaged.jpg: it is not a JPEG file")
        send(page, stills.reference, smaller(stills.again, tmp_path))
        page.wait_for_selector("#import")
        assert page.is_visible("#sending >> text=damaged.jpg")
        judged(page, "two have arrived")
        import_all(page, "my wall")
        page.click(".picture-choice:has-text('reference.jpg')")
        page.click(".picture-choice:has-text('smaller.jpg')")
        judged(page, "two are chosen")
        page.click("#find-changes")
        page.wait_for_selector("#result-message >> text=1 change:")
        with page.expect_popup() as opened:
            page.click("#result-page")
        opened.value.wait_for_selector("h1:has-text('Changes')")
        opened.value.close()
        page.goto(f"http://{host}:{port}{SENT}")
        page.click("[data-result=verify]:enabled")
        page.wait_for_selector(".found >> text=files match the journal")
        page.fill("#note [name=text]", "the lamp was changed")
        page.click("#note button:enabled")
        page.wait_for_selector(".log >> text=the lamp was changed")
        page.fill("#set-height [name=height_mm]", "412.5")
        page.fill("#set-height [name=reason]", "measured afterwards")
        page.click("#set-height button:enabled")
        page.wait_for_selector("td >> text=412.500")
        page.click("#export button:enabled")
        with page.expect_download() as saved:
            page.click("a[download]")
        assert saved.value.suggested_filename == "my wall export.ome.tif"
        assert saved.value.path().read_bytes()[:4] in (b"II*\0", b"II+\0")
        judged(page, "the session")
    session = standoff.Session(hub.sessions.folder / "my wall")
    assert [record.height_mm for record in session.records] == [412.5, 412.5]
    assert standoff.verify_session(session.path).is_ok


def test_several_later_photographs_are_compared_with_one_at_a_time(
    browser: Browser, hub: ConsoleHub, stills: Stills, tmp_path: Path
) -> None:
    paths = [stills.reference, stills.again, smaller(stills.again, tmp_path)]
    standoff.import_photographs(paths, hub.sessions.folder / "my wall", kind="texture", height_mm=0)
    with served(hub) as (host, port), opened_page(browser, f"http://{host}:{port}/") as page:
        page.wait_for_selector("body.mine")
        for path in paths:
            page.click(f".picture-choice:has-text('{path.name}')")
        assert page.inner_text("#chosen") == "2 photographs against reference.jpg"
        assert page.locator(".picture-choice[aria-pressed=true]").count() == 3
        assert page.is_disabled("#swap")
        assert page.is_disabled("#two-distance")
        judged(page, "three are chosen")
        page.click("#find-changes:enabled")
        page.wait_for_selector("#result-message >> text=smaller.jpg of my wall: 1 change")
        assert page.inner_text("#result-words").startswith("again.jpg of my wall: ")
        page.goto(f"http://{host}:{port}{SENT}")
        page.wait_for_selector("body.mine")
        assert page.locator("li.pair a:has-text('Open')").count() == 2


def test_what_is_filled_in_and_chosen_stays_while_something_else_happens(
    browser: Browser, hub: ConsoleHub, stills: Stills, tmp_path: Path
) -> None:
    other = smaller(stills.again, tmp_path)
    with served(hub) as (host, port), opened_page(browser, f"http://{host}:{port}/") as page:
        page.wait_for_selector("body.mine")
        send(page, stills.reference)
        import_all(page, "my wall")
        page.click(".picture-choice:has-text('reference.jpg')")
        send(page, stills.again)
        page.wait_for_selector("#import")
        page.fill("#import [name=height]", "412.5")
        page.fill("#import [name=session]", "the same wall")
        page.select_option("#import [name=kind]", "chart")
        page.uncheck("#import [name=photograph]")
        send(page, other)  # as a phone does
        page.wait_for_selector("#arrived >> text=smaller.jpg")
        assert [
            page.input_value(f"#import [name={name}]") for name in ("kind", "height", "session")
        ] == ["chart", "412.5", "the same wall"]
        checked = page.locator("#import [name=photograph]:checked")
        assert checked.count() == 1
        assert page.locator(".picture-choice[aria-pressed=true] .role").inner_text() == "before"
        assert page.is_visible("#guide")
        page.goto(f"http://{host}:{port}{SENT}")
        page.wait_for_selector("[data-result=verify]:enabled")
        page.fill("#note [name=text]", "the lamp was ch")
        page.click("[data-result=verify]")
        page.wait_for_selector(".found >> text=files match the journal")
        page.wait_for_selector("#note button:enabled")  # the page's script has run
        assert page.input_value("#note [name=text]") == "the lamp was ch"
        page.click("#note button:enabled")
        page.wait_for_selector(".log >> text=the lamp was ch")
        page.wait_for_selector("#note button:enabled")
        assert page.input_value("#note [name=text]") == ""


@contextmanager
def late(page: Page, script: str) -> Iterator[None]:
    """The page is shown and used while one of its scripts has not come yet."""
    held: list[Route] = []
    page.route(f"**/static/{script}", lambda route: held.append(route))
    yield
    wait_until(lambda: bool(page.title() and held), "the script was asked for")
    held[0].continue_()


def test_what_is_typed_and_clicked_before_a_script_has_come_is_not_lost(
    browser: Browser, hub: ConsoleHub, stills: Stills
) -> None:
    standoff.import_photographs(
        [stills.reference, stills.again],
        hub.sessions.folder / "my wall",
        kind="texture",
        height_mm=0,
    )
    with served(hub) as (host, port), opened_page(browser, f"http://{host}:{port}{SENT}") as page:
        page.wait_for_selector("[data-result=verify]:enabled")
        page.fill("#note [name=text]", "the lamp was changed")
        with late(page, "session.js"):
            page.click("[data-result=verify]:enabled", no_wait_after=True)
            page.wait_for_selector(".found >> text=files match the journal")
            page.fill("#set-height [name=height_mm]", "412.5")
        page.wait_for_selector("#note button:enabled")
        assert page.input_value("#set-height [name=height_mm]") == "412.5"
        assert page.input_value("#note [name=text]") == "the lamp was changed"
        with late(page, "photographs.js"):
            page.goto(f"http://{host}:{port}/photographs", wait_until="commit")
            page.wait_for_selector(".picture-choice")
            for selector in (".picture-choice", "#swap", "#files"):
                assert page.locator(selector).first.is_disabled()
        page.click(".picture-choice:has-text('reference.jpg')")
        page.wait_for_selector("#guide:visible")


def test_no_more_are_imported_at_a_time_than_the_console_takes(
    browser: Browser, hub: ConsoleHub, stills: Stills, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("standoff.console.web._photograph_pages.MOST_IMPORTED", 1)
    with served(hub) as (host, port), opened_page(browser, f"http://{host}:{port}/") as page:
        page.wait_for_selector("body.mine")
        send(page, stills.reference, stills.again)
        page.wait_for_selector("#import button[type=submit]:enabled")
        assert page.locator("#import [name=photograph]:checked").count() == 1
        page.check("#import [name=photograph]:not(:checked)")
        page.wait_for_selector("#too-many >> text=At most 1 are imported at a time")
        assert page.is_disabled("#import button[type=submit]")
        for _ in range(2):
            page.uncheck("#import [name=photograph]:checked >> nth=0")
        assert page.is_disabled("#import button[type=submit]")
        judged(page, "none is chosen")


def test_a_phone_sends_what_whoever_is_in_control_imports(
    browser: Browser, hub: ConsoleHub, stills: Stills
) -> None:
    with served(hub) as (host, port), opened_page(browser, f"http://{host}:{port}/") as desk:
        desk.wait_for_selector("body.mine")
        phone_view = {"viewport": PHONE, "has_touch": True, "is_mobile": True}
        with opened_page(browser, desk.url, name="Bob", **phone_view) as phone:
            phone.wait_for_selector("#control-text:has-text('Ada is in control')")
            phone.check("#remove-location")
            send(phone, stills.reference)
            phone.wait_for_selector("#import")
            assert phone.is_disabled("#import button[type=submit]")
            judged(phone, "a phone")
            width = phone.evaluate("document.documentElement.scrollWidth")
            assert width <= PHONE["width"]
        desk.wait_for_selector("#arrived >> text=reference.jpg")
        desk.click("[data-discard]:enabled")
        desk.wait_for_selector("#arrived >> text=nothing to be imported")
    assert hub.photographs.arrived() == []


def test_a_part_that_is_lost_is_sent_again(
    browser: Browser, hub: ConsoleHub, stills: Stills
) -> None:
    lost: list[str] = []
    with served(hub) as (host, port), opened_page(browser, f"http://{host}:{port}/") as page:
        page.wait_for_selector("body.mine")

        def lose_one(route: Route, request: Request) -> None:
            if request.method == "PUT" and not lost:
                lost.append(request.url)
                route.abort()
            else:
                route.continue_()

        page.route("**/photographs/arrived/**", lose_one)
        send(page, stills.reference)
    assert len(lost) == 1
    (one,) = hub.photographs.arrived()
    assert one.path.read_bytes() == stills.reference.read_bytes()


def test_a_console_with_a_bench_takes_photographs_too(
    browser: Browser, tmp_path: Path, stills: Stills
) -> None:
    hub = idle_hub(tmp_path)
    with served(hub) as (host, port), opened_page(browser, f"http://{host}:{port}/") as page:
        page.wait_for_selector("body.mine")
        page.click("nav a[href='/photographs']")
        send(page, stills.reference, stills.again)
        import_all(page, "wall")
        assert page.locator(".picture-choice").count() == 2
        assert page.is_visible("#stop")
