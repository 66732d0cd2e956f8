"""Who may open the console: this computer, or whoever has the token; no other web page."""

import hashlib
import hmac
import ipaddress
import secrets
import time
from collections.abc import Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MIN_TOKEN_CHARS = 12

PAGE_SCHEMES = {"ws": "http", "http": "http", "wss": "https", "https": "https"}
"""Scheme of a page, by that of the websocket that it opens or of what it asks."""


def is_loopback_host(host: str) -> bool:
    """Whether a name or address can only be reached from this computer."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class Access:
    """Decides about requests, independently of any connection.

    Without a token only this computer is served, and only under a loopback name, so that no web
    page from elsewhere can pass its own name off as ours. With a token, everybody needs it.
    """

    def __init__(self, token: str | None) -> None:
        self._token = token
        # The cookie proves knowledge of the token and becomes invalid at the next start.
        key = secrets.token_bytes(32)
        # Consoles on other ports of the same host share its cookies.
        self.cookie_name = f"standoff_console_{secrets.token_hex(4)}"
        self.cookie_value = hmac.new(key, (token or "").encode(), hashlib.sha256).hexdigest()

    @property
    def needs_token(self) -> bool:
        """Whether there is a token."""
        return self._token is not None

    def is_token(self, text: str) -> bool:
        """Whether this is the token."""
        return self._token is not None and hmac.compare_digest(text.encode(), self._token.encode())

    def may_enter(self, *, peer: str | None, host: str, cookies: str) -> bool:
        """Whether a request is served, by its address (None if unknown) and its headers."""
        if self._token is None:
            return peer is not None and is_loopback_host(peer) and is_loopback_host(_name_of(host))
        known = _cookie(cookies, self.cookie_name)
        return hmac.compare_digest(known.encode(), self.cookie_value.encode())

    @staticmethod
    def is_own_page(*, origin: str | None, host: str, scheme: str) -> bool:
        """Whether a page of this console opened a websocket, or asks: same scheme, name and port.

        ``scheme`` is that of the connection, ``ws`` or ``http``, or those of TLS.
        """
        if origin is None or not host:
            return False
        try:
            parts = urlsplit(origin)
        except ValueError:  # "http://[" is not an address
            return False
        is_same_scheme = parts.scheme == PAGE_SCHEMES.get(scheme)
        return is_same_scheme and parts.netloc.lower() == host.lower()


def _name_of(host: str) -> str:
    """Name in a ``Host`` header, without its port."""
    try:
        parts = urlsplit(f"//{host}")
        _ = parts.port  # raises unless it is a number
    except ValueError:
        return ""
    return parts.hostname or ""


def _cookie(header: str, name: str) -> str:
    try:
        morsel = SimpleCookie(header).get(name)
    except CookieError:
        return ""
    return "" if morsel is None else morsel.value


class Allowance:
    """Turns, ``at_once`` of them after a rest; one more is there every ``period_s``."""

    def __init__(self, *, at_once: int, period_s: float, clock: Callable[[], float]) -> None:
        self._at_once = at_once
        self._period_s = period_s
        self._clock = clock
        self._left = float(at_once)
        self._at_s = clock()

    @property
    def wait_s(self) -> float:
        """Seconds until a turn may be taken; 0 if one may be taken now."""
        return max(0.0, 1.0 - self._filled()) * self._period_s

    @property
    def is_full(self) -> bool:
        """Whether as many turns are there as at the beginning."""
        return self._filled() >= self._at_once

    def take(self) -> float:
        """Take a turn, if need be one of the future; return the seconds until it comes."""
        self._left = self._filled() - 1.0
        self._at_s = self._clock()
        return max(0.0, -self._left) * self._period_s

    def _filled(self) -> float:
        gained = (self._clock() - self._at_s) / self._period_s
        return min(float(self._at_once), self._left + gained)


FREE_GUESSES = 5
GUESS_PERIOD_S = 1.0
MAX_PEERS = 1024
"""Peers that are counted each for itself; those beyond share one allowance."""

IPV6_NETWORK_BITS = 64
"""One computer has all the addresses of such a network."""

OTHERS = ""


class LoginThrottle:
    """Allows a peer five wrong guesses, then one a second."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._peers: dict[str, Allowance] = {}

    def wait_s(self, peer: str) -> float:
        """Seconds until the peer may try a token again; 0 if it may now."""
        known = self._peers.get(self._key(peer))
        return 0.0 if known is None else known.wait_s

    def note_wrong(self, peer: str) -> None:
        """Count a wrong guess of the peer."""
        key = self._key(peer)
        if key not in self._peers:
            self._peers[key] = Allowance(
                at_once=FREE_GUESSES, period_s=GUESS_PERIOD_S, clock=self._clock
            )
        self._peers[key].take()

    def _key(self, peer: str) -> str:
        """Name under which a peer is counted."""
        key = _network(peer)
        if key in self._peers or len(self._peers) < MAX_PEERS:
            return key
        for each in [each for each, allowance in self._peers.items() if allowance.is_full]:
            del self._peers[each]
        return key if len(self._peers) < MAX_PEERS else OTHERS


def _network(peer: str) -> str:
    try:
        address = ipaddress.ip_address(peer)
    except ValueError:
        return peer
    if address.version == 4:
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((int(address), IPV6_NETWORK_BITS), strict=False))


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
    """Admits whom `Access` admits; the others get the page ``refusal``.

    ``open_paths``: those that the page asking for the token needs.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        access: Access,
        refusal: str,
        open_paths: tuple[str, ...] = OPEN_PATHS,
    ) -> None:
        self._app = app
        self._access = access
        self._refusal = refusal
        self._open_paths = open_paths

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

        if self._may_enter(scope) or (
            self._access.needs_token and scope["path"] in self._open_paths
        ):
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
