"""Every page's websocket: what it sends is carried out, and it is sent the newest data."""

import asyncio
import json
import time
from collections import deque
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from time import time as wall_s
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from standoff.console.access import Allowance
from standoff.console.bench_hub import BenchHub
from standoff.console.frames import PictureEncoder
from standoff.console.page_words import page_words
from standoff.console.web.command_handler import CommandHandler, parse_message
from standoff.console.web.link import PERIOD_S, Link, PicturePace
from standoff.console.web.messages import (
    Acknowledge,
    Hello,
    MessageError,
    PageMessage,
    Ping,
    Stop,
    key_at_fault,
)
from standoff.console.web.view_model import (
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

    def __init__(self, hub: BenchHub) -> None:
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

    def levels(self) -> str | None:
        """Histogram and focus trace; None without a picture, or with none but an old one."""
        facts = self._hub.picture.facts
        if facts.levels is None or figure_ages(self._hub)["levels"].validity == "none":
            return None
        now_s = time.monotonic()
        if now_s - self._levels_s > LEVELS_S:
            self._levels_s = now_s
            self._levels = json.dumps(levels_document(facts), allow_nan=False)
        return self._levels

    def measure(self) -> str:
        """Live measurements."""
        sharpness, square = self._hub.sharpness, self._hub.squareness.view
        view, has_field = sharpness.view, sharpness.is_field_wanted
        return self._made_of(
            "measure", (view, square), lambda: measure_document(view, square, has_field=has_field)
        )

    def sweep(self) -> str:
        """The focus sweep."""
        view = self._hub.sweep.view
        return self._made_of("sweep", (view,), lambda: sweep_document(view))

    def plan(self) -> str:
        """The plan's table."""
        view = self._hub.run.view
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


class _Viewer:
    """Sends to one page, once its connection is accepted, until it is gone.

    Encoder and state are shared with the other pages.
    """

    def __init__(
        self,
        socket: WebSocket,
        identity: str,
        hub: BenchHub,
        encoder: PictureEncoder,
        state: StateCache,
        *,
        wants_pictures: bool,
    ) -> None:
        self.identity = identity
        self._socket = socket
        self._hub = hub
        self._encoder = encoder
        self._state = state
        self._wants_pictures = wants_pictures
        self._link = Link()
        self._pace = PicturePace(self._link, encoder)
        self._wake = asyncio.Event()
        self._replies: deque[dict[str, Any]] = deque(maxlen=32)
        self._sent_sequence = 0
        self._told: dict[str, str] = {}
        self._plan_revision = self._sweep_revision = self._measured = -1
        self._was_watched = False

    def reply(self, document: dict[str, Any]) -> None:
        """Send something to this page alone."""
        self._replies.append(document)
        self._wake.set()

    def reply_first(self, document: dict[str, Any]) -> None:
        """Send something to this page alone, before everything else that waits to be sent."""
        self._replies.appendleft(document)
        self._wake.set()

    def acknowledge(self, message: Acknowledge) -> None:
        """Note that the page has drawn a picture, and all before it."""
        in_hand_s = 1e-3 * message.in_hand_ms
        self._link.note_arrived(message.sequence, time.monotonic(), in_hand_s=in_hand_s)
        self._wake.set()

    def answer_ping(self, message: Ping) -> None:
        """Answer a page that asks whether it is heard, and what time it is here."""
        if message.round_trip_ms is not None:
            self._link.note_round_trip(1e-3 * message.round_trip_ms)
        self.reply_first({"type": "pong", "number": message.number, "now_ms": 1e3 * wall_s()})

    async def send_all(self) -> None:
        """Send until the page is gone."""
        loop = asyncio.get_running_loop()

        def woken() -> None:
            loop.call_soon_threadsafe(self._wake.set)

        end = self._hub.frames.subscribe(woken) if self._wants_pictures else lambda: None
        try:
            await self._send_on()
        except (WebSocketDisconnect, RuntimeError):
            return  # the page is gone: the receiving side notices, too
        finally:
            end()

    async def _send_on(self) -> None:
        state_s = levels_s = measure_s = 0.0
        while True:
            await self._woken()
            while self._replies:
                await self._send_text(self._replies.popleft())
            now_s = time.monotonic()
            slowdown = self._slowdown
            if now_s - state_s >= slowdown * STATE_PERIOD_S:
                state_s = now_s
                await self._send_state()
            if self._wants_pictures and now_s - levels_s >= slowdown * LEVELS_PERIOD_S:
                levels_s = now_s
                levels = self._state.levels()
                if levels is not None:
                    await self._socket.send_text(levels)
            if self._wants_pictures and now_s - measure_s >= slowdown * MEASURE_PERIOD_S:
                measure_s = now_s
                await self._send_measurements()
            await self._send_picture(now_s)

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
        control = control_document(self._hub.control.view(self.identity))
        state = {"control": json.dumps(control)} | self._state.state()
        news = ['"type":"state"']
        news += [f'"{name}":{text}' for name, text in state.items() if self._told.get(name) != text]
        self._told = state
        await self._socket.send_text("{" + ",".join(news) + "}")
        revision = self._hub.run.view.revision
        if revision != self._plan_revision:
            self._plan_revision = revision
            await self._socket.send_text(self._state.plan())

    async def _send_measurements(self) -> None:
        sequence = self._hub.sharpness.view.sequence
        is_watched = self._hub.squareness.view.is_wanted
        if is_watched or self._was_watched or sequence != self._measured:
            self._measured, self._was_watched = sequence, is_watched
            await self._socket.send_text(self._state.measure())
        revision = self._hub.sweep.view.revision
        if revision != self._sweep_revision:
            self._sweep_revision = revision
            await self._socket.send_text(self._state.sweep())

    async def _send_picture(self, now_s: float) -> None:
        """Send the newest picture if the page wants it and its link is ready for one."""
        latest = self._hub.frames.latest
        if not self._wants_pictures or latest is None or latest.sequence == self._sent_sequence:
            return
        form = self._pace.form_now(latest, now_s)
        if form is None:
            return
        self._sent_sequence = latest.sequence
        data = await asyncio.to_thread(self._encoder.encode, latest, form)
        self._link.note_sent(latest.sequence, len(data), time.monotonic())
        await self._socket.send_bytes(data)

    async def _send_text(self, document: dict[str, Any]) -> None:
        await self._socket.send_text(json.dumps(document, allow_nan=False))


class LiveSockets:
    """Every page's websocket."""

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub
        self._handler = CommandHandler(hub)
        self._encoder = PictureEncoder()
        self._state = StateCache(hub)
        self._viewers: dict[str, _Viewer] = {}
        self._sockets: dict[str, WebSocket] = {}
        self._stops: deque[str] = deque(maxlen=STOPS_KNOWN)
        # One at a time, and never in the loop that sends the pictures.
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="commands")

    async def serve(self, socket: WebSocket) -> None:
        """Serve one page until it is gone."""
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
        await self._replace(hello.viewer)
        viewer = _Viewer(
            socket,
            hello.viewer,
            self._hub,
            self._encoder,
            self._state,
            wants_pictures=hello.pictures,
        )
        self._viewers[hello.viewer], self._sockets[hello.viewer] = viewer, socket
        self._hub.control.join(hello.viewer, hello.name or login_name())
        sending = asyncio.create_task(viewer.send_all())
        try:
            await self._receive(socket, viewer)
        finally:
            sending.cancel()
            if self._viewers.get(hello.viewer) is viewer:
                del self._viewers[hello.viewer], self._sockets[hello.viewer]
                self._hub.control.leave(hello.viewer)

    async def _replace(self, identity: str) -> None:
        """Close the old connection of a page that was opened again."""
        old = self._sockets.get(identity)
        if old is not None:
            del self._viewers[identity], self._sockets[identity]
            await _quietly(old.close(code=REPLACED, reason="opened again elsewhere"))

    async def _receive(self, socket: WebSocket, viewer: _Viewer) -> None:
        waiting: asyncio.Queue[PageMessage | None] = asyncio.Queue(COMMANDS_WAITING)
        working = asyncio.create_task(self._work(waiting, viewer))
        try:
            await self._read(socket, viewer, waiting, working)
        finally:
            if not working.done():
                await waiting.put(None)  # what was sent before the page left is still done
            await working

    async def _read(
        self,
        socket: WebSocket,
        viewer: _Viewer,
        waiting: asyncio.Queue[PageMessage | None],
        working: asyncio.Task[None],
    ) -> None:
        pace = Allowance(at_once=MESSAGES_AT_ONCE, period_s=MESSAGE_PERIOD_S, clock=time.monotonic)
        while not working.done():
            await asyncio.sleep(pace.take())  # if only for the turns of the others
            try:
                text = await socket.receive_text()
            except (WebSocketDisconnect, RuntimeError):
                return
            except KeyError:
                viewer.reply(_refusal("a message must be text"))
                continue
            self._take(text, viewer, waiting)

    def _take(self, text: str, viewer: _Viewer, waiting: asyncio.Queue[PageMessage | None]) -> None:
        """Do what must not wait, and put the rest behind what the page sent before."""
        try:
            message = parse_message(text)
            match message:
                case Acknowledge():
                    viewer.acknowledge(message)
                case Ping():
                    viewer.answer_ping(message)
                case Stop():
                    self._stop(message, viewer)
                case _:
                    waiting.put_nowait(message)
        except asyncio.QueueFull:
            viewer.reply(_refusal("too many commands at once: try again"))
        except MessageError as error:
            viewer.reply(_refusal(str(error), error.do, error.key))
        except REPORTED_ERRORS as error:
            viewer.reply(_refusal(str(error)))

    def _stop(self, message: Stop, viewer: _Viewer) -> None:
        """Stop, and say that it was heard; a stop that comes again is only answered."""
        if message.id is None or message.id not in self._stops:
            self._handler.carry_out(viewer.identity, message)
        if message.id is not None:
            self._stops.append(message.id)
            number = self._hub.stopping.view.number
            viewer.reply_first({"type": "stop-heard", "id": message.id, "number": number})

    async def _work(self, waiting: asyncio.Queue[PageMessage | None], viewer: _Viewer) -> None:
        """Execute what a page sends, one after the other, until it is gone."""
        loop = asyncio.get_running_loop()
        while (message := await waiting.get()) is not None:
            try:
                answer = await loop.run_in_executor(
                    self._worker, self._handler.carry_out, viewer.identity, message
                )
            except REPORTED_ERRORS as error:
                viewer.reply(_refusal(str(error), message.do, key_at_fault(message, error)))
                continue
            if answer is not None:
                viewer.reply(answer)


def _refusal(text: str, do: str = "", key: str = "") -> dict[str, str]:
    """What a page is told that asked for something in vain; a field at fault is set back."""
    return {"type": "refused", "text": page_words(text), "do": do, "key": key}


async def _quietly(closing: Awaitable[None]) -> None:
    try:
        await closing
    except RuntimeError:
        return  # it was closed already
