"""The reference over the live picture, in Chromium, on pictures whose every level is known."""

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


from playwright.sync_api import Browser

from standoff.console.bench_hub import BenchHub
from tests.acquisition.fakes import SETTINGS
from tests.standoff.console.chromium.pages import (
    COLS,
    ROWS,
    LivePage,
    Streaming,
    even_dn,
    level_at,
    live_page,
    seen,
    step_dn,
    streaming,
)
from tests.standoff.console.console_rig import text, wait_until
from tests.standoff.console.hub_fixtures import idle_hub
from tests.standoff.console.networks import holding_proxy
from tests.standoff.console.served import served

pytestmark = [pytest.mark.slow, pytest.mark.waits]

LIVE, BEFORE = 20, 50
"""Levels of the picture and of the reference, of 254."""

NUMBERS = itertools.count()

TURNS = ("REFERENCE", "live picture")

WATCH_LABEL = """() => {
    const label = document.getElementById("reference-label");
    const photo = document.getElementById("reference-photo");
    window.turns = [];
    new MutationObserver(() => window.turns.push([label.textContent, !photo.hidden]))
      .observe(label, { childList: true, characterData: true, subtree: true });
}"""


def turns_of(live: LivePage) -> list[str]:
    """What took turns; a picture that came late in between is no turn."""
    labels = [label for label, _ in live.asked("window.turns") if label in TURNS]
    return [label for label, _ in itertools.groupby(labels)]


NEVER_STALE = """() => {
    const frame = document.getElementById("frame");
    const { toggle } = frame.classList;
    frame.classList.toggle = function (name, isOn) {
        return toggle.call(this, name, isOn && name !== "stale");
    };
}"""


@pytest.fixture
def hub(tmp_path: Path) -> BenchHub:
    return idle_hub(tmp_path)


@pytest.fixture
def picture(hub: BenchHub) -> Iterator[Streaming]:
    with streaming(hub, even_dn(LIVE)) as made:
        yield made


@pytest.fixture
def live(browser: Browser, hub: BenchHub, picture: Streaming) -> Iterator[LivePage]:
    with live_page(browser, hub) as made:
        choose(made, even_dn(BEFORE))
        yield made


def choose(live: LivePage, image_dn: NDArray[np.uint16]) -> None:
    """Make an image the reference, and wait until the page knows it."""
    name = f"picture {next(NUMBERS)}"
    live.hub.pose.choose(name, image_dn, SETTINGS.max_level_dn)
    wait_until(lambda: text(live.page, "#pose-reference").endswith(name), "the page knows it")
    wait_until(lambda: not live.asked("document.querySelector('#frame.stale')"), "live pictures")


def wait_seen(live: LivePage, grey: Callable[[int], bool], what: str) -> None:
    wait_until(lambda: all(map(grey, level_at(live, COLS / 2, ROWS / 2))), what)


def nearly(level: float) -> Callable[[int], bool]:
    return lambda seen_level: abs(seen_level - level) <= 1.5  # two roundings


def test_a_blend_shows_levels_between_both_by_the_share_of_the_slider(live: LivePage) -> None:
    wait_seen(live, nearly(LIVE), "the live picture alone")
    assert live.page.is_hidden("#reference-label")
    live.page.select_option("#reference-how", "blend")
    wait_seen(live, nearly((LIVE + BEFORE) / 2), "half of each")
    assert text(live.page, "#reference-label") == "REFERENCE, 50 %, over the live picture"
    live.page.fill("#reference-share", "20")
    wait_seen(live, nearly(0.8 * LIVE + 0.2 * BEFORE), "a fifth of the reference")
    live.page.fill("#reference-share", "100")
    wait_seen(live, nearly(BEFORE), "the reference alone")
    assert text(live.page, "#reference-label") == "REFERENCE alone"
    live.page.select_option("#reference-how", "off")
    wait_seen(live, nearly(LIVE), "the live picture alone again")


def test_the_reference_is_brightened_with_the_live_picture(live: LivePage) -> None:
    live.page.select_option("#reference-how", "blend")
    live.page.keyboard.press("b")
    wait_seen(live, nearly(4 * (LIVE + BEFORE) / 2), "four times as bright")
    live.page.keyboard.press("b")
    wait_seen(live, nearly((LIVE + BEFORE) / 2), "as before")


def test_a_blinking_reference_takes_turns_and_the_label_says_whose_turn_it_is(
    live: LivePage,
) -> None:
    live.asked(WATCH_LABEL)
    live.page.keyboard.press("r")
    assert live.page.input_value("#reference-how") == "blink"
    wait_until(lambda: len(turns_of(live)) > 6, "six turns")
    turns = turns_of(live)
    start = turns.index("REFERENCE")
    assert turns[start : start + 6] == ["REFERENCE", "live picture"] * 3
    live.page.select_option("#reference-how", "off")
    wait_seen(live, nearly(LIVE), "the live picture alone")


def test_with_reduced_motion_the_reference_blinks_by_hand_alone(
    browser: Browser, hub: BenchHub, picture: Streaming
) -> None:
    with live_page(browser, hub, reduced_motion="reduce") as live:
        choose(live, even_dn(BEFORE))
        live.page.select_option("#reference-how", "blink")
        wait_seen(live, nearly(BEFORE), "the reference")
        live.asked(WATCH_LABEL)
        live.page.wait_for_timeout(2500)  # of five turns otherwise
        assert "live picture" not in turns_of(live)
        live.page.locator("#frame").focus()
        live.page.keyboard.press("r")
        wait_seen(live, nearly(LIVE), "the live picture")
        assert text(live.page, "#reference-label") == "live picture"
        live.page.click("#reference-turn")
        wait_seen(live, nearly(BEFORE), "the reference again")
        assert text(live.page, "#reference-label") == "REFERENCE"


def magenta_px(live: LivePage) -> NDArray[np.float64]:
    """Columns of the picture at which the edges' colour is seen, from the left of its pixels."""
    blue, green, red = np.moveaxis(seen(live), 2, 0)
    columns = np.nonzero((red > 200) & (blue > 200) & (green < 120))[1] + 0.5
    left, scale = live.asked("[standoff.view.left, standoff.view.scale]")
    return np.asarray((columns - left) / scale)


def test_edges_of_a_shifted_reference_lie_where_it_has_them_at_every_zoom_and_pan(
    live: LivePage, picture: Streaming
) -> None:
    column_px, shift_px = 52.0, 12.0
    picture.image_dn = step_dn(column_px)
    choose(live, step_dn(column_px - shift_px))
    live.page.keyboard.press("o")
    live.page.keyboard.press("o")
    live.page.keyboard.press("o")
    assert live.page.input_value("#reference-how") == "edges"
    assert text(live.page, "#reference-label") == "edges of the REFERENCE over the live picture"
    for moves in ("", "standoff.view.move(1.7)", "standoff.view.move(1.3, null, [500, 420])"):
        if moves:
            live.asked(f"({moves}, 0)")
        # Centre of the pixel of the edge, which the screen may show half a pixel aside.
        wait_until(lambda: edges_lie_at(live, column_px - shift_px + 0.5), "the edges")
        # They are hidden, and so nowhere, while the live picture is late.
        wait_until(lambda: asides_px(live) < 0.01, "edges in the picture's place")
    wait_seen_beside(live, 46.0)


def edges_lie_at(live: LivePage, column_px: float) -> bool:
    found_px = magenta_px(live)
    return len(found_px) > 100 and np.abs(found_px - column_px).max() <= 1.5


def asides_px(live: LivePage) -> float:
    """How far the edges begin from the picture, on the screen."""
    return float(
        live.asked(
            "Math.abs(document.getElementById('picture').getBoundingClientRect().x"
            " - document.getElementById('reference-edges').getBoundingClientRect().x)"
        )
    )


def wait_seen_beside(live: LivePage, x_px: float) -> None:
    """Between both edges, the live picture is seen through what is transparent."""
    wait_until(
        lambda: all(map(nearly(600 * 254 / 4095), level_at(live, x_px, ROWS / 2))), "the dark side"
    )


def test_a_reference_of_another_size_is_refused_in_words_and_lies_nowhere(live: LivePage) -> None:
    live.page.select_option("#reference-how", "blend")
    wait_seen(live, nearly((LIVE + BEFORE) / 2), "a blend")
    choose(live, even_dn(BEFORE, 45, 60))
    live.page.wait_for_selector("#overlay-fault:visible")
    assert text(live.page, "#overlay-fault") == (
        "The reference has 60 × 45 pixels, the live picture 120 × 90: it cannot be overlaid."
    )
    wait_seen(live, nearly(LIVE), "the live picture alone")
    assert live.page.is_hidden("#reference-label")
    assert live.page.is_disabled("#reference-how")


def test_the_overlay_goes_with_the_reference(live: LivePage) -> None:
    live.page.select_option("#reference-how", "blend")
    wait_seen(live, nearly((LIVE + BEFORE) / 2), "a blend")
    choose(live, even_dn(100))
    wait_seen(live, nearly((LIVE + 100) / 2), "a blend with the next reference")
    live.page.click("#pose-clear")
    live.page.wait_for_selector("#reference-choice", state="hidden")
    wait_seen(live, nearly(LIVE), "the live picture alone")
    assert live.page.is_hidden("#reference-label")


def test_each_reference_is_fetched_once_for_each_view(live: LivePage) -> None:
    asked: list[str] = []
    live.page.on("request", lambda request: asked.append(request.url))
    for _ in range(2):
        for how in ("blend", "edges", "blink", "off"):
            live.page.select_option("#reference-how", how)
            live.page.wait_for_timeout(300)
    views = [url.split("view=")[1].split("&")[0] for url in asked if "/pose/reference.png" in url]
    assert sorted(views) == ["edges", "photo"]


def test_over_a_dead_camera_no_reference_looks_live(live: LivePage, picture: Streaming) -> None:
    live.page.select_option("#reference-how", "blend")
    live.page.fill("#reference-share", "100")
    wait_seen(live, nearly(BEFORE), "the reference alone")
    picture.is_dead.set()
    live.page.wait_for_selector("#frame.stale")
    live.page.wait_for_selector("#reference-photo", state="hidden")
    label = "no live picture: the reference is not shown"
    wait_until(lambda: text(live.page, "#reference-label") == label, "it is said")


def test_of_a_lost_console_no_reference_looks_live_though_exposures_are_long(
    browser: Browser, hub: BenchHub, picture: Streaming
) -> None:
    with served(hub) as address, holding_proxy(address) as network:
        page = browser.new_page()
        page.goto(network.url)
        page.wait_for_selector("body.mine")
        hub.pose.choose("before", even_dn(BEFORE), SETTINGS.max_level_dn)
        page.wait_for_selector("#reference-choice:visible")
        page.select_option("#reference-how", "blend")
        page.wait_for_selector("#reference-photo:visible")
        # As if each picture took a minute: none is late yet.
        page.evaluate(NEVER_STALE)
        network.is_holding = True
        page.wait_for_selector("body.lost")
        assert page.is_hidden("#reference-photo")
        label = "no live picture: the reference is not shown"
        wait_until(lambda: text(page, "#reference-label") == label, "it is said")
        network.is_holding = False
        page.wait_for_selector("#reference-photo:visible")
        page.context.close()
