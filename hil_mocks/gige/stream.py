"""The frames of the simulated GigE camera: taken, processed, sent, and sent again."""

import ipaddress
import socket
import struct
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from threading import Condition, Lock, RLock, Thread
from time import monotonic, sleep

import numpy as np
from numpy.typing import NDArray

from hil_mocks.devices import following_frame_id
from hil_mocks.gige._features import Feature
from hil_mocks.gige._registers import RegisterMap, StreamTarget
from hil_mocks.gige._settings import (
    CameraState,
    FrameRequest,
    FrameSource,
    GigeFaults,
    software_triggers,
    trigger_waits,
)
from hil_mocks.gige._wire import (
    GVSP_HEADER_BYTES,
    IP_UDP_HEADER_BYTES,
    PAYLOAD_TYPE_IMAGE,
    PAYLOAD_TYPE_IMAGE_AND_CHUNKS,
    GvcpStatus,
    GvspHeader,
    ImageLeader,
    PacketFormat,
    PixelLayout,
    ResendRequest,
    encode_chunks,
    encode_header,
    encode_leader,
    encode_payload_packets,
    encode_trailer,
    payload_bytes_per_packet,
    wire_bytes,
)
from hil_mocks.truth import ADC_MAX_DN

STICKS_OUT = 1.5
"""A pixel of so many times the mean of its neighbours is replaced by it (our choice)."""

LUT_EXPONENT = 0.8
"""The look-up table that is stored in the camera lifts the shadows (our choice)."""


def _processed(level_dn: NDArray[np.uint16], settings: Mapping[str, float]) -> NDArray[np.uint16]:
    """Levels of 12 bits as they leave a camera with these settings, by their names.

    Without any of it switched on, the same array.
    """
    if settings["TestPattern"]:
        ramp = np.linspace(0, ADC_MAX_DN, level_dn.shape[1])
        level_dn = np.broadcast_to(ramp, level_dn.shape).astype(np.uint16)
    if settings["DefectCorrection"]:
        mean = _mean_of_neighbours(level_dn)
        level_dn = np.where(level_dn > STICKS_OUT * mean, mean, level_dn).astype(np.uint16)
    if settings["Sharpness"]:
        level_dn = _clipped(2.0 * level_dn - _mean_of_neighbours(level_dn))
    if settings["LUTEnable"] or settings["LUTEnableRed"]:
        level_dn = _power_table(LUT_EXPONENT)[level_dn]
    if settings["GammaEnable"] and settings["Gamma"] != 1.0:
        level_dn = _power_table(settings["Gamma"])[level_dn]
    if settings["DigitalShift"]:
        level_dn = _clipped(level_dn * 2.0 ** settings["DigitalShift"])
    if settings["ReverseX"]:
        level_dn = level_dn[:, ::-1]
    if settings["ReverseY"]:
        level_dn = level_dn[::-1]
    return level_dn


def _mean_of_neighbours(level_dn: NDArray[np.uint16]) -> NDArray[np.float64]:
    padded = np.pad(level_dn.astype(np.float64), ((0, 0), (1, 1)), mode="edge")
    return np.asarray((padded[:, :-2] + padded[:, 2:]) / 2)


def _clipped(level_dn: NDArray[np.float64]) -> NDArray[np.uint16]:
    return np.clip(np.rint(level_dn), 0, ADC_MAX_DN).astype(np.uint16)


@cache
def _power_table(exponent: float) -> NDArray[np.uint16]:
    """Level after a power law for each level of 12 bits."""
    levels = np.arange(ADC_MAX_DN + 1) / ADC_MAX_DN
    return np.rint(ADC_MAX_DN * levels**exponent).astype(np.uint16)


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
class _Block:
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
    ) -> "_Block":
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

    Packets above ``link_mtu_bytes`` are lost, as on a link that does not carry them.
    """

    def __init__(
        self, port: socket.socket, faults: Callable[[], GigeFaults], *, link_mtu_bytes: int
    ) -> None:
        self._port = port
        self._faults = faults
        self._link_mtu_bytes = link_mtu_bytes
        self._kept: OrderedDict[int, _Block] = OrderedDict()
        self._lock = Lock()
        self._resends = 0
        self._blocks = 0

    def forget(self) -> None:
        """Drop the blocks whose packets could be resent."""
        with self._lock:
            self._kept.clear()

    def send_block(self, block: _Block, target: StreamTarget, bandwidth_bps: float) -> None:
        """Send a frame and keep it for a while; the bandwidth in bytes/s counts all headers."""
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

    def _send_payload(self, block: _Block, to: tuple[str, int], pause_s: float) -> None:
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


CONTINUOUS, SINGLE_FRAME = 0, 1
POLL_WHILE_STALLED_S = 0.02
EXPOSURES_KEPT = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class _Exposure:
    """The settings of one frame, as they were at its start."""

    request: FrameRequest
    block_id: int
    timestamp_ticks: int
    layout: PixelLayout
    region: tuple[slice, slice]
    settings: Mapping[str, float]
    chunks: tuple[Feature, ...]
    counter: int
    target: StreamTarget
    bandwidth_bps: float


class Acquisition:
    """Takes one frame per period or per trigger from the source and hands it to the sender.

    Block ids begin at 1 after every start. ``lock`` guards state and registers.
    """

    def __init__(
        self,
        source: FrameSource,
        state: CameraState,
        registers: RegisterMap,
        lock: RLock,
        sender: StreamSender,
        faults: Callable[[], GigeFaults],
    ) -> None:
        self.payload_type_of_chunks = PAYLOAD_TYPE_IMAGE_AND_CHUNKS
        self.tell_exposure_end: Callable[[int, int], None] = lambda _block_id, _ticks: None
        self._source = source
        self._state = state
        self._registers = registers
        self._sender = sender
        self._faults = faults
        self._changed = Condition(lock)
        self._is_closing = False
        self._acquisitions = 0
        self._frames = 0
        self._counter = 0
        self._frames_left: int | None = None
        self._triggers: list[float] = []
        self._due_s = 0.0
        self._exposed_s = 0.0
        self.first_block_id = 1
        self._block_id = 0
        self._set_db: deque[float] = deque(maxlen=EXPOSURES_KEPT)
        self._set_us: deque[float] = deque(maxlen=EXPOSURES_KEPT)
        self._thread = Thread(target=self._run, name="gige-stream", daemon=True)

    @property
    def acquisitions(self) -> int:
        """Number of acquisition starts since power-up."""
        return self._acquisitions

    def open(self) -> None:
        """Start the thread, which waits for a start of acquisition."""
        self._thread.start()

    def close(self) -> None:
        """End the thread, at the latest after the frame that it is sending."""
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        self._thread.join()

    def start(self) -> None:
        """Take frames from now on."""
        with self._changed:
            if self._state.is_acquiring:
                return
            mode = int(self._state.quantity("AcquisitionMode"))
            self._frames_left = None
            if mode != CONTINUOUS:
                count = int(self._state.quantity("AcquisitionFrameCount"))
                self._frames_left = 1 if mode == SINGLE_FRAME else count
            self._acquisitions += 1
            self._frames = 0
            self._triggers.clear()
            self._block_id = self.first_block_id
            self._sender.forget()
            self._due_s = monotonic() + self._state.quantity("ExposureTimeAbs") * 1e-6
            self._state.is_acquiring = True
            self._changed.notify_all()

    def stop(self) -> None:
        """Take no more frames."""
        with self._changed:
            self._state.is_acquiring = False
            self._changed.notify_all()

    def trigger(self) -> None:
        """Take one frame, if frames wait for the software trigger and none is being exposed."""
        with self._changed:
            self._take_one(software_triggers(self._state.values))

    def pulse(self, line: int) -> None:
        """Take one frame, if frames wait for this line and none is being exposed."""
        with self._changed:
            values = self._state.values
            self._take_one(bool(values["TriggerMode"]) and values["TriggerSource"] == line)

    def _take_one(self, is_awaited: bool) -> None:
        if is_awaited and self._state.is_acquiring and not self._triggers:
            self._triggers.append(monotonic())
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                if not self._wait_for_frame():
                    return
                exposure = self._expose()
            self.tell_exposure_end(exposure.block_id, exposure.timestamp_ticks)
            self._deliver(exposure)

    def _wait_for_frame(self) -> bool:
        """Wait until the next frame is due; False if the camera closes."""
        while not self._is_closing:
            if not self._state.is_acquiring:
                self._changed.wait()
            elif self._faults().is_stalled or self._faults().is_dead:
                self._changed.wait(POLL_WHILE_STALLED_S)
                self._due_s = monotonic()
            elif trigger_waits(self._state.values):
                if not self._triggers:
                    self._changed.wait()
                elif self._has_come(self._triggers[0] + self._exposure_s):
                    self._exposed_s = self._triggers.pop(0) + self._exposure_s
                    return True
            elif self._has_come(self._due_s):
                # The time stamp is the sensor's, not that of a busy machine; and a late frame
                # does not hurry those that follow.
                self._exposed_s = self._due_s
                self._due_s = max(self._due_s + self._state.frame_period_s, monotonic())
                return True
        return False

    def _has_come(self, moment_s: float) -> bool:
        left_s = moment_s - monotonic()
        if left_s > 0:
            self._changed.wait(left_s)
        return left_s <= 0

    @property
    def _exposure_s(self) -> float:
        return self._state.quantity("ExposureTimeAbs") * 1e-6

    def _expose(self) -> _Exposure:
        block_id = self._block_id
        request = self._state.request(self._acquisitions, self._frames)
        self._set_us.append(request.exposure_us)
        self._set_db.append(request.gain_db)
        late = min(self._faults().exposure_delay_frames, len(self._set_us) - 1)
        gain_late = min(self._faults().gain_delay_frames, len(self._set_db) - 1)
        self._counter += 1
        exposure = _Exposure(
            request=replace(
                request,
                exposure_us=self._set_us[-1 - late],
                gain_db=self._set_db[-1 - gain_late],
            ),
            block_id=block_id,
            timestamp_ticks=self._registers.ticks_at(self._exposed_s),
            layout=self._state.layout,
            region=self._state.region,
            settings=dict(self._state.values),
            chunks=self._state.chunks,
            counter=self._counter,
            target=self._registers.stream_target,
            bandwidth_bps=self._state.quantity("StreamBytesPerSecond"),
        )
        self._frames += 1
        self._block_id = following_frame_id(block_id)
        if self._frames_left is not None:
            self._frames_left -= 1
            self._state.is_acquiring = self._frames_left > 0
        return exposure

    def _deliver(self, exposure: _Exposure) -> None:
        level_dn = self._source.levels_dn(exposure.request)
        rows, cols = exposure.region
        rows = slice(rows.start, max(rows.start + 1, rows.stop - self._faults().missing_rows))
        level_dn = level_dn[rows, cols]
        if self._state.is_automatic:
            with self._changed:
                self._state.regulate(float(level_dn.mean()))
        level_dn = _processed(level_dn, exposure.settings)
        leader = ImageLeader(
            timestamp_ticks=exposure.timestamp_ticks,
            pixel_format=exposure.layout.code,
            width=level_dn.shape[1],
            height=level_dn.shape[0],
            offset_x=cols.start,
            offset_y=rows.start,
            payload_type=self.payload_type_of_chunks if exposure.chunks else PAYLOAD_TYPE_IMAGE,
        )
        image_bytes = wire_bytes(level_dn, exposure.layout)
        if exposure.chunks:
            chunks = {chunk.chunk_id or 0: _chunk(chunk, exposure) for chunk in exposure.chunks}
            image_bytes = np.frombuffer(encode_chunks(image_bytes.tobytes(), chunks), np.uint8)
        block = _Block.of_image(
            exposure.block_id,
            leader,
            image_bytes,
            exposure.target.packet_size_bytes,
        )
        self._sender.send_block(block, exposure.target, exposure.bandwidth_bps)


def _chunk(chunk: Feature, exposure: _Exposure) -> bytes:
    """What a chunk says of a frame; integers and floats take eight bytes."""
    quantities = {
        "ExposureTimeAbs": exposure.request.exposure_us,
        "Gain": exposure.request.gain_db - exposure.settings["DigitalGain"],
        "Timestamp": exposure.timestamp_ticks,
        "FrameCounter": exposure.counter,
    }
    value = quantities[chunk.means[0][1]]
    return struct.pack(">d", value) if chunk.kind == "float" else struct.pack(">Q", int(value))
