"""Introduces a camera to `viva_genicam`, which looks for cameras on 127.0.0.1 alone.

Its discovery on the loopback interface asks 127.0.0.1 by unicast; the answer names the address
of the camera that it then opens.
"""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread
from time import monotonic, sleep

from hil_mocks.gige._wire import (
    GVCP_PORT,
    CommandCode,
    GvcpError,
    encode_acknowledge,
    parse_command,
)
from tests.hil_mocks.gige_wire import encode_command, parse_acknowledge

LOOPBACK = "127.0.0.1"
PORT_WITHIN_S = 60.0
"""Only one test at a time can have the port; others wait for their turn."""


@contextmanager
def introduced(address: str) -> Iterator[None]:
    """Answer discovery on 127.0.0.1 with the discovery acknowledge of the camera."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.settimeout(2.0)
        asking.sendto(encode_command(CommandCode.DISCOVERY, 1), (address, GVCP_PORT))
        payload = parse_acknowledge(asking.recv(1000)).payload
    port = _port_in_turn()
    thread = Thread(target=_answer, args=(port, payload))
    thread.start()
    try:
        yield
    finally:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ending:
            ending.sendto(b"", (LOOPBACK, GVCP_PORT))
        thread.join()
        port.close()


def _answer(port: socket.socket, payload: bytes) -> None:
    while datagram_and_peer := port.recvfrom(1000):
        datagram, peer = datagram_and_peer
        if not datagram:
            return
        try:
            command = parse_command(datagram)
        except GvcpError:
            continue
        port.sendto(encode_acknowledge(command.code, command.request_id, payload), peer)


def _port_in_turn() -> socket.socket:
    end_s = monotonic() + PORT_WITHIN_S
    while True:
        port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            port.bind((LOOPBACK, GVCP_PORT))
        except OSError:
            port.close()
            assert monotonic() < end_s, f"{LOOPBACK}:{GVCP_PORT} stayed in use"
            sleep(0.02)
        else:
            return port
