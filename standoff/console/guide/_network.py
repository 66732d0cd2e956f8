"""At which address a phone reaches this computer, and that address as a QR code."""

import io
import socket

import segno

_ELSEWHERE = ("192.0.2.1", 9)
"""An address of documentation (RFC 5737): it is asked for the route alone, nothing is sent."""


def network_address() -> str | None:
    """Return this computer's address in the local network; None if it is in none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        try:
            opened.connect(_ELSEWHERE)  # a datagram socket only picks its own address by this
        except OSError:
            return None
        found = str(opened.getsockname()[0])
    return None if found.startswith("127.") or found == "0.0.0.0" else found  # noqa: S104 - not bound


def qr_text(address: str) -> str:
    """Return a QR code of half blocks, dark on light whatever the colours of the terminal are."""
    drawn = io.StringIO()
    segno.make(address, error="m", micro=False).terminal(out=drawn, compact=True)
    return drawn.getvalue()
