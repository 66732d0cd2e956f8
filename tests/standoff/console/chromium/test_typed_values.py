"""Wrong values typed in on the pages: said in the operator's words, and the fields set back."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


from playwright.sync_api import Browser, Page

from standoff.console.bench_hub import BenchHub
from tests.standoff.console.chromium.pages import LivePage, live_page
from tests.standoff.console.console_rig import text, wait_until
from tests.standoff.console.hub_fixtures import idle_hub, running_hub, wait_for
from tests.standoff.console.test_messages import PROGRAMMERS_WORDS

pytestmark = [pytest.mark.slow, pytest.mark.waits]

TYPED = ("exposure", "gain", "move-to", "sweep-low", "sweep-high", "sweep-steps", "min-dprime")
"""Every field for a number of the bench page."""


@pytest.fixture(scope="module")
def live(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LivePage]:
    with running_hub(tmp_path_factory.mktemp("typed")) as hub:
        homed(hub)
        with live_page(browser, hub) as made:
            made.page.click("#sweep-box summary")
            made.page.wait_for_selector("#sweep-form button:enabled")
            yield made


def homed(hub: BenchHub) -> None:
    hub.stage.lent(lambda: None).home(60.0)
    wait_for(lambda: hub.stage.view.is_homed, "homed")


def told(page: Page) -> str:
    """What the page told last; it is gone when the next is waited for."""
    wait_until(lambda: page.locator("#notices li").count() > 0, "it is told")
    words = text(page, "#notices li:first-child")
    page.evaluate("document.getElementById('notices').replaceChildren()")
    return words


def test_the_bench_page_has_no_other_field_for_a_number(live: LivePage) -> None:
    fields = live.asked("[...document.querySelectorAll('input[type=number]')].map(f => f.id)")
    assert sorted(fields) == sorted(TYPED)


@pytest.mark.parametrize(
    ("field", "typed", "words"),
    [
        ("exposure", "0", "The exposure must be more than 0 µs."),
        ("exposure", "-5", "The exposure must be more than 0 µs."),
        ("exposure", "3", "The exposure of this camera must be at least 21 µs, its shortest."),
        ("exposure", "7e7", "The exposure of this camera must be at most 60000000 µs, its"),
        ("exposure", "999999999", "The exposure must be at most 100000000 µs."),
        ("exposure", "1e", "The exposure must be a number."),
        ("gain", "-1", "The gain must be at least 0 dB."),
        ("gain", "101", "The gain must be at most 100 dB."),
        ("gain", "--", "The gain must be a number."),
        ("move-to", "9999", "the stage travels from 120 to 620 mm, not to 9999 mm; nothing moved"),
        ("move-to", "-3", "the stage travels from 120 to 620 mm, not to -3 mm; nothing moved"),
        ("move-to", "1e", "The height must be a number."),
        ("sweep-steps", "3", "The number of heights must be at least 7."),
        ("sweep-steps", "201", "The number of heights must be at most 200."),
        ("sweep-steps", "7.5", "The number of heights must be a whole number."),
        ("sweep-steps", "", "The number of heights must be a whole number."),
        ("sweep-low", "1e", "The lowest height must be a number."),
        ("sweep-high", "--", "The highest height must be a number."),
        ("min-dprime", "0", "The threshold of d' must be more than 0."),
        ("min-dprime", "1001", "The threshold of d' must be at most 1000."),
        ("min-dprime", "1e", "The threshold of d' must be a number."),
    ],
)  # fmt: skip
def test_a_wrong_number_is_refused_in_words_and_set_back(
    live: LivePage, field: str, typed: str, words: str
) -> None:
    page, selector = live.page, f"#{field}"
    before = page.input_value(selector)
    page.focus(selector)
    page.keyboard.press("Control+a")
    page.keyboard.press("Delete")
    page.keyboard.type(typed)
    page.keyboard.press("Enter")
    assert told(page).startswith(words)
    wait_until(lambda: page.input_value(selector) == before, "set back")
    assert live.hub.jobs.current is None


def test_a_number_is_sent_once_by_the_key_enter(live: LivePage) -> None:
    page = live.page
    page.evaluate("""() => {
        const send = WebSocket.prototype.send;
        window.sent = [];
        WebSocket.prototype.send = function (words) {
            window.sent.push(words);
            send.call(this, words);
        };
    }""")
    of_it = "window.sent.filter((words) => words.includes('2345')).length"
    page.fill("#exposure", "2345")
    page.keyboard.press("Enter")
    wait_until(lambda: live.asked(of_it) > 0, "it is sent")
    page.wait_for_timeout(300)
    assert live.asked(of_it) == 1
    page.keyboard.press("Enter")
    page.fill("#exposure", "1234")
    page.keyboard.press("Enter")
    wait_until(lambda: live.asked(of_it.replace("2345", "1234")) > 0, "the next one is sent")
    assert live.asked(of_it) == 1


def test_a_sweep_beyond_the_travel_sets_back_the_height_that_is_wrong(live: LivePage) -> None:
    page = live.page
    page.fill("#sweep-low", "200")
    page.fill("#sweep-high", "900")
    page.click("#sweep-form button")
    assert "the stage travels from 120 to 620 mm, not to 900 mm" in told(page)
    wait_until(lambda: page.input_value("#sweep-high") == "", "set back")
    assert page.input_value("#sweep-low") == "200"
    page.fill("#sweep-low", "")


def test_a_height_that_was_taken_is_what_a_wrong_one_is_set_back_to(live: LivePage) -> None:
    page = live.page
    for typed in ("300", "301"):
        page.fill("#move-to", typed)
        page.keyboard.press("Enter")
        wait_until(lambda typed=typed: text(page, "#stage-height") == f"{typed}.000", "there")  # type: ignore[misc]
        page.wait_for_selector("#move-form button:enabled")
    page.fill("#move-to", "3000")
    page.keyboard.press("Enter")
    assert "not to 3000 mm" in told(page)
    wait_until(lambda: page.input_value("#move-to") == "301", "set back")
    page.fill("#move-to", "")


PLAN_FIELDS = {
    "frames": ("1", "2.5", "-3", "1001", "1e", "1e7"),
    "repeats": ("0", "", "2.5", "1001", "--"),
    "settle_s": ("-1", "3601", "1e"),
    "heights": ("x", "5 5", "1 to 9 step 0"),
    "targets bracket_exposures": ("1", "13", "2.5", "1e"),
    "targets bracket_ratio": ("1", "99", ""),
    "targets orientations": ("400", "x"),
    "targets exposures": ("-4", "1 to 9 step 2"),
}
"""Wrong values of the plan editor by the field's name; those of a target follow the word."""


def test_the_plan_editor_says_at_the_field_what_is_wrong(browser: Browser, tmp_path: Path) -> None:
    with live_page(browser, idle_hub(tmp_path)) as live:
        page = live.page
        page.goto(f"{page.url}plans/edit?plan=two")
        page.wait_for_selector("#save-plan:enabled")
        numbers = page.eval_on_selector_all(
            "#plan-form input[type=number]", "all => all.map(f => f.name)"
        )
        assert set(numbers) <= {key.split()[-1] for key in PLAN_FIELDS}
        page.fill("[name=bracket_exposures]", "3")
        for key, values in PLAN_FIELDS.items():
            own = "#targets" if " " in key else ".fields"
            field = page.locator(f"{own} [name={key.split()[-1]}]").first
            good = field.input_value()
            for value in values:
                field.focus()
                page.keyboard.press("Control+a")
                page.keyboard.press("Delete")
                page.keyboard.type(value)
                wait_until(
                    lambda field=field: field.get_attribute("aria-invalid") == "true",  # type: ignore[misc]
                    f"{key} {value!r} is marked",
                )
                words = text(page, "#draft-fault")
                assert words, (key, value)
                assert not PROGRAMMERS_WORDS.search(re.sub(r"\[.*\]", "", words)), words
                field.fill(good)
                wait_until(
                    lambda: not page.is_visible("#draft-fault") and bool(text(page, "#draft-cost")),
                    "all is well",
                )
        assert page.locator("#notices li").count() == 0  # it is said at the field alone
