"""The message channel of the simulated GigE camera: tells a client of events as they happen.

References
----------
GigE Vision, Video Streaming and Device Control over Ethernet Standard, version 2.0, AIA, 2011,
sections 17 (events), 21 (message channel) and 28 (registers MCP to MCSP). GenICam SFNC 2.7,
"Event Control", for the names.
"""

import itertools
import socket
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from ipaddress import IPv4Address
from queue import SimpleQueue
from threading import Event, Thread
from time import monotonic
from typing import Self

from hil_mocks.gige._wire import (
    HEADER_BYTES,
    KEY,
    CommandCode,
    CommandFlag,
    GvcpError,
    GvcpStatus,
    acknowledge_code,
)

EventWord = tuple[int, str, Callable[[], int], Callable[[int], None]]

REQUEST_IDS = 0xFFFF
LARGEST_ACKNOWLEDGE = 64
CLOSES_WITHIN_S = 0.1
EVENT_SELECTOR, EVENT_NOTIFICATION = 0xA3C0, 0xA3C4
"""Addresses of the features that switch events on."""


class EventId(IntEnum):
    """Numbers of the events; those from 0x9000 on are a device's own."""

    EXPOSURE_END = 0x0004
    TEST = 0x9000


EVENT_NAMES = {EventId.EXPOSURE_END: "ExposureEnd", EventId.TEST: "Test"}
EVENT_PARTS: dict[EventId, tuple[tuple[str, int, int], ...]] = {
    EventId.EXPOSURE_END: (("", 2, 2), ("FrameID", 6, 2), ("Timestamp", 8, 8)),
    EventId.TEST: (("", 2, 2), ("Timestamp", 8, 8), ("Count", 16, 4)),
}
"""Features of each event: the end of the name, and where in the event it is, in bytes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceEvent:
    """One event; ``block_id`` is 0 if it is of no frame. One with data is sent by EVENTDATA."""

    event_id: EventId
    timestamp_ticks: int
    block_id: int = 0
    data: bytes = b""


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageTarget:
    """Where events go, how long an acknowledge is waited for, and how often they are repeated."""

    address: IPv4Address
    port: int
    timeout_s: float
    retries: int

    @classmethod
    def of(cls, address: int, port: int, timeout_ms: int, retries: int) -> Self:
        """Read it from the registers MCDA, MCP, MCTT and MCRC."""
        return cls(
            address=IPv4Address(address), port=port, timeout_s=timeout_ms / 1000, retries=retries
        )

    @property
    def is_reachable(self) -> bool:
        """Whether anything is sent there: only within this computer."""
        return self.port != 0 and self.address.is_loopback

    @property
    def peer(self) -> tuple[str, int]:
        """Address and port, for a socket."""
        return str(self.address), self.port


class EventSwitches:
    """Which events are on: EventNotification for what EventSelector says."""

    def __init__(self) -> None:
        self.selected = int(EventId.EXPOSURE_END)
        self._on: set[int] = set()

    def power_up(self) -> None:
        """Select the first event, and switch all off."""
        self.selected = int(EventId.EXPOSURE_END)
        self._on.clear()

    def words(self) -> tuple[EventWord, EventWord]:
        """Its two registers: address, name, how it is read and how it is written."""
        return (
            (EVENT_SELECTOR, "EventSelector", lambda: self.selected, self._select),
            (
                EVENT_NOTIFICATION,
                "EventNotification",
                lambda: int(self.selected in self._on),
                self._switch,
            ),
        )

    def is_on(self, event_id: EventId) -> bool:
        """Whether clients are told of an event."""
        return event_id in self._on

    def _select(self, value: int) -> None:
        if value not in tuple(EventId):
            raise GvcpError(f"no event {value:#x}", status=GvcpStatus.INVALID_PARAMETER)
        self.selected = value

    def _switch(self, value: int) -> None:
        (self._on.add if value else self._on.discard)(self.selected)


def encode_event(request_id: int, event: DeviceEvent, *, wants_acknowledge: bool) -> bytes:
    """Return the datagram that tells a client of an event."""
    code = CommandCode.EVENTDATA if event.data else CommandCode.EVENT
    high, low = event.timestamp_ticks >> 32, event.timestamp_ticks & 0xFFFFFFFF
    item = struct.pack(">HHHHII", 0, event.event_id, 0, event.block_id, high, low) + event.data
    flags = CommandFlag.ACKNOWLEDGE if wants_acknowledge else 0
    return struct.pack(">BBHHH", KEY, flags, code, len(item), request_id) + item


class MessageChannel:
    """Sends one event after the other from its own thread.

    An event that is not acknowledged in time is sent again, as often as the client set; without a
    time limit no acknowledge is asked for. ``target`` gives None if nothing may be sent.
    """

    def __init__(self, port: socket.socket, target: Callable[[], MessageTarget | None]) -> None:
        self._port = port
        self._target = target
        self._events: SimpleQueue[tuple[DeviceEvent, MessageTarget] | None] = SimpleQueue()
        self._closing = Event()
        self._thread = Thread(target=self._run, name="gige-events", daemon=True)

    def open(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread soon, whatever waits for an acknowledge."""
        self._closing.set()
        self._events.put(None)
        self._thread.join()

    def tell(self, event: DeviceEvent) -> None:
        """Send an event to the present target; returns at once."""
        target = self._target()
        if target is not None:
            self._events.put((event, target))

    def _run(self) -> None:
        request_ids = itertools.cycle(range(1, REQUEST_IDS + 1))
        while (next_one := self._events.get()) is not None:
            self._send(next(request_ids), *next_one)

    def _send(self, request_id: int, event: DeviceEvent, target: MessageTarget) -> None:
        datagram = encode_event(request_id, event, wants_acknowledge=target.timeout_s > 0)
        for _ in range(1 + target.retries):
            with suppress(OSError):  # the client is gone
                self._port.sendto(datagram, target.peer)
            if target.timeout_s == 0 or self._is_acknowledged(datagram, target):
                return
            if self._closing.is_set():
                return

    def _is_acknowledged(self, datagram: bytes, target: MessageTarget) -> bool:
        code, request_id = datagram[2:4], datagram[6:8]
        expected = struct.pack(">H", acknowledge_code(int.from_bytes(code, "big")))
        deadline = monotonic() + target.timeout_s
        while (left_s := deadline - monotonic()) > 0 and not self._closing.is_set():
            self._port.settimeout(min(left_s, CLOSES_WITHIN_S))
            try:
                answer, peer = self._port.recvfrom(LARGEST_ACKNOWLEDGE)
            except OSError:  # late, or nobody listens at the client's port
                continue
            is_whole = len(answer) == HEADER_BYTES and answer[:2] == b"\0\0"
            is_ours = answer[2:4] == expected and answer[6:8] == request_id
            if is_whole and is_ours and peer == target.peer:
                return True
        return False
