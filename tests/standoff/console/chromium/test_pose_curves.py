"""Curves and the threshold are chosen on the page, in Chromium; a page that watches sees it."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


from playwright.sync_api import APIResponse, Browser, Page, Route

from analysis.detectability import DetectabilityCurves
from analysis.results_file import write_results
from tests.acquisition.fakes import SETTINGS
from tests.analysis.detectability.test_curves import curve
from tests.standoff.console.chromium.pages import LivePage, live_page, opened_page, streaming
from tests.standoff.console.console_rig import text, wait_until
from tests.standoff.console.hub_fixtures import idle_hub, running_hub
from tests.standoff.console.test_application import texture
from tests.standoff.console.test_bench_hub import Operator

pytestmark = [pytest.mark.slow, pytest.mark.waits]

GOOD = {name: [8.0, 6.0, 4.0] for name in ("dprime", "dprime_low", "dprime_high")}
SEVERAL = DetectabilityCurves(curves=[curve(), curve(noise_dn=4.0, **GOOD)])
SECOND = "matched, npw, noise 4 DN, contrast 12 DN"


@pytest.fixture
def live(browser: Browser, tmp_path: Path) -> Iterator[LivePage]:
    hub = idle_hub(tmp_path)
    hub.sessions.folder.mkdir()
    write_results(hub.sessions.folder / "curves.json", SEVERAL)
    with live_page(browser, hub) as made:
        yield made


@contextmanager
def watching(browser: Browser, live: LivePage) -> Iterator[Page]:
    """A second page, which is not in control."""
    with opened_page(browser, live.page.url) as page:
        wait_until(lambda: "is in control" in text(page, "#control-text"), "it watches")
        yield page


def wait_told(page: Page, words: str) -> None:
    wait_until(lambda: words in text(page, "#notices"), words)


def offered(page: Page, selector: str) -> list[str]:
    return list(page.locator(f"{selector} option").all_text_contents())


def test_a_curve_and_a_threshold_are_chosen_and_a_watching_page_sees_them_and_may_not(
    browser: Browser, live: LivePage
) -> None:
    page = live.page
    with watching(browser, live) as other:
        wait_until(lambda: offered(page, "#curve-file") == ["nothing", "curves.json"], "files")
        assert page.is_hidden("#curve-of")
        page.select_option("#curve-file", "curves.json")
        page.wait_for_selector("#curve-of:visible")
        names = [each.name for each in SEVERAL.curves]
        wait_until(
            lambda: offered(page, "#curve-name") == ["choose one of 2", *names], "both curves"
        )
        assert not live.hub.pose.view.is_possible
        page.select_option("#curve-name", SECOND)
        page.fill("#min-dprime", "3.25")
        page.keyboard.press("Enter")
        wait_until(lambda: live.hub.curves.view.min_dprime == 3.25, "the threshold")
        assert live.hub.curves.view.name == SECOND
        assert live.hub.pose.view.is_possible
        told = f"Poses are judged by curves.json: {SECOND}; d' at least 3.25."
        for each in (page, other):
            wait_until(lambda each=each: text(each, "#curve-words") == SECOND, "shown")
            wait_until(lambda each=each: each.input_value("#curve-file") == "curves.json", "file")
            wait_until(lambda each=each: each.input_value("#curve-name") == "1", "curve")
            wait_until(lambda each=each: each.input_value("#min-dprime") == "3.25", "d'")
            wait_until(lambda each=each: told in text(each, "#notices"), "told")
        for selector in ("#curve-file", "#curve-name", "#min-dprime", "#curve-send", "#pose-here"):
            assert other.is_disabled(selector)
            assert page.is_enabled(selector)
        # Nor may it by other means.
        other.evaluate("""async () => {
            const { command } = await import("/static/shell.js");
            command("pose-curve", { file: "" });
        }""")
        wait_until(lambda: "not in control" in text(other, "#notices"), "refused")
        assert live.hub.curves.view.name == SECOND


def test_a_threshold_that_cannot_be_is_refused_in_words_and_the_field_is_set_back(
    live: LivePage,
) -> None:
    page = live.page
    wait_until(lambda: page.input_value("#min-dprime") == "2", "the threshold is shown")
    for wrong in ("-1", "0"):
        page.fill("#min-dprime", wrong)
        page.keyboard.press("Enter")
        wait_until(
            lambda: "The threshold of d' must be more than 0." in text(page, "#notices"), "refused"
        )
        wait_until(lambda: page.input_value("#min-dprime") == "2", "set back")
    page.fill("#min-dprime", "")
    page.keyboard.press("Tab")
    wait_until(lambda: page.input_value("#min-dprime") == "2", "an empty one, too")
    page.fill("#min-dprime", "7")  # what is being typed stays
    page.wait_for_timeout(400)
    assert page.input_value("#min-dprime") == "7"


def test_a_file_that_cannot_be_read_is_refused_and_the_choice_is_set_back(live: LivePage) -> None:
    page = live.page
    wait_until(lambda: "curves.json" in offered(page, "#curve-file"), "the list is there")
    (live.hub.sessions.folder / "bad.curves.json").write_text("{}")
    page.focus("#curve-file")
    wait_until(lambda: "bad.curves.json" in offered(page, "#curve-file"), "a file of meanwhile")
    page.select_option("#curve-file", "bad.curves.json")
    wait_until(lambda: "schema is None" in text(page, "#notices"), "refused")
    wait_until(lambda: page.input_value("#curve-file") == "", "set back")


def test_a_list_that_is_asked_for_while_another_is_on_its_way_is_the_one_shown(
    live: LivePage,
) -> None:
    page, held = live.page, list[tuple[Route, APIResponse]]()

    def hold_the_first(route: Route) -> None:
        if held:
            route.continue_()
        else:
            held.append((route, route.fetch()))

    page.route("**/pose/curves", hold_the_first)
    page.reload()
    page.wait_for_selector("body.mine")
    wait_until(lambda: bool(page.evaluate("true") and held), "the first answer is held")
    (live.hub.sessions.folder / "late.curves.json").write_text("{}")
    page.focus("#curve-file")
    wait_until(lambda: "late.curves.json" in offered(page, "#curve-file"), "the second answer")
    route, first = held[0]
    route.fulfill(response=first)
    page.wait_for_timeout(200)
    assert "late.curves.json" in offered(page, "#curve-file")


def test_a_file_of_the_operator_s_computer_is_kept_and_judges_what_is_seen(
    browser: Browser, tmp_path: Path
) -> None:
    hub, path = idle_hub(tmp_path), tmp_path / "of my own.json"
    write_results(path, DetectabilityCurves(curves=[curve(**GOOD)]))
    hub.pose.start()
    try:
        with streaming(hub, texture()), live_page(browser, hub) as live:
            wait_until(lambda: hub.frames.latest is not None, "a picture")
            live.page.click("#pose-here")
            wait_until(lambda: "no curve judges" in text(live.page, "#pose-reason"), "no verdict")
            live.page.set_input_files("#curve-pick", path)
            wait_until(lambda: text(live.page, "#pose-verdict") == "GO", "a verdict")
            kept_as = "curves/of my own.json"
            wait_until(lambda: live.page.input_value("#curve-file") == kept_as, "it is chosen")
            kept = hub.sessions.folder / "curves" / "of my own.json"
            assert kept.read_bytes() == path.read_bytes()
            live.page.fill("#min-dprime", "500")
            live.page.keyboard.press("Enter")
            wait_until(lambda: text(live.page, "#pose-verdict") == "NO GO", "another verdict")
    finally:
        hub.pose.close()


def test_a_hostile_file_gets_one_line_and_is_not_kept(live: LivePage) -> None:
    page = live.page
    for name, data, words in (
        ("deep.json", b"[" * 500_000, "deep.json: not JSON: its brackets are nested too deeply"),
        ("other.json", b'{"schema": "<b>x</b>"}', "other.json: schema is '<b>x</b>'"),
        ("large.json", b" " * (4 * 2**20 + 1), "large.json is too large"),
        ("a.toml", json.dumps({}).encode(), "must be called NAME.json"),
    ):
        page.set_input_files(
            "#curve-pick", {"name": name, "mimeType": "application/json", "buffer": data}
        )
        wait_told(page, words)
    assert page.locator("#notices b").count() == 0
    assert not (live.hub.sessions.folder / "curves").exists()
    assert page.input_value("#curve-file") == ""
    assert all("status of 422" in fault for fault in live.faults)  # that is the refusal
    live.faults.clear()


def test_a_session_s_page_learns_that_there_are_curves_and_that_there_are_none(
    browser: Browser, tmp_path: Path
) -> None:
    with running_hub(tmp_path) as hub:
        write_results(tmp_path / "curves.json", DetectabilityCurves(curves=[curve()]))
        operator = Operator(hub)
        operator.say(do="run", plan="two", session="first")
        operator.answer("ready")
        operator.wait_idle()
        hub.control.leave("Ada")
        hub.control.release("Ada")
        data = (tmp_path / "curves.json").read_bytes()
        with live_page(browser, hub) as live:
            page = live.page
            page.goto(f"{page.url}sessions/first")
            page.wait_for_selector("[data-curves=no]")
            assert "choose curves of d'" in text(page, ".results")
            assert page.locator("[data-pair=pose]").count() == 0
            hub.curves.choose(hub.curves.store("curves.json", data))
            page.wait_for_selector("[data-pair=pose]")
            assert "choose curves of d'" not in text(page, ".results")
            page.focus("[data-pair=pose] [name=followup]")
            hub.curves.choose("")
            page.wait_for_timeout(500)
            assert page.locator("[data-pair=pose]").count() == 1  # while something is typed
            page.locator("[data-pair=pose] [name=followup]").blur()
            page.wait_for_selector("[data-pair=pose]", state="detached")


def test_the_levels_of_a_live_reference_are_those_of_its_camera(live: LivePage) -> None:
    with streaming(live.hub, texture()):
        wait_until(lambda: live.hub.frames.latest is not None, "a picture")
        live.page.click("#pose-here")
        wait_until(lambda: live.hub.pose.view.picture is not None, "a reference")
        picture = live.hub.pose.view.picture
        assert picture is not None
        assert picture.max_level_dn == SETTINGS.max_level_dn
