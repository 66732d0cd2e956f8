"""Middleware in front of every page: the access check, and headers that isolate a page."""

from collections.abc import MutableMapping
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from standoff.console.serving.access import Access

PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
OPEN_PATHS = ("/login", "/static/console.css", "/static/icon.svg")
"""Paths that the page asking for the token needs."""

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}

FORBIDDEN, NOT_OURS = 4401, 4403


class AccessMiddleware:
    """ASGI middleware that admits whom `Access` admits.

    Parameters
    ----------
    app
        The application behind it.
    access
        Decides who may enter.
    refusal
        Page for those not admitted.
    """

    def __init__(self, app: ASGIApp, *, access: Access, refusal: str) -> None:
        self._app = app
        self._access = access
        self._refusal = refusal

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] == "http":
            await self._serve_page(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._serve_socket(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _serve_page(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
                headers.setdefault("Content-Security-Policy", PAGE_POLICY)
            await send(message)

        if self._may_enter(scope) or (self._access.needs_token and scope["path"] in OPEN_PATHS):
            await self._app(scope, receive, send_guarded)
            return
        response = HTMLResponse(self._refusal, status_code=401)
        await response(scope, receive, send_guarded)

    async def _serve_socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        own = self._access.is_own_page(
            origin=headers.get("origin"), host=headers.get("host", ""), scheme=scope["scheme"]
        )
        if own and self._may_enter(scope):
            await self._app(scope, receive, send)
            return
        await receive()
        # Closing before accepting is answered with 403: the handshake fails.
        await send({"type": "websocket.close", "code": NOT_OURS if not own else FORBIDDEN})

    def _may_enter(self, scope: MutableMapping[str, Any]) -> bool:
        headers = Headers(scope=scope)
        client = scope.get("client")
        return self._access.may_enter(
            peer=None if client is None else client[0],
            host=headers.get("host", ""),
            cookies=headers.get("cookie", ""),
        )
