"""How this computer reaches a camera: interface, largest packet, receive buffers."""

import socket
import struct
from dataclasses import dataclass
from pathlib import Path

from acquisition.errors import NoRouteError

try:
    import fcntl
except ModuleNotFoundError:  # Windows
    fcntl = None  # type: ignore[assignment]


GVCP_PORT = 3956

SIOCGIFADDR = 0x8915
"""Linux, netdevice(7): first IPv4 address of an interface."""

IP_MTU = 14
"""Linux, ip(7): largest datagram on the path of a connected socket; not in the socket module."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkRoute:
    """The route to one address; ``interface`` is None where its name is not known."""

    address: str
    own_address: str
    interface: str | None
    mtu_bytes: int


def route_to(ip_address: str) -> NetworkRoute:
    """Ask the kernel for the route to ``ip_address``; nothing is sent.

    Raises
    ------
    NoRouteError
        If no interface leads there.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((ip_address, GVCP_PORT))
            own_address = str(probe.getsockname()[0])
            mtu_bytes = probe.getsockopt(socket.IPPROTO_IP, IP_MTU)
        except OSError as error:
            raise NoRouteError(
                f"no network interface leads to {ip_address} ({error.strerror}); give the "
                "network card a static address in the camera's subnet",
                address=ip_address,
            ) from error
    return NetworkRoute(
        address=ip_address,
        own_address=own_address,
        interface=_interface_with(own_address),
        mtu_bytes=mtu_bytes,
    )


def receive_buffer_limit_bytes(
    path: Path = Path("/proc/sys/net/core/rmem_max"),
) -> int | None:
    """Largest receive buffer that a program may request; None where the system does not say."""
    try:
        return int(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None


def _interface_with(own_address: str) -> str | None:
    if fcntl is None:
        return None
    wanted = socket.inet_aton(own_address)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            try:
                answer = fcntl.ioctl(control.fileno(), SIOCGIFADDR, request)
            except OSError:  # an interface without an IPv4 address
                continue
            if answer[20:24] == wanted:
                return name
    return None
