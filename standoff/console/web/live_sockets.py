"""Every page's websocket: what it sends is read, carried out and answered."""

import asyncio
import time
from collections import deque
from collections.abc import Awaitable
from concurrent.futures import ThreadPoolExecutor

from starlette.websockets import WebSocket, WebSocketDisconnect

from standoff.console.bench_hub import BenchHub
from standoff.console.devices import PictureEncoder
from standoff.console.page_words import page_words
from standoff.console.serving import Allowance
from standoff.console.web import messages
from standoff.console.web.command_handler import CommandHandler
from standoff.console.web.state_cache import StateCache
from standoff.console.web.viewer import Viewer
from standoff.errors import REPORTED_ERRORS
from standoff.library import login_name

HELLO_TIMEOUT_S = 10.0

REPLACED = 4001

MESSAGES_AT_ONCE, MESSAGE_PERIOD_S = 100, 0.005
"""Messages of one page that are read in one go, and the time for each one more: a page that
acknowledges 30 pictures a second while a region is drawn sends about 90."""

COMMANDS_WAITING = 64
"""Commands of one page that wait for their turn: reading goes on, as the next one may be STOP."""

STOPS_KNOWN = 256
"""Stops that are remembered, so that one that is sent until it is answered counts once."""


class LiveSockets:
    """Every page's websocket."""

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub
        self._handler = CommandHandler(hub)
        self._encoder = PictureEncoder()
        self._state = StateCache(hub)
        self._viewers: dict[str, Viewer] = {}
        self._sockets: dict[str, WebSocket] = {}
        self._stops: deque[str] = deque(maxlen=STOPS_KNOWN)
        # One at a time, and never in the loop that sends the pictures.
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="commands")

    async def serve(self, socket: WebSocket) -> None:
        """Serve one page until it is gone."""
        await socket.accept()
        try:
            async with asyncio.timeout(HELLO_TIMEOUT_S):
                hello = messages.parse_message(await socket.receive_text())
        except (TimeoutError, WebSocketDisconnect, KeyError):
            return
        except messages.MessageError:
            hello = None
        if not isinstance(hello, messages.Hello):
            await socket.close(code=1008, reason="send hello first")
            return
        await self._replace(hello.viewer)
        viewer = Viewer(
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

    async def _receive(self, socket: WebSocket, viewer: Viewer) -> None:
        waiting: asyncio.Queue[messages.Message | None] = asyncio.Queue(COMMANDS_WAITING)
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
        viewer: Viewer,
        waiting: asyncio.Queue[messages.Message | None],
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

    def _take(
        self, text: str, viewer: Viewer, waiting: asyncio.Queue[messages.Message | None]
    ) -> None:
        """Do what must not wait, and put the rest behind what the page sent before."""
        try:
            message = messages.parse_message(text)
            match message:
                case messages.Acknowledge():
                    viewer.acknowledge(message)
                case messages.Ping():
                    viewer.answer_ping(message)
                case messages.Stop():
                    self._stop(message, viewer)
                case _:
                    waiting.put_nowait(message)
        except asyncio.QueueFull:
            viewer.reply(_refusal("too many commands at once: try again"))
        except messages.MessageError as error:
            viewer.reply(_refusal(str(error), error.do, error.key))
        except REPORTED_ERRORS as error:
            viewer.reply(_refusal(str(error)))

    def _stop(self, message: messages.Stop, viewer: Viewer) -> None:
        """Stop, and say that it was heard; a stop that comes again is only answered."""
        if message.id is None or message.id not in self._stops:
            self._handler.carry_out(viewer.identity, message)
        if message.id is not None:
            self._stops.append(message.id)
            number = self._hub.stopping.view.number
            viewer.reply_first({"type": "stop-heard", "id": message.id, "number": number})

    async def _work(self, waiting: asyncio.Queue[messages.Message | None], viewer: Viewer) -> None:
        """Execute what a page sends, one after the other, until it is gone."""
        loop = asyncio.get_running_loop()
        while (message := await waiting.get()) is not None:
            try:
                answer = await loop.run_in_executor(
                    self._worker, self._handler.carry_out, viewer.identity, message
                )
            except REPORTED_ERRORS as error:
                viewer.reply(
                    _refusal(str(error), message.do, messages.key_at_fault(message, error))
                )
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
