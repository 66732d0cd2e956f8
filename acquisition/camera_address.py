"""The address of one GigE Vision camera: checked and resolved by us, never searched for."""

import ipaddress
import re
import socket

from acquisition.errors import DeviceError

__all__ = ["address_fault", "resolve_address"]

_HOST_NAME = re.compile(
    r"(?=.{1,253}$)[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?(\.[A-Za-z0-9-]{1,63})*"
)
"""Of labels of 63 characters at most (RFC 1035, section 2.3.4): Python resolves no longer one."""


def address_fault(text: str) -> str | None:
    """Say why ``text`` cannot name one camera; None where it can.

    An IPv4 address that is not one host's (broadcast, multicast, 0.0.0.0) is a fault: a GigE
    Vision command sent there would reach every camera in the network.
    """
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        if _HOST_NAME.fullmatch(text) and not text.replace(".", "").isdigit():
            return None
        return f"{text!r} is neither an IPv4 address nor a host name"
    if address.version != 4:
        return f"{text} is an IPv6 address; GigE Vision has IPv4 only"
    if address.is_multicast or address.is_unspecified or address.is_reserved:
        return f"{text} is not the address of one camera"
    return None


def resolve_address(address: str) -> str:
    """Return the IPv4 address of a camera that is given by address or host name.

    Raises
    ------
    DeviceError
        If it names no single host, or the name is not known.
    """
    fault = address_fault(address)
    if fault is not None:
        raise DeviceError(f"camera.address: {fault}")
    try:
        found = socket.getaddrinfo(address, None, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise DeviceError(
            f"camera.address: the host name {address!r} is not known ({error.strerror}); "
            "give the camera's IP address"
        ) from error
    resolved = str(found[0][4][0])
    fault = address_fault(resolved)
    if fault is not None:
        raise DeviceError(f"camera.address: {address!r} stands for {fault}")
    return resolved
