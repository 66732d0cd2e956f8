"""Who may open the console: this computer, or whoever has the token; no other web page."""

import hashlib
import hmac
import ipaddress
import secrets
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

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

    Parameters
    ----------
    token
        None if only this computer is served.
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
        """Whether a request is served.

        Parameters
        ----------
        peer
            Address it came from; None if unknown.
        host
            Its ``Host`` header.
        cookies
            Its ``Cookie`` header.
        """
        if self._token is None:
            return peer is not None and is_loopback_host(peer) and is_loopback_host(_name_of(host))
        known = _cookie(cookies, self.cookie_name)
        return hmac.compare_digest(known.encode(), self.cookie_value.encode())

    @staticmethod
    def is_own_page(*, origin: str | None, host: str, scheme: str) -> bool:
        """Whether a page of this console opened a websocket, or asks: same scheme, name and port.

        Parameters
        ----------
        origin
            Its ``Origin`` header; None if there is none.
        host
            Its ``Host`` header.
        scheme
            That it came by: ``ws`` or ``http``, or ``wss`` or ``https`` where the console itself is
            served with TLS.
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
