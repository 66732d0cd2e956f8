"""Slows down whoever guesses the token."""

import ipaddress
import time
from collections.abc import Callable

from standoff.console.serving.allowance import Allowance

FREE_GUESSES = 5
GUESS_PERIOD_S = 1.0
MAX_PEERS = 1024
"""Peers that are counted each for itself; those beyond share one allowance."""

IPV6_NETWORK_BITS = 64
"""One computer has all the addresses of such a network."""

OTHERS = ""


class LoginThrottle:
    """Allows a peer five wrong guesses, then one a second.

    Parameters
    ----------
    clock
        Seconds.
    """

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
