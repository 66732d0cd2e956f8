"""The console's pages and its one websocket; the work is done behind them."""

import asyncio
import getpass
from collections.abc import Awaitable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import parse_qs

from jinja2 import Environment, PackageLoader
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from acquisition.errors import SessionError
from standoff.console.bench_checks import bench_checks
from standoff.console.bench_hub import BenchHub
from standoff.console.devices import PictureEncoder
from standoff.console.session_library import UnknownSessionError
from standoff.console.web import messages
from standoff.console.web.access import Access
from standoff.console.web.access_middleware import REPORT_POLICY, AccessMiddleware
from standoff.console.web.command_handler import CommandHandler
from standoff.console.web.session_page import session_document
from standoff.console.web.state_cache import StateCache
from standoff.console.web.viewer import Viewer
from standoff.errors import REPORTED_ERRORS

FOLDER = Path(__file__).parent
HELLO_TIMEOUT_S = 10.0
REPLACED = 4001
MAX_LOGIN_BYTES = 4096

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
            Route("/doctor", pages.doctor),
            Route("/login", pages.login, methods=["GET", "POST"]),
            WebSocketRoute("/live", _Sockets(hub).serve),
            Mount("/static", StaticFiles(directory=FOLDER / "static")),
        ],
        middleware=[Middleware(AccessMiddleware, access=access, refusal=pages.refusal())],
        exception_handlers={HTTPException: pages.fault},
    )


class _Pages:
    """Renders every page; what changes on it comes over the websocket."""

    def __init__(self, hub: BenchHub, access: Access) -> None:
        self._hub = hub
        self._access = access
        self._templates = Environment(
            loader=PackageLoader("standoff.console.web", "templates"),
            autoescape=True,
            trim_blocks=True,
            lstrip_blocks=True,
        )

    async def bench(self, request: Request) -> Response:
        plans = await asyncio.to_thread(self._hub.plans.names)
        unfinished = [
            each.name
            for each in await asyncio.to_thread(self._hub.sessions.summaries)
            if not each.fault and not each.is_complete
        ]
        return self._page(
            "bench.html", plans=plans, unfinished=unfinished, metrics=METRICS, bench=self._hub.bench
        )

    async def sessions(self, request: Request) -> Response:
        summaries = await asyncio.to_thread(self._hub.sessions.summaries)
        return self._page("sessions.html", summaries=summaries, folder=self._hub.sessions.folder)

    async def session(self, request: Request) -> Response:
        name = request.path_params["name"]
        try:
            document = await asyncio.to_thread(session_document, self._hub.sessions, name)
        except UnknownSessionError as error:
            raise HTTPException(404, str(error)) from error
        except SessionError as error:
            raise HTTPException(409, str(error)) from error
        return self._page("session.html", session=document)

    async def report(self, request: Request) -> Response:
        name = request.path_params["name"]
        try:
            report = await asyncio.to_thread(self._hub.sessions.report_of, name)
        except UnknownSessionError as error:
            raise HTTPException(404, str(error)) from error
        if report is None:
            raise HTTPException(404, f"{name} has no report yet")
        return HTMLResponse(report, headers={"Content-Security-Policy": REPORT_POLICY})

    async def doctor(self, request: Request) -> Response:
        checks = await asyncio.to_thread(bench_checks, self._hub)
        return self._page("doctor.html", checks=checks)

    async def login(self, request: Request) -> Response:
        """Take the token once, and return a cookie in its place."""
        if request.method == "GET":
            token = request.query_params.get("token", "")
        else:
            data = bytearray()
            async for chunk in request.stream():
                data += chunk
                if len(data) > MAX_LOGIN_BYTES:
                    raise HTTPException(413, "the token is too long")
            token = parse_qs(data.decode("utf-8", "replace")).get("token", [""])[0]
        if not self._access.is_token(token):
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

    def refusal(self, *, is_wrong: bool = False) -> str:
        template = self._templates.get_template("refusal.html")
        return template.render(needs_token=self._access.needs_token, is_wrong=is_wrong)

    async def fault(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        return self._page("fault.html", status=error.status_code, text=error.detail)

    def _page(self, name: str, *, status: int = 200, **facts: object) -> Response:
        page = self._templates.get_template(name).render(path=f"/{name}", status=status, **facts)
        return HTMLResponse(page, status_code=status)


class _Sockets:
    """Every page's websocket."""

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub
        self._handler = CommandHandler(hub)
        self._encoder = PictureEncoder()
        self._state = StateCache(hub)
        self._viewers: dict[str, Viewer] = {}
        self._sockets: dict[str, WebSocket] = {}
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
        while True:
            try:
                text = await socket.receive_text()
            except (WebSocketDisconnect, RuntimeError):
                return
            except KeyError:
                viewer.reply({"type": "refused", "text": "a message must be text"})
                continue
            await self._take(text, viewer)

    async def _take(self, text: str, viewer: Viewer) -> None:
        try:
            message = messages.parse_message(text)
            if isinstance(message, messages.Acknowledge):
                viewer.acknowledge(message)
                return
            if isinstance(message, messages.Stop):
                self._handler.carry_out(viewer.identity, message)  # not behind anything else
                return
            loop = asyncio.get_running_loop()
            answer = await loop.run_in_executor(
                self._worker, self._handler.carry_out, viewer.identity, message
            )
        except REPORTED_ERRORS as error:
            viewer.reply({"type": "refused", "text": str(error)})
            return
        if answer is not None:
            viewer.reply(answer)


async def _quietly(closing: Awaitable[None]) -> None:
    try:
        await closing
    except RuntimeError:
        return  # it was closed already
