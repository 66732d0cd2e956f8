"""One page's connection: sends the newest data, as much of it as the link carries."""

import asyncio
import json
import time
from collections import deque
from time import time as wall_s
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from standoff.console.bench_hub import BenchHub
from standoff.console.devices import PictureEncoder
from standoff.console.web import messages
from standoff.console.web.link import Link
from standoff.console.web.picture_pace import PERIOD_S, PicturePace
from standoff.console.web.state_cache import StateCache
from standoff.console.web.view_model import control_document

STATE_PERIOD_S = 0.1
LEVELS_PERIOD_S = 0.2
MEASURE_PERIOD_S = 0.1

SLOW_BYTES_PER_S, SLOWDOWN = 300e3, 3.0
"""Over a link that is slower than that, all these periods are so many times as long."""


class Viewer:
    """Sends to one page until it is gone.

    Parameters
    ----------
    socket
        Accepted connection.
    identity
        The page's identity for the control arbiter.
    hub
        The bench.
    encoder
        Shared with the other viewers.
    state
        Returns the state document, shared with the other viewers.
    wants_pictures
        Whether the page has a live picture.
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

    def acknowledge(self, message: messages.Acknowledge) -> None:
        """Note that the page has drawn a picture, and all before it."""
        in_hand_s = 1e-3 * message.in_hand_ms
        self._link.note_arrived(message.sequence, time.monotonic(), in_hand_s=in_hand_s)
        self._wake.set()

    def answer_ping(self, message: messages.Ping) -> None:
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
