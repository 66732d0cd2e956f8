"""A GigE Vision client of the tests' own: one socket for control, one for the stream."""

import itertools
import socket
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hil_mocks.gige._features import Feature, features_of
from hil_mocks.gige._registers import BootstrapAddress
from hil_mocks.gige._wire import (
    GVCP_PORT,
    CommandCode,
    GvcpStatus,
    ImageLeader,
    PacketFormat,
    RegisterWrite,
    ResendRequest,
)
from tests.hil_mocks.gige_wire import (
    Acknowledge,
    GvspPacket,
    encode_command,
    encode_read_memory,
    encode_read_registers,
    encode_resend_request,
    encode_write_memory,
    encode_write_registers,
    parse_acknowledge,
    parse_leader,
    parse_packet,
)

REPLY_S = 20.0
FRAME_S = 20.0
"""No camera is so slow; but the first picture of a print is compiled and drawn, on any machine."""
SILENCE_S = 0.3
"""Longer than anything that is under way needs to arrive."""
HEARTBEAT_MS = 60_000


@dataclass(frozen=True, kw_only=True)
class Block:
    """The packets of one frame as they came."""

    packets: list[GvspPacket]

    @property
    def block_id(self) -> int:
        return self.packets[0].header.block_id

    @property
    def leader(self) -> ImageLeader:
        (leader,) = (p for p in self.packets if p.header.packet_format == PacketFormat.LEADER)
        return parse_leader(leader.body)

    @property
    def packet_ids(self) -> list[int]:
        return [packet.header.packet_id for packet in self.packets]

    @property
    def payload(self) -> bytes:
        parts = {
            packet.header.packet_id: packet.body
            for packet in self.packets
            if packet.header.packet_format == PacketFormat.PAYLOAD
        }
        return b"".join(parts[packet_id] for packet_id in sorted(parts))

    @property
    def image_mono8(self) -> NDArray[np.uint8]:
        shape = self.leader.height, self.leader.width
        return np.frombuffer(self.payload, np.uint8).reshape(shape)


class RawClient:
    """Speaks to the camera at an address; a context manager."""

    def __init__(self, address: str) -> None:
        self.camera = (address, GVCP_PORT)
        self.features: dict[str, Feature] = {
            feature.name: feature for feature in features_of(None, has_temperature=True)
        }
        self._requests = itertools.cycle(range(1, 2**16))
        self.control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        for port in (self.control, self.stream):
            port.bind(("127.0.0.1", 0))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.control.close()
        self.stream.close()

    @property
    def ip(self) -> int:
        return int.from_bytes(socket.inet_aton("127.0.0.1"), "big")

    def ask(self, code: int, payload: bytes = b"") -> Acknowledge:
        """Send a command and return its acknowledge; TimeoutError if there is none."""
        return self._ask_once(code, payload, REPLY_S)

    def _ask_once(self, code: int, payload: bytes, timeout_s: float) -> Acknowledge:
        """The acknowledge of this very command: late ones for earlier commands are dropped."""
        request_id = next(self._requests)
        acknowledge = self.ask_raw(encode_command(code, request_id, payload), timeout_s)
        while acknowledge.request_id != request_id:
            acknowledge = self.acknowledge(timeout_s)
        return acknowledge

    def ask_raw(self, datagram: bytes, timeout_s: float = REPLY_S) -> Acknowledge:
        self.control.sendto(datagram, self.camera)
        return self.acknowledge(timeout_s)

    def acknowledge(self, timeout_s: float = REPLY_S) -> Acknowledge:
        self.control.settimeout(timeout_s)
        return parse_acknowledge(self.control.recv(2000))

    def is_answered(self, timeout_s: float = REPLY_S) -> bool:
        try:
            self._ask_once(CommandCode.DISCOVERY, b"", timeout_s)
        except TimeoutError:
            return False
        return True

    def read(self, address: int) -> int:
        acknowledge = self.ask(CommandCode.READREG, encode_read_registers([address]))
        assert acknowledge.status == GvcpStatus.SUCCESS, hex(acknowledge.status)
        return int.from_bytes(acknowledge.payload, "big")

    def write(self, address: int, value: int) -> int:
        payload = encode_write_registers([RegisterWrite(address=address, value=value)])
        return self.ask(CommandCode.WRITEREG, payload).status

    def read_memory(self, address: int, length: int) -> bytes:
        acknowledge = self.ask(CommandCode.READMEM, encode_read_memory(address, length))
        assert acknowledge.status == GvcpStatus.SUCCESS, hex(acknowledge.status)
        return acknowledge.payload[4:]

    def get(self, name: str) -> float:
        feature = self.features[name]
        data = self.read_memory(feature.address, feature.length)
        if feature.kind == "float":
            return float(struct.unpack(">d", data)[0])
        value = int.from_bytes(data, "big")
        return value & 0xFFFF if feature.kind == "masked" else value

    def set(self, name: str, value: float) -> int:
        """Write a feature and return the status."""
        feature = self.features[name]
        if feature.kind == "float":
            payload = encode_write_memory(feature.address, struct.pack(">d", value))
            return self.ask(CommandCode.WRITEMEM, payload).status
        return self.write(feature.address, int(value))

    def take_control(self) -> int:
        return self.write(BootstrapAddress.CONTROL_PRIVILEGE, 2)

    def open_stream(self, packet_size_bytes: int = 1500) -> None:
        port = self.stream.getsockname()[1]
        for address, value in (
            (BootstrapAddress.STREAM_PACKET_SIZE, packet_size_bytes),
            (BootstrapAddress.STREAM_DESTINATION, self.ip),
            (BootstrapAddress.STREAM_PORT, port),
        ):
            assert self.write(address, value) == GvcpStatus.SUCCESS

    def start(self, packet_size_bytes: int = 1500, **features: float) -> None:
        """Take control, set features, open the stream and start."""
        assert self.take_control() == GvcpStatus.SUCCESS
        # A client that waits for a frame says nothing meanwhile, and a machine may be busy.
        assert self.write(BootstrapAddress.HEARTBEAT_TIMEOUT, HEARTBEAT_MS) == GvcpStatus.SUCCESS
        for name, value in {"ExposureTimeAbs": 8000.0, **features}.items():
            assert self.set(name, value) == GvcpStatus.SUCCESS, name
        self.open_stream(packet_size_bytes)
        assert self.set("AcquisitionStart", 1) == GvcpStatus.SUCCESS

    def resend(self, block_id: int, first: int, last: int) -> None:
        request = ResendRequest(channel=0, block_id=block_id, first=first, last=last)
        payload = encode_resend_request(request)
        self.control.sendto(
            encode_command(CommandCode.PACKETRESEND, next(self._requests), payload, flags=0),
            self.camera,
        )

    def packet(self, timeout_s: float = FRAME_S) -> GvspPacket:
        self.stream.settimeout(timeout_s)
        return parse_packet(self.stream.recv(70_000))

    def packets(self, quiet_s: float = SILENCE_S) -> Iterator[GvspPacket]:
        """Packets until none has come for a while."""
        try:
            while True:
                yield self.packet(quiet_s)
        except TimeoutError:
            return

    def packets_of_all(self) -> list[GvspPacket]:
        """Every packet of an acquisition that ends by itself."""
        packets = list(self.packets())
        while self.get("AcquisitionActive"):
            packets += self.packets()
        return packets

    def block(self) -> Block:
        """The next frame, from whatever comes first to its trailer."""
        packets = [self.packet()]
        while packets[-1].header.packet_format != PacketFormat.TRAILER:
            packets.append(self.packet())
        return Block(packets=packets)

    def is_streamed_to(self, within_s: float = SILENCE_S) -> bool:
        try:
            self.packet(within_s)
        except TimeoutError:
            return False
        return True


def wait_for(condition: Callable[[], bool], within_s: float = 60.0) -> None:
    """Return as soon as the condition holds."""
    end_s = monotonic() + within_s
    while not condition():
        assert monotonic() < end_s, "it did not happen in time"
        sleep(0.005)
