"""Lost, slow and held connections between a page and the console, in Chromium."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


from playwright.sync_api import Browser, Page

from acquisition.focus import Region
from standoff.console.bench_hub import BenchHub
from standoff.shipped_configs import shipped_config
from tests.standoff.console.chromium.pages import opened_page
from tests.standoff.console.console_rig import (
    move_to,
    number,
    take_control,
    text,
    wait_until,
)
from tests.standoff.console.hub_fixtures import running_hub, textured_hub
from tests.standoff.console.networks import HoldingProxy, holding_proxy, slow_link
from tests.standoff.console.processes import first_line, standoff_process
from tests.standoff.console.served import served

pytestmark = [pytest.mark.slow(minutes=0.5), pytest.mark.waits]

TRIES = 3
"""Of what must be quick: this computer may do something else meanwhile, but not each time."""

LOST_MS, ANSWER_MS = 1500, 1000
CLOCK = """() => {
    const { connection } = standoff;
    const [stop, alert] = ["stop", "alert-stop"].map((id) => document.getElementById(id));
    const waited = () => performance.now() - clock.pressed;
    window.clock = { lost: [], unheard: [], heard: [], pressed: 0 };
    connection.addEventListener("lost", () => clock.lost.push(connection.silentMs));
    connection.addEventListener("stop-heard", () => clock.heard.push(waited()));
    stop.addEventListener("click", () => { clock.pressed = performance.now(); }, true);
    new MutationObserver(() => { if (!alert.hidden) clock.unheard.push(waited()); })
        .observe(alert, { attributeFilter: ["hidden"] });
}"""


@contextmanager
def bench_page(browser: Browser, url: str) -> Iterator[Page]:
    """Open the bench page, with clocks for what is to be quick."""
    with opened_page(browser, url) as page:
        page.wait_for_selector("#chip-stage.ok")
        page.evaluate(CLOCK)
        yield page


def homed(page: Page) -> None:
    """Take control, and home the stage."""
    take_control(page)
    wait_until(lambda: page.is_enabled("#home"), "the stage is free")
    page.click("#home")
    wait_until(lambda: page.is_enabled("#move-to"), "homed")


def fastest(page: Page, clock: str) -> float:
    return float(page.evaluate(f"Math.min(...clock.{clock})"))


@pytest.fixture
def slow_stage(tmp_path: Path) -> Iterator[BenchHub]:
    with running_hub(tmp_path, stage__feed_mm_per_min=1500.0, camera__frame_rate_hz=10.0) as hub:
        yield hub


@pytest.fixture
def network(slow_stage: BenchHub) -> Iterator[HoldingProxy]:
    with served(slow_stage) as address, holding_proxy(address) as proxy:
        yield proxy


def test_a_console_that_is_stopped_is_seen_and_stop_says_that_it_was_not_heard(
    browser: Browser, tmp_path: Path
) -> None:
    with standoff_process(
        "console", "--bench", shipped_config("simulated.toml"), "--port", 0, "--json",
        "--sessions", tmp_path / "sessions", "--set", "simulated.width_px=64",
        "--set", "simulated.height_px=48", cwd=tmp_path,
    ) as console, bench_page(browser, first_line(console)["url"]) as page:  # fmt: skip
        take_control(page)
        for _ in range(TRIES):
            os.kill(console.pid, signal.SIGSTOP)
            try:
                page.wait_for_selector("#alert-connection:visible")
                page.click("#stop")
                page.wait_for_selector("#alert-stop:visible")
                assert "STOP was NOT heard" in text(page, "#alert-stop")
                assert text(page, "#control-text") == "not connected"
            finally:
                os.kill(console.pid, signal.SIGCONT)
            # It went on trying.
            page.wait_for_selector("#alert-stop", state="hidden")
            page.wait_for_selector("#alert-connection", state="hidden")
            wait_until(lambda: page.is_enabled("#home"), "in control as before")
            if fastest(page, "lost") < LOST_MS and fastest(page, "unheard") < ANSWER_MS:
                break
        assert fastest(page, "lost") < LOST_MS
        assert fastest(page, "unheard") < ANSWER_MS


def test_what_is_held_on_the_way_greys_every_figure_and_then_shows_none(
    browser: Browser, network: HoldingProxy, slow_stage: BenchHub
) -> None:
    with bench_page(browser, network.url) as page:
        homed(page)
        wait_until(lambda: number(page, "#focus-percent") > 0, "focus is measured")
        move_to(page, 480)
        wait_until(lambda: number(page, "#stage-height") > 130, "it moves")
        network.is_holding = True
        page.wait_for_selector("body.lost")
        assert "at least that old" in text(page, "#alert-connection")
        greyed = "getComputedStyle(document.querySelector('#stage .reading')).filter"
        assert page.evaluate(greyed) == "grayscale(1)"
        age = "getComputedStyle(document.querySelector('#stage'), '::after').content"
        assert page.evaluate(age).endswith(' s old"')
        figures = ("#focus-percent", "#focus-value", "#stage-height", "#mean")
        wait_until(lambda: {text(page, each) for each in figures} == {"–"}, "no figure is shown")
        assert text(page, "#stage-motion") == "not known"
        wait_until(lambda: text(page, "#camera-rate").startswith("– frames/s"), "and no rate")
        assert not page.is_enabled("#move-form button[type=submit]")
        network.is_holding = False
        wait_until(lambda: number(page, "#stage-height") > 130, "the height is shown again")
        assert not page.is_visible("#alert-connection")
        assert page.evaluate(greyed) == "none"


def test_a_stop_that_is_held_stops_once_it_arrives_and_only_once(
    browser: Browser, network: HoldingProxy, slow_stage: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    stops: list[float] = []
    stop = slow_stage.stop

    def noted() -> None:
        stops.append(time.monotonic())
        stop()

    monkeypatch.setattr(slow_stage, "stop", noted)
    with bench_page(browser, network.url) as page:
        homed(page)
        move_to(page, 480)
        wait_until(lambda: number(page, "#stage-height") > 130, "it moves")
        network.is_holding = True
        page.wait_for_selector("body.lost")
        page.keyboard.press("Escape")
        page.wait_for_selector("#alert-stop:visible")
        # So long that another connection is tried, too.
        wait_until(lambda: page.evaluate("standoff.connection.silentMs") > 7000, "it goes on")
        assert stops == []
        network.is_holding = False
        page.wait_for_selector("#alert-stop", state="hidden")
        assert "STOP was heard after" in text(page, "#notices")
        wait_until(lambda: text(page, "#stage-motion") == "at rest", "the stage stands")
        page.wait_for_timeout(1000)
        assert len(stops) == 1
        assert number(page, "#stage-height") < 470


def test_a_slow_answer_is_told_and_none_at_all_is_an_alert(
    browser: Browser, network: HoldingProxy
) -> None:
    with bench_page(browser, network.url) as page:
        take_control(page)
        assert not page.is_visible("#chip-latency")
        network.delay_s = 0.7
        page.wait_for_selector("#chip-latency:visible")
        assert text(page, "#chip-latency").startswith("answers take ")
        network.delay_s = 0.0
        page.wait_for_selector("#chip-latency", state="hidden")
        # Of the page nothing arrives, though it hears everything.
        network.is_mute = True
        page.wait_for_selector("#alert-mute:visible")
        assert not page.is_visible("#alert-connection")
        page.click("#stop")
        page.wait_for_selector("#alert-stop:visible")
        network.is_mute = False
        page.wait_for_selector("#alert-stop", state="hidden")
        page.wait_for_selector("#alert-mute", state="hidden")


PAGES = 5
STAGE_S = 0.5


def test_stop_of_a_page_that_watches_among_five_reaches_the_stage(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told_s: list[float] = []
    keys = {"simulated__width_px": 780, "simulated__height_px": 580, "camera__frame_rate_hz": 60.0}
    with (
        running_hub(tmp_path, stage__feed_mm_per_min=1500.0, **keys) as hub,
        served(hub) as (host, port),
        ExitStack() as open_,
    ):
        stop = hub.stage.stop

        def noted() -> None:
            told_s.append(time.time())
            stop()

        monkeypatch.setattr(hub.stage, "stop", noted)
        pages = [
            open_.enter_context(bench_page(browser, f"http://{host}:{port}/")) for _ in range(PAGES)
        ]
        first, watching = pages[0], pages[-1]
        homed(first)
        region = Region(x_px=200, y_px=150, width_px=400, height_px=300)
        hub.picture.look_at(region)
        hub.sharpness.look_at(region)
        hub.sharpness.watch_field(True)
        took_s = []
        for _ in range(TRIES):
            move_to(first, 600)
            wait_until(lambda: text(first, "#stage-motion") == "moving", "it moves")
            first.wait_for_timeout(1000)
            told_s.clear()
            watching.click("#stop")
            wait_until(lambda: bool(told_s), "the stage is told")
            pressed_s = watching.evaluate("(performance.timeOrigin + clock.pressed) / 1000")
            took_s.append(told_s[0] - pressed_s)
            wait_until(lambda: text(first, "#stage-motion") == "at rest", "the stage stands")
            wait_until(lambda: first.is_enabled("#home"), "the move has ended")
            if min(took_s) < STAGE_S and fastest(watching, "heard") < ANSWER_MS:
                break
        assert min(took_s) < STAGE_S
        assert fastest(watching, "heard") < ANSWER_MS
        assert not watching.is_visible("#alert-stop")


@contextmanager
def slow_page(
    browser: Browser, folder: Path, rate_bytes_per_s: float, one_way_s: float
) -> Iterator[Page]:
    with (
        textured_hub(folder) as hub,
        served(hub) as address,
        slow_link(address, rate_bytes_per_s, one_way_s) as link,
        opened_page(browser, link.url) as page,
    ):
        page.wait_for_selector("body.mine")
        page.evaluate("() => { standoff.first = standoff.connection.socket; }")
        yield page
        assert page.evaluate("standoff.connection.socket === standoff.first"), "disconnected"


def stop_heard_ms(page: Page) -> float:
    """Time from STOP to the console's word that it was heard, of the best of three."""
    return float(
        page.evaluate("""async () => {
            const took = [];
            for (let time = 0; time < 3; time++) {
                const pressed = performance.now();
                const heard = new Promise((done) =>
                    standoff.connection.addEventListener("stop-heard", done, { once: true }));
                document.getElementById("stop").click();
                await heard;
                took.push(performance.now() - pressed);
            }
            return Math.min(...took);
        }""")
    )


@pytest.mark.parametrize(
    ("rate_bytes_per_s", "one_way_s", "least_hz", "most_ms"),
    [(1e6, 0.1, 8.0, 400.0), (60e3, 0.1, 1.0, 1000.0)],
)
def test_pictures_keep_up_with_the_link_and_stop_comes_before_them(
    browser: Browser,
    tmp_path: Path,
    rate_bytes_per_s: float,
    one_way_s: float,
    least_hz: float,
    most_ms: float,
) -> None:
    with slow_page(browser, tmp_path, rate_bytes_per_s, one_way_s) as page:
        wait_until(
            lambda: bool(
                page.evaluate(
                    "standoff.picture.times.length === 30"
                    f" && standoff.picture.rate() >= {least_hz}"
                    f" && standoff.picture.latencyMs() <= {most_ms}"
                )
            ),
            f"{least_hz:g} pictures a second, {most_ms:g} ms old",
        )
        shown = text(page, "#picture-rate")
        assert "compressed" in shown or "the connection is slow" in shown
        # Saturated pixels are red, and only they, whatever the form of the picture.
        canvas = "standoff.picture.context.getImageData"
        assert page.evaluate(f"[...{canvas}(30, 30, 1, 1).data]") == [255, 32, 32, 255]
        red, green, blue, _ = page.evaluate(f"[...{canvas}(400, 300, 1, 1).data]")
        assert red == green == blue
        assert stop_heard_ms(page) < 1000.0


def test_a_fast_link_shows_every_pixel_as_it_is(browser: Browser, tmp_path: Path) -> None:
    with (
        textured_hub(tmp_path, noise_dn=0.0) as hub,
        served(hub) as (host, port),
        opened_page(browser, f"http://{host}:{port}/") as page,
    ):
        page.wait_for_selector("body.mine")
        wait_until(lambda: bool(page.evaluate("standoff.picture.isExact")), "exact pictures")
        shown = page.evaluate(
            "[...standoff.picture.context.getImageData(0, 0, 780, 580).data]"
            ".filter((_, index) => index % 4 === 1)"
        )
        latest = hub.frames.latest
        assert latest is not None
        expected = np.rint(latest.image_dn * (254 / 4095))
        expected[latest.image_dn == 4095] = 32  # red
        assert np.array_equal(np.array(shown).reshape(580, 780), expected)


def test_the_age_of_a_picture_is_by_the_consoles_clock(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def an_hour_ago() -> float:
        return time.time() - 3600.0

    with textured_hub(tmp_path) as hub:
        monkeypatch.setattr(hub.frames, "_clock", an_hour_ago)
        monkeypatch.setattr("standoff.console.web._live_sockets.wall_s", an_hour_ago)
        with served(hub) as (host, port), opened_page(browser, f"http://{host}:{port}/") as page:
            page.wait_for_selector("body.mine")
            wait_until(
                lambda: (
                    abs(page.evaluate("standoff.picture.latencyMs()")) < 5e3
                    and page.evaluate("standoff.picture.times.length") == 30
                ),
                "an age without the difference of the clocks",
            )
