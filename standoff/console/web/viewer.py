"""One page's connection: sends the newest data, and drops what the page cannot keep up with."""

import asyncio
import json
import time
from collections import deque
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from standoff.console.bench_hub import BenchHub
from standoff.console.devices import PictureEncoder
from standoff.console.web import messages
from standoff.console.web.state_cache import StateCache
from standoff.console.web.view_model import control_document

PICTURE_PERIOD_S = 1 / 30
IN_FLIGHT = 2
"""Pictures in flight: the next is sent when the page has drawn the last but one."""

ACK_TIMEOUT_S = 2.0
"""After this time a picture counts as drawn, so that a page that was asleep recovers."""

STATE_PERIOD_S = 0.1
LEVELS_PERIOD_S = 0.2
MEASURE_PERIOD_S = 0.1


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
        self._wake = asyncio.Event()
        self._replies: deque[dict[str, Any]] = deque(maxlen=32)
        self._in_flight: deque[int] = deque()
        self._sent_sequence = 0
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
        while self._in_flight and self._in_flight[0] <= message.sequence:
            self._in_flight.popleft()
        self._wake.set()

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
        state_s = levels_s = measure_s = picture_s = 0.0
        while True:
            await self._woken()
            while self._replies:
                await self._send_text(self._replies.popleft())
            now_s = time.monotonic()
            if now_s - state_s >= STATE_PERIOD_S:
                state_s = now_s
                await self._send_state()
            if self._wants_pictures and now_s - levels_s >= LEVELS_PERIOD_S:
                levels_s = now_s
                levels = self._state.levels()
                if levels is not None:
                    await self._socket.send_text(levels)
            if self._wants_pictures and now_s - measure_s >= MEASURE_PERIOD_S:
                measure_s = now_s
                await self._send_measurements()
            if self._may_send_picture(now_s, picture_s):
                picture_s = now_s
                await self._send_picture()

    async def _woken(self) -> None:
        try:
            async with asyncio.timeout(STATE_PERIOD_S / 2):
                await self._wake.wait()
        except TimeoutError:
            return
        self._wake.clear()

    async def _send_state(self) -> None:
        control = control_document(self._hub.control.view(self.identity))
        common = self._state.state()
        own = f'{{"type":"state","control":{json.dumps(control)},'
        await self._socket.send_text(own + common[1:])
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

    def _may_send_picture(self, now_s: float, sent_s: float) -> bool:
        latest = self._hub.frames.latest
        if not self._wants_pictures or latest is None or latest.sequence == self._sent_sequence:
            return False
        if now_s - sent_s > ACK_TIMEOUT_S:
            self._in_flight.clear()
        # A little less than the period, because frames arrive at times of their own.
        return len(self._in_flight) < IN_FLIGHT and now_s - sent_s >= 0.9 * PICTURE_PERIOD_S

    async def _send_picture(self) -> None:
        latest = self._hub.frames.latest
        if latest is None:
            return
        self._sent_sequence = latest.sequence
        self._in_flight.append(latest.sequence)
        await self._socket.send_bytes(self._encoder.encode(latest))

    async def _send_text(self, document: dict[str, Any]) -> None:
        await self._socket.send_text(json.dumps(document, allow_nan=False))
