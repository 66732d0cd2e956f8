"""The stream of the simulated GigE camera: takes and sends frames, resends packets."""

import ipaddress
import socket
import struct
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock
from time import monotonic, sleep

import numpy as np
from numpy.typing import NDArray

from hil_mocks.gige.faults import GigeFaults
from hil_mocks.gige.gvcp import GvcpStatus, ResendRequest
from hil_mocks.gige.gvsp import (
    GVSP_HEADER_BYTES,
    IP_UDP_HEADER_BYTES,
    GvspHeader,
    ImageLeader,
    PacketFormat,
    encode_header,
    encode_leader,
    encode_payload_packets,
    encode_trailer,
    payload_bytes_per_packet,
)
from hil_mocks.gige.registers import StreamTarget

BLOCKS_KEPT = 8
"""Number of blocks whose packets can be resent."""

UDP_SEGMENT = 103
"""Linux, linux/udp.h: the kernel cuts one buffer into datagrams, which costs less than a call
for each; ``benchmarks/speed/gige_device.py``. A packet socket (a sniffer, or a client that runs as
root and reads one) sees the buffer before it is cut."""

MAX_SEGMENTS = 64
MAX_UDP_BYTES = 65507
BURST_S = 0.5e-3
"""Packets are sent in bursts of this length, on average at the set bandwidth."""

CORRUPT_PAYLOAD_TYPE = 0x7FFF
PAYLOAD_TYPE_PLACE = GVSP_HEADER_BYTES + 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """The packets of one frame: leader (id 0), payload, trailer."""

    block_id: int
    leader: bytes
    payload: NDArray[np.uint8]
    stride: int
    trailer: bytes

    @property
    def packet_count(self) -> int:
        """Number of packets, leader and trailer included."""
        return -(-self.payload.size // self.stride) + 2

    def packet(self, packet_id: int) -> memoryview:
        """One packet as it goes into a datagram."""
        if packet_id == 0:
            return memoryview(self.leader)
        if packet_id == self.packet_count - 1:
            return memoryview(self.trailer)
        start = (packet_id - 1) * self.stride
        return self.payload[start : start + self.stride].data

    @classmethod
    def of_image(
        cls,
        block_id: int,
        leader: ImageLeader,
        image_bytes: NDArray[np.uint8],
        packet_size_bytes: int,
    ) -> "Block":
        """Cut an image into packets."""
        payload_bytes = payload_bytes_per_packet(packet_size_bytes)
        count = -(-image_bytes.size // payload_bytes)
        return cls(
            block_id=block_id,
            leader=encode_leader(block_id, leader),
            payload=encode_payload_packets(block_id, image_bytes, payload_bytes),
            stride=payload_bytes + GVSP_HEADER_BYTES,
            trailer=encode_trailer(block_id, count + 1, leader),
        )


class StreamSender:
    """Sends blocks over a link: at a set rate, within its MTU, with the present faults.

    Parameters
    ----------
    port
        The stream channel's UDP socket.
    faults
        The present faults.
    link_mtu_bytes
        Larger packets are lost, as on a link that does not carry them.
    """

    def __init__(
        self, port: socket.socket, faults: Callable[[], GigeFaults], *, link_mtu_bytes: int
    ) -> None:
        self._port = port
        self._faults = faults
        self._link_mtu_bytes = link_mtu_bytes
        self._kept: OrderedDict[int, Block] = OrderedDict()
        self._lock = Lock()
        self._resends = 0
        self._blocks = 0

    def forget(self) -> None:
        """Drop the blocks whose packets could be resent."""
        with self._lock:
            self._kept.clear()

    def send_block(self, block: Block, target: StreamTarget, bandwidth_bps: float) -> None:
        """Send a frame and keep it for a while.

        Parameters
        ----------
        block
            The frame.
        target
            Destination, if it can be reached.
        bandwidth_bps
            In bytes per second, IP and UDP headers included.
        """
        with self._lock:
            self._kept.pop(block.block_id, None)
            self._kept[block.block_id] = block
            while len(self._kept) > BLOCKS_KEPT:
                self._kept.popitem(last=False)
        if not target.is_reachable:
            return
        faults = self._faults()
        to = _socket_address(target)
        pause_s = (block.stride + IP_UDP_HEADER_BYTES) / bandwidth_bps
        pause_s += target.packet_delay_ns * 1e-9
        self._blocks += 1
        if faults.disturbs_packets:
            order = faults.order_of_arrival(block.packet_count, 2 * self._blocks)
            self._send_each([block.packet(packet_id) for packet_id in order], to, pause_s)
            return
        leader = block.leader
        if faults.corrupt_leader:
            leader = (
                leader[:PAYLOAD_TYPE_PLACE]
                + struct.pack(">H", CORRUPT_PAYLOAD_TYPE)
                + leader[PAYLOAD_TYPE_PLACE + 2 :]
            )
        self._send(memoryview(leader), to)
        self._send_payload(block, to, pause_s)
        self._send(memoryview(block.trailer), to)

    def send_again(self, request: ResendRequest, target: StreamTarget) -> None:
        """Resend packets of a kept block; for one that is gone only its header is sent."""
        if not target.is_reachable:
            return
        faults = self._faults()
        with self._lock:
            block = self._kept.get(request.block_id)
            self._resends += 1
            draw = 2 * self._resends + 1
        last = request.last
        if block is not None:
            last = min(last, block.packet_count - 1)
        packet_ids = range(request.first, last + 1)
        to = _socket_address(target)
        if block is None:
            unavailable = GvspHeader(
                status=GvcpStatus.PACKET_UNAVAILABLE,
                block_id=request.block_id,
                packet_format=PacketFormat.PAYLOAD,
                packet_id=request.first,
            )
            self._send(memoryview(encode_header(unavailable)), to)
            return
        order = faults.order_of_arrival(len(packet_ids), draw)
        for index in order:
            self._send(block.packet(packet_ids[index]), to)

    def send_test_packet(self, target: StreamTarget) -> None:
        """Send one packet of the set size that belongs to no frame."""
        if not target.is_reachable:
            return
        header = GvspHeader(block_id=0, packet_format=PacketFormat.PAYLOAD, packet_id=0)
        size = target.packet_size_bytes - IP_UDP_HEADER_BYTES
        self._send(memoryview(encode_header(header).ljust(size, b"\0")), _socket_address(target))

    def _send_payload(self, block: Block, to: tuple[str, int], pause_s: float) -> None:
        stride = block.stride
        per_burst = max(1, min(MAX_SEGMENTS, MAX_UDP_BYTES // stride, int(BURST_S / pause_s)))
        count = block.packet_count - 2
        if per_burst == 1 or not self._fits(stride):
            packets = [block.packet(packet_id) for packet_id in range(1, count + 1)]
            self._send_each(packets, to, pause_s)
            return
        control = [(socket.IPPROTO_UDP, UDP_SEGMENT, struct.pack("=H", stride))]
        payload = block.payload.data
        started_s = monotonic()
        for first in range(0, count, per_burst):
            _wait_until(started_s + first * pause_s)
            burst = payload[first * stride : (first + per_burst) * stride]
            if self._faults().is_dead:
                return
            if not self._send_segments(burst, control, to):
                for packet_id in range(first + 1, min(first + per_burst, count) + 1):
                    self._send(block.packet(packet_id), to)

    def _send_segments(
        self, burst: memoryview, control: list[tuple[int, int, bytes]], to: tuple[str, int]
    ) -> bool:
        try:
            self._port.sendmsg([burst], control, 0, to)
        except OSError:  # a kernel without UDP_SEGMENT, or an absent destination
            return False
        return True

    def _send_each(self, packets: list[memoryview], to: tuple[str, int], pause_s: float) -> None:
        started_s = monotonic()
        for number, packet in enumerate(packets):
            if number * pause_s > monotonic() - started_s + BURST_S:
                _wait_until(started_s + number * pause_s)
            if self._faults().is_dead:
                return
            self._send(packet, to)

    def _send(self, packet: memoryview, to: tuple[str, int]) -> None:
        if not self._fits(packet.nbytes) or self._faults().is_dead:
            return
        try:
            self._port.sendto(packet, to)
        except OSError:  # an absent destination: the packet is lost, as on a link
            return

    def _fits(self, udp_bytes: int) -> bool:
        return udp_bytes + IP_UDP_HEADER_BYTES <= self._link_mtu_bytes


def _socket_address(target: StreamTarget) -> tuple[str, int]:
    return str(ipaddress.IPv4Address(target.address)), target.port


def _wait_until(moment_s: float) -> None:
    left_s = moment_s - monotonic()
    if left_s > 0:
        sleep(left_s)
