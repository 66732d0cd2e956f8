"""Introduces a camera to `viva_genicam`, which looks for cameras on 127.0.0.1 alone.

Its discovery on the loopback interface asks 127.0.0.1 by unicast; the answer names the address
of the camera that it then opens.
"""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

from hil_mocks.gige._wire import (
    GVCP_PORT,
    CommandCode,
    GvcpError,
    encode_acknowledge,
    parse_command,
)
from tests.hil_mocks.gige_wire import encode_command, parse_acknowledge
from tests.hil_mocks.loopback_camera_port import loopback_camera_port

LOOPBACK = "127.0.0.1"


@contextmanager
def introduced(address: str) -> Iterator[None]:
    """Answer discovery on 127.0.0.1 with the discovery acknowledge of the camera."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.settimeout(2.0)
        asking.sendto(encode_command(CommandCode.DISCOVERY, 1), (address, GVCP_PORT))
        payload = parse_acknowledge(asking.recv(1000)).payload
    with loopback_camera_port(), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind((LOOPBACK, GVCP_PORT))
        thread = Thread(target=_answer, args=(port, payload))
        thread.start()
        try:
            yield
        finally:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ending:
                ending.sendto(b"", (LOOPBACK, GVCP_PORT))
            thread.join()


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
