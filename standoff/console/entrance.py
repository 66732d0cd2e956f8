"""The way in with a token: one login per device, which gets a cookie in the token's place."""

import math
import time
from collections.abc import Callable
from typing import Protocol
from urllib.parse import parse_qs

from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from standoff.console.access import Access, Allowance, LoginThrottle

MAX_LOGIN_BYTES = 4096

WARNING_PERIOD_S = 60.0
"""Guesses of the token are reported at most this often."""


class RefusalPage(Protocol):
    """Renders the page that asks for the token."""

    def __call__(self, *, is_wrong: bool = False, is_early: bool = False) -> str:
        """Return its HTML, after a wrong token or after too many."""
        ...


class Entrance:
    """Takes the token once and gives a cookie for it.

    ``refusal`` renders the page for whoever has no token; ``warn`` is told who guesses the token,
    ``admitted`` the address of each device that was let in.
    """

    def __init__(
        self,
        access: Access,
        refusal: RefusalPage,
        *,
        warn: Callable[[str], None],
        admitted: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._access = access
        self._refusal = refusal
        self._warn = warn
        self._admitted = admitted
        self._throttle = LoginThrottle()
        self._warnings = Allowance(at_once=1, period_s=WARNING_PERIOD_S, clock=time.monotonic)

    async def login(self, request: Request) -> Response:
        """Take the token once, and return a cookie in its place."""
        token = await _token_of(request)
        peer = "" if request.client is None else request.client.host
        wait_s = self._throttle.wait_s(peer)
        if token and wait_s > 0:
            headers = {"Retry-After": str(math.ceil(wait_s))}
            return HTMLResponse(self._refusal(is_early=True), status_code=429, headers=headers)
        if not self._access.is_token(token):
            if token:
                self._note_guess(peer)
            return HTMLResponse(self._refusal(is_wrong=bool(token)), status_code=401)
        response = RedirectResponse("/", status_code=303)
        response.set_cookie(
            self._access.cookie_name,
            self._access.cookie_value,
            httponly=True,
            samesite="strict",
            secure=request.url.scheme == "https",
            path="/",
        )
        self._admitted(peer)
        return response

    def _note_guess(self, peer: str) -> None:
        self._throttle.note_wrong(peer)
        if self._throttle.wait_s(peer) > 0 and self._warnings.wait_s == 0:
            self._warnings.take()
            self._warn(peer)


async def _token_of(request: Request) -> str:
    """The token that a login names; empty if it names none."""
    if request.method != "POST":
        return request.query_params.get("token", "")
    data = await body_of(request, MAX_LOGIN_BYTES, "the token did not arrive")
    if data is None:
        raise HTTPException(413, "the token is too long")
    return parse_qs(data.decode("utf-8", "replace")).get("token", [""])[0]


async def body_of(request: Request, most_bytes: int, missing: str) -> bytes | None:
    """Return what is sent; None if that is too much. ``missing`` is said if it does not arrive."""
    data = bytearray()
    try:
        async for chunk in request.stream():
            data += chunk
            if len(data) > most_bytes:
                return None
    except ClientDisconnect as error:  # it took too long, or left
        raise HTTPException(400, missing) from error
    return bytes(data)
