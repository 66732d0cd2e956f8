"""The console's pages and its one websocket; the work is done behind them."""

import asyncio
import getpass
import math
import time
from collections import deque
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import parse_qs

from jinja2 import Environment, PackageLoader
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from acquisition.errors import SessionError
from acquisition.printable import on_one_line
from standoff.console.bench_checks import bench_checks
from standoff.console.bench_hub import BenchHub
from standoff.console.devices import PictureEncoder
from standoff.console.session_library import UnknownSessionError
from standoff.console.web import messages
from standoff.console.web.access import Access
from standoff.console.web.access_middleware import AccessMiddleware
from standoff.console.web.allowance import Allowance
from standoff.console.web.command_handler import CommandHandler
from standoff.console.web.login_throttle import LoginThrottle
from standoff.console.web.pose import PosePages
from standoff.console.web.report_page import report_response
from standoff.console.web.session_page import session_document, sessions_document
from standoff.console.web.session_pages import SessionPages
from standoff.console.web.state_cache import StateCache
from standoff.console.web.viewer import Viewer
from standoff.errors import REPORTED_ERRORS

FOLDER = Path(__file__).parent
HELLO_TIMEOUT_S = 10.0
REPLACED = 4001
MAX_LOGIN_BYTES = 4096

PAGES_AT_ONCE, PAGES_WAITING = 2, 64
"""Pages that are made at the same time, beside the bench's own threads, and that wait for it."""

MESSAGES_AT_ONCE, MESSAGE_PERIOD_S = 100, 0.005
"""Messages of one page that are read in one go, and the time for each one more: a page that
acknowledges 30 pictures a second while a region is drawn sends about 90."""

WARNING_PERIOD_S = 60.0
"""Pages are told of guesses of the token at most this often."""

COMMANDS_WAITING = 64
"""Commands of one page that wait for their turn: reading goes on, as the next one may be STOP."""

STOPS_KNOWN = 256
"""Stops that are remembered, so that one that is sent until it is answered counts once."""

T = TypeVar("T")

METRICS = ("squared-gradient", "brenner", "tenengrad", "laplacian")


def console_app(hub: BenchHub, *, token: str | None = None) -> Starlette:
    """Return the web application of a bench; whoever serves it starts and closes the hub.

    Parameters
    ----------
    hub
        The bench.
    token
        Whoever has it is let in from any computer; None lets in only this computer.
    """
    access = Access(token)
    pages = _Pages(hub, access)
    return Starlette(
        routes=[
            Route("/", pages.bench),
            Route("/sessions", pages.sessions),
            Route("/sessions/{name}", pages.session),
            Route("/sessions/{name}/report", pages.report),
            Route("/snapshots/{name}", pages.snapshot),
            *SessionPages(hub, pages.made, pages.in_turn).routes(),
            *PosePages(hub, pages.in_turn, access).routes(),
            Route("/doctor", pages.doctor),
            Route("/login", pages.login, methods=["GET", "POST"]),
            WebSocketRoute("/live", _Sockets(hub).serve),
            Mount("/static", StaticFiles(directory=FOLDER / "static")),
        ],
        middleware=[Middleware(AccessMiddleware, access=access, refusal=pages.refusal())],
        exception_handlers={HTTPException: pages.fault},
    )


class _Pages:
    """Renders the pages; what changes on them comes over the websocket."""

    def __init__(self, hub: BenchHub, access: Access) -> None:
        self._hub = hub
        self._access = access
        self._throttle = LoginThrottle()
        self._warnings = Allowance(at_once=1, period_s=WARNING_PERIOD_S, clock=time.monotonic)
        self._turns = asyncio.Semaphore(PAGES_AT_ONCE)
        self._asked = 0
        self._templates = Environment(
            loader=PackageLoader("standoff.console.web", "templates"),
            autoescape=True,
            finalize=_printable,
            trim_blocks=True,
            lstrip_blocks=True,
        )

    async def bench(self, request: Request) -> Response:
        def facts() -> dict[str, Any]:
            summaries = self._hub.sessions.summaries()
            return {
                "plans": self._hub.plans.names(),
                "unfinished": [
                    each.name for each in summaries if not each.fault and not each.is_complete
                ],
                "metrics": METRICS,
                "bench": self._hub.bench,
            }

        return await self.made(request, "bench.html", facts)

    async def sessions(self, request: Request) -> Response:
        number = _page_number(request)
        return await self.made(
            request, "sessions.html", lambda: sessions_document(self._hub.sessions, number)
        )

    async def session(self, request: Request) -> Response:
        name, number = request.path_params["name"], _page_number(request)
        return await self.made(
            request,
            "session.html",
            lambda: {
                "session": session_document(
                    self._hub.sessions, name, number, has_curves=self._hub.results.has_curves
                )
            },
        )

    async def report(self, request: Request) -> Response:
        name = request.path_params["name"]
        report = await self.in_turn(request, lambda: self._hub.sessions.report_of(name))
        if report is None:
            raise HTTPException(404, f"{name} has no report yet")
        return report_response(report)

    async def snapshot(self, request: Request) -> Response:
        name = request.path_params["name"]
        data = await self.in_turn(request, lambda: self._hub.snapshots.read(name))
        if data is None:
            raise HTTPException(404, "there is no such snapshot")
        headers = {"Content-Disposition": f'attachment; filename="{name}"'}
        return Response(data, media_type="image/tiff", headers=headers)

    async def doctor(self, request: Request) -> Response:
        return await self.made(request, "doctor.html", lambda: {"checks": bench_checks(self._hub)})

    async def login(self, request: Request) -> Response:
        """Take the token once, and return a cookie in its place."""
        token = await _token_of(request)
        peer = "" if request.client is None else request.client.host
        wait_s = self._throttle.wait_s(peer)
        if token and wait_s > 0:
            headers = {"Retry-After": str(math.ceil(wait_s))}
            return HTMLResponse(self.refusal(is_early=True), status_code=429, headers=headers)
        if not self._access.is_token(token):
            if token:
                self._note_guess(peer)
            return HTMLResponse(self.refusal(is_wrong=bool(token)), status_code=401)
        response = RedirectResponse("/", status_code=303)
        response.set_cookie(
            self._access.cookie_name,
            self._access.cookie_value,
            httponly=True,
            samesite="strict",
            path="/",
        )
        return response

    def refusal(self, *, is_wrong: bool = False, is_early: bool = False) -> str:
        template = self._templates.get_template("refusal.html")
        return template.render(
            needs_token=self._access.needs_token, is_wrong=is_wrong, is_early=is_early
        )

    async def fault(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        return HTMLResponse(
            self._page("fault.html", status=error.status_code, text=error.detail),
            status_code=error.status_code,
            headers=error.headers,
        )

    def _note_guess(self, peer: str) -> None:
        self._throttle.note_wrong(peer)
        if self._throttle.wait_s(peer) > 0 and self._warnings.wait_s == 0:
            self._warnings.take()
            self._hub.tell(f"Somebody at {peer} guesses the console's token.")

    async def made(
        self, request: Request, template: str, facts: Callable[[], dict[str, Any]]
    ) -> Response:
        """Collect the facts of a page and render it."""
        page = await self.in_turn(request, lambda: self._page(template, **facts()))
        return HTMLResponse(page)

    async def in_turn(self, request: Request, make: Callable[[], T]) -> T:
        """Do the work of a page in a thread, a few at a time: the bench shares the processor."""
        if self._asked >= PAGES_AT_ONCE + PAGES_WAITING:
            raise HTTPException(503, "the console is busy: try again", {"Retry-After": "1"})
        self._asked += 1
        try:
            async with self._turns:
                if await request.is_disconnected():
                    raise HTTPException(400, "nobody waits for this page any more")
                return await asyncio.to_thread(make)
        except UnknownSessionError as error:
            raise HTTPException(404, str(error)) from error
        except SessionError as error:
            raise HTTPException(409, str(error)) from error
        finally:
            self._asked -= 1

    def _page(self, name: str, **facts: object) -> str:
        return self._templates.get_template(name).render(path=f"/{name}", **facts)


async def _token_of(request: Request) -> str:
    """The token that a login names; empty if it names none."""
    if request.method != "POST":
        return request.query_params.get("token", "")
    data = bytearray()
    try:
        async for chunk in request.stream():
            data += chunk
            if len(data) > MAX_LOGIN_BYTES:
                raise HTTPException(413, "the token is too long")
    except ClientDisconnect as error:  # it took too long, or left
        raise HTTPException(400, "the token did not arrive") from error
    return parse_qs(data.decode("utf-8", "replace")).get("token", [""])[0]


def _page_number(request: Request) -> int:
    """Number of the page that is asked for, from 1 on."""
    text = request.query_params.get("page", "1")
    if not (text.isascii() and text.isdigit() and len(text) < 9 and int(text) > 0):
        raise HTTPException(404, "pages are numbered from 1 on")
    return int(text)


def _printable(value: object) -> object:
    """Escape what a page would obey in a text, such as marks that turn the direction of reading."""
    return on_one_line(value) if type(value) is str else value


class _Sockets:
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
        self._hub.control.join(hello.viewer, hello.name or getpass.getuser())
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
            viewer.reply_first({"type": "stop-heard", "id": message.id})

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
    return {"type": "refused", "text": text, "do": do, "key": key}


async def _quietly(closing: Awaitable[None]) -> None:
    try:
        await closing
    except RuntimeError:
        return  # it was closed already
