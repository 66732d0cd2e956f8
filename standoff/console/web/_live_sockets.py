"""Every page's websocket: what it sends is carried out, and it is sent the newest data."""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from time import time as wall_s
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from standoff.console.access import Allowance
from standoff.console.bench_hub import BenchHub, ConsoleHub
from standoff.console.frames import PictureEncoder
from standoff.console.page_words import page_words
from standoff.console.web._command_handler import CommandHandler, parse_message
from standoff.console.web._link import PERIOD_S, Link, PicturePace
from standoff.console.web._messages import (
    Acknowledge,
    Hello,
    MessageError,
    PageMessage,
    Ping,
    Stop,
    key_at_fault,
)
from standoff.console.web._session_commands import SessionCommands
from standoff.console.web._view_model import (
    control_document,
    figure_ages,
    levels_document,
    measure_document,
    plan_document,
    state_document,
    sweep_document,
)
from standoff.errors import REPORTED_ERRORS
from standoff.library import login_name

STATE_S = 0.08
LEVELS_S = 0.15
STATE_PERIOD_S = 0.1
LEVELS_PERIOD_S = 0.2
MEASURE_PERIOD_S = 0.1

SLOW_BYTES_PER_S, SLOWDOWN = 300e3, 3.0
"""Over a link that is slower than that, all these periods are so many times as long."""

HELLO_TIMEOUT_S = 10.0

REPLACED = 4001

MESSAGES_AT_ONCE, MESSAGE_PERIOD_S = 100, 0.005
"""Messages of one page that are read in one go, and the time for each one more: a page that
acknowledges 30 pictures a second while a region is drawn sends about 90."""

COMMANDS_WAITING = 64
"""Commands of one page that wait for their turn: reading goes on, as the next one may be STOP."""

STOPS_KNOWN = 256
"""Stops that are remembered, so that one that is sent until it is answered counts once."""


class StateCache:
    """JSON texts, each no older than the interval at which pages are sent it."""

    def __init__(self, hub: ConsoleHub) -> None:
        self._hub = hub
        self._state_s, self._state = float("-inf"), dict[str, str]()
        self._levels_s, self._levels = float("-inf"), ""
        self._documents: dict[str, tuple[tuple[object, ...], str]] = {}

    def state(self) -> dict[str, str]:
        """The state that is common to all pages, part by part."""
        now_s = time.monotonic()
        if now_s - self._state_s > STATE_S:
            self._state_s = now_s
            self._state = {
                name: json.dumps(part, allow_nan=False)
                for name, part in state_document(self._hub).items()
            }
        return self._state

    def levels(self, hub: BenchHub) -> str | None:
        """Histogram and focus trace; None without a picture, or with none but an old one."""
        facts = hub.picture.facts
        if facts.levels is None or figure_ages(hub)["levels"].validity == "none":
            return None
        now_s = time.monotonic()
        if now_s - self._levels_s > LEVELS_S:
            self._levels_s = now_s
            self._levels = json.dumps(levels_document(facts), allow_nan=False)
        return self._levels

    def measure(self, hub: BenchHub) -> str:
        """Live measurements."""
        sharpness, square = hub.sharpness, hub.squareness.view
        view, has_field = sharpness.view, sharpness.is_field_wanted
        return self._made_of(
            "measure", (view, square), lambda: measure_document(view, square, has_field=has_field)
        )

    def sweep(self, hub: BenchHub) -> str:
        """The focus sweep."""
        view = hub.sweep.view
        return self._made_of("sweep", (view,), lambda: sweep_document(view))

    def plan(self, hub: BenchHub) -> str:
        """The plan's table."""
        view = hub.run.view
        return self._made_of("plan", (view,), lambda: plan_document(view))

    def _made_of(
        self, name: str, views: tuple[object, ...], make: Callable[[], dict[str, Any]]
    ) -> str:
        """The document of some views, made anew when one of them is another."""
        seen, text = self._documents.get(name, ((), ""))
        if len(seen) != len(views) or any(a is not b for a, b in zip(seen, views, strict=True)):
            text = json.dumps(make(), allow_nan=False)
            self._documents[name] = (views, text)
        return text


class LiveSockets:
    """Every page's websocket, and what all pages share."""

    def __init__(self, hub: ConsoleHub) -> None:
        self.hub = hub
        self.bench = hub if isinstance(hub, BenchHub) else None
        self.handler = SessionCommands(hub) if self.bench is None else CommandHandler(self.bench)
        self.encoder = PictureEncoder()
        self.state = StateCache(hub)
        self.stops: deque[str] = deque(maxlen=STOPS_KNOWN)
        # One at a time, and never in the loop that sends the pictures.
        self.worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="commands")
        self._pages: dict[str, _Page] = {}

    async def serve(self, socket: WebSocket) -> None:
        """Serve one page until it is gone; one that is opened again takes the old one's place."""
        await socket.accept()
        try:
            async with asyncio.timeout(HELLO_TIMEOUT_S):
                hello = parse_message(await socket.receive_text())
        except (TimeoutError, WebSocketDisconnect, KeyError):
            return
        except MessageError:
            hello = None
        if not isinstance(hello, Hello):
            await socket.close(code=1008, reason="send hello first")
            return
        old = self._pages.pop(hello.viewer, None)
        if old is not None:
            with suppress(RuntimeError):  # it was closed already
                await old.socket.close(code=REPLACED, reason="opened again elsewhere")
        page = self._pages[hello.viewer] = _Page(self, socket, hello)
        self.hub.control.join(hello.viewer, hello.name or login_name())
        try:
            await page.serve()
        finally:
            if self._pages.get(hello.viewer) is page:
                del self._pages[hello.viewer]
                self.hub.control.leave(hello.viewer)


class _Page:
    """One page's connection: sends it the newest data, and executes what it sends."""

    def __init__(self, console: LiveSockets, socket: WebSocket, hello: Hello) -> None:
        self.socket = socket
        self._console = console
        self._bench = console.bench
        self._live = console.bench if hello.pictures else None
        self._identity = hello.viewer
        self._link = Link()
        self._pace = PicturePace(self._link, console.encoder)
        self._wake = asyncio.Event()
        self._replies: deque[dict[str, Any]] = deque(maxlen=32)
        self._waiting: asyncio.Queue[PageMessage | None] = asyncio.Queue(COMMANDS_WAITING)
        self._sent_sequence = 0
        self._told: dict[str, str] = {}
        self._plan_revision = self._sweep_revision = self._measured = -1
        self._was_watched = False

    async def serve(self) -> None:
        """Send and receive until the page is gone; what it sent before it left is still done."""
        sending = asyncio.create_task(self._send_all())
        working = asyncio.create_task(self._work())
        try:
            await self._read(working)
        finally:
            try:
                if not working.done():
                    await self._waiting.put(None)
                await working
            finally:
                sending.cancel()

    async def _read(self, working: asyncio.Task[None]) -> None:
        pace = Allowance(at_once=MESSAGES_AT_ONCE, period_s=MESSAGE_PERIOD_S, clock=time.monotonic)
        while not working.done():
            await asyncio.sleep(pace.take())  # if only for the turns of the others
            try:
                text = await self.socket.receive_text()
            except (WebSocketDisconnect, RuntimeError):
                return
            except KeyError:
                self._refuse("a message must be text")
                continue
            self._take(text)

    def _take(self, text: str) -> None:
        """Do what must not wait, and put the rest behind what the page sent before."""
        try:
            match parse_message(text):
                case Acknowledge(sequence=sequence, in_hand_ms=in_hand_ms):
                    now_s = time.monotonic()
                    self._link.note_arrived(sequence, now_s, in_hand_s=1e-3 * in_hand_ms)
                    self._wake.set()
                case Ping(number=number, round_trip_ms=round_trip_ms):
                    if round_trip_ms is not None:
                        self._link.note_round_trip(1e-3 * round_trip_ms)
                    self._reply_first({"type": "pong", "number": number, "now_ms": 1e3 * wall_s()})
                case Stop() as message:
                    self._stop(message)
                case message:
                    self._waiting.put_nowait(message)
        except asyncio.QueueFull:
            self._refuse("too many commands at once: try again")
        except MessageError as error:
            self._refuse(str(error), error.do, error.key)
        except REPORTED_ERRORS as error:
            self._refuse(str(error))

    def _stop(self, message: Stop) -> None:
        """Stop, and say that it was heard; a stop that comes again is only answered."""
        known = self._console.stops
        if message.id is None or message.id not in known:
            self._console.handler.carry_out(self._identity, message)
        if message.id is not None:
            known.append(message.id)
            bench = self._bench
            number = 0 if bench is None else bench.stopping.view.number
            self._reply_first({"type": "stop-heard", "id": message.id, "number": number})

    async def _work(self) -> None:
        """Execute what the page sends, one after the other, until it is gone."""
        loop, console = asyncio.get_running_loop(), self._console
        while (message := await self._waiting.get()) is not None:
            try:
                answer = await loop.run_in_executor(
                    console.worker, console.handler.carry_out, self._identity, message
                )
            except REPORTED_ERRORS as error:
                self._refuse(str(error), message.do, key_at_fault(message, error))
                continue
            if answer is not None:
                self._reply(answer)

    def _reply(self, document: dict[str, Any]) -> None:
        self._replies.append(document)
        self._wake.set()

    def _reply_first(self, document: dict[str, Any]) -> None:
        """Answer before everything else that waits to be sent."""
        self._replies.appendleft(document)
        self._wake.set()

    def _refuse(self, text: str, do: str = "", key: str = "") -> None:
        """Tell a page that it asked for something in vain; a field at fault is set back."""
        self._reply({"type": "refused", "text": page_words(text), "do": do, "key": key})

    async def _send_all(self) -> None:
        """Send until the page is gone."""
        loop = asyncio.get_running_loop()

        def woken() -> None:
            loop.call_soon_threadsafe(self._wake.set)

        end = None if self._live is None else self._live.frames.subscribe(woken)
        try:
            await self._send_on()
        except (WebSocketDisconnect, RuntimeError):
            return  # the page is gone: the receiving side notices, too
        finally:
            if end is not None:
                end()

    async def _send_on(self) -> None:
        state_s = levels_s = measure_s = 0.0
        while True:
            await self._woken()
            while self._replies:
                reply = json.dumps(self._replies.popleft(), allow_nan=False)
                await self.socket.send_text(reply)
            now_s = time.monotonic()
            slowdown = self._slowdown
            if now_s - state_s >= slowdown * STATE_PERIOD_S:
                state_s = now_s
                await self._send_state()
            if self._live is None:
                continue
            if now_s - levels_s >= slowdown * LEVELS_PERIOD_S:
                levels_s = now_s
                levels = self._console.state.levels(self._live)
                if levels is not None:
                    await self.socket.send_text(levels)
            if now_s - measure_s >= slowdown * MEASURE_PERIOD_S:
                measure_s = now_s
                await self._send_measurements(self._live)
            await self._send_picture(self._live, now_s)

    @property
    def _slowdown(self) -> float:
        rates = self._link.rates
        return 1.0 if rates is None or rates.possibly >= SLOW_BYTES_PER_S else SLOWDOWN

    async def _woken(self) -> None:
        try:
            async with asyncio.timeout(min(STATE_PERIOD_S / 2, PERIOD_S)):
                await self._wake.wait()
        except TimeoutError:
            return
        self._wake.clear()

    async def _send_state(self) -> None:
        """Send what has become different; the page keeps the rest."""
        control = control_document(self._console.hub.control.view(self._identity))
        state = {"control": json.dumps(control)} | self._console.state.state()
        news = ['"type":"state"']
        news += [f'"{name}":{text}' for name, text in state.items() if self._told.get(name) != text]
        self._told = state
        await self.socket.send_text("{" + ",".join(news) + "}")
        if self._bench is None:
            return
        revision = self._bench.run.view.revision
        if revision != self._plan_revision:
            self._plan_revision = revision
            await self.socket.send_text(self._console.state.plan(self._bench))

    async def _send_measurements(self, hub: BenchHub) -> None:
        sequence = hub.sharpness.view.sequence
        is_watched = hub.squareness.view.is_wanted
        if is_watched or self._was_watched or sequence != self._measured:
            self._measured, self._was_watched = sequence, is_watched
            await self.socket.send_text(self._console.state.measure(hub))
        revision = hub.sweep.view.revision
        if revision != self._sweep_revision:
            self._sweep_revision = revision
            await self.socket.send_text(self._console.state.sweep(hub))

    async def _send_picture(self, hub: BenchHub, now_s: float) -> None:
        """Send the newest picture if its link is ready for one."""
        latest = hub.frames.latest
        if latest is None or latest.sequence == self._sent_sequence:
            return
        form = self._pace.form_now(latest, now_s)
        if form is None:
            return
        self._sent_sequence = latest.sequence
        data = await asyncio.to_thread(self._console.encoder.encode, latest, form)
        self._link.note_sent(latest.sequence, len(data), time.monotonic())
        await self.socket.send_bytes(data)
