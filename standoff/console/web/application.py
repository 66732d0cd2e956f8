"""The console's pages and its one websocket; the work is done behind them."""

import asyncio
import math
import time
from collections.abc import Callable
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

from acquisition.errors import SessionError
from acquisition.printable import on_one_line
from standoff.console.bench_checks import bench_checks
from standoff.console.bench_hub import BenchHub
from standoff.console.page_words import page_words
from standoff.console.serving import Access, AccessMiddleware, Allowance, LoginThrottle
from standoff.console.session_library import UnknownSessionError
from standoff.console.web.live_sockets import LiveSockets
from standoff.console.web.pose import PosePages
from standoff.console.web.report_page import report_response
from standoff.console.web.session_page import session_document, sessions_document
from standoff.console.web.session_pages import SessionPages

FOLDER = Path(__file__).parent
MAX_LOGIN_BYTES = 4096

PAGES_AT_ONCE, PAGES_WAITING = 2, 64
"""Pages that are made at the same time, beside the bench's own threads, and that wait for it."""


WARNING_PERIOD_S = 60.0
"""Pages are told of guesses of the token at most this often."""


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
            WebSocketRoute("/live", LiveSockets(hub).serve),
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
            self._page("fault.html", status=error.status_code, text=page_words(error.detail)),
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
