"""Events of the device: by hand, with bytes, and as viva-genicam receives them."""

import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from time import monotonic

import pytest

from hil_mocks.gige import GigeFaults
from hil_mocks.gige._events import DeviceEvent, EventId, encode_event
from hil_mocks.gige._registers import BootstrapAddress
from hil_mocks.gige._wire import CommandCode, GvcpStatus
from hil_mocks.practice_bench import PracticeBench
from tests.busy_machine import BUSY_S
from tests.hil_mocks.gige_client import FRAME_S, HEARTBEAT_MS, SILENCE_S, RawClient
from tests.hil_mocks.gige_introducer import introduced
from tests.hil_mocks.gige_wire import parse_acknowledge

EXPOSURE_END, TEST = 4, 0x9000
RESEND_MS = 50
RETRIES = 2


def test_an_event_is_laid_out_as_the_standard_says() -> None:
    event = DeviceEvent(event_id=EventId.EXPOSURE_END, timestamp_ticks=0x1_0000_0002, block_id=7)
    # By hand: key, flag "acknowledge", EVENT, 16 bytes, request 5; reserved, event 4, stream
    # channel 0, block 7, both halves of the time stamp.
    assert encode_event(5, event, wants_acknowledge=True) == bytes.fromhex(
        "42 01 00C0 0010 0005  0000 0004 0000 0007 00000001 00000002"
    )
    with_data = DeviceEvent(event_id=EventId.TEST, timestamp_ticks=3, data=b"abcd")
    assert encode_event(6, with_data, wants_acknowledge=False) == bytes.fromhex(
        "42 00 00C2 0014 0006  0000 9000 0000 0000 00000000 00000003 61626364"
    )


class Listener:
    """A client's end of the message channel."""

    def __init__(self, client: RawClient, *, timeout_ms: int = 0) -> None:
        self.port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.port.bind(("127.0.0.1", 0))
        assert client.take_control() == GvcpStatus.SUCCESS
        for address, value in (
            (BootstrapAddress.HEARTBEAT_TIMEOUT, HEARTBEAT_MS),
            (BootstrapAddress.MESSAGE_DESTINATION, client.ip),
            (BootstrapAddress.MESSAGE_TIMEOUT, timeout_ms),
            (BootstrapAddress.MESSAGE_RETRIES, RETRIES),
            (BootstrapAddress.MESSAGE_PORT, self.port.getsockname()[1]),
        ):
            assert client.write(address, value) == GvcpStatus.SUCCESS

    def datagram(self, within_s: float = FRAME_S) -> tuple[bytes, tuple[str, int]]:
        self.port.settimeout(within_s)
        datagram, peer = self.port.recvfrom(2000)
        return datagram, peer

    def is_silent(self) -> bool:
        with suppress(TimeoutError):
            self.datagram(SILENCE_S)
            return False
        return True


@pytest.fixture
def listener(client: RawClient) -> Iterator[Listener]:
    listener = Listener(client)
    yield listener
    listener.port.close()


def switch_on(client: RawClient, event: int) -> None:
    assert client.set("EventSelector", event) == GvcpStatus.SUCCESS
    assert client.set("EventNotification", 1) == GvcpStatus.SUCCESS


def test_every_frame_ends_its_exposure_with_its_number_and_time(
    client: RawClient, listener: Listener
) -> None:
    switch_on(client, EXPOSURE_END)
    client.start(AcquisitionMode=2, AcquisitionFrameCount=3, AcquisitionFrameRateAbs=50)
    frames = [client.block() for _ in range(3)]
    for frame in frames:
        datagram, peer = listener.datagram()
        assert peer == (client.camera[0], client.read(BootstrapAddress.MESSAGE_SOURCE_PORT))
        event_id, _, block_id, ticks = struct.unpack(">HHHQ", datagram[10:24])
        assert event_id == EXPOSURE_END
        assert (block_id, ticks) == (frame.block_id, frame.leader.timestamp_ticks)
    assert listener.is_silent()


@pytest.mark.slow
def test_only_events_that_are_on_are_told(client: RawClient, listener: Listener) -> None:
    assert client.set("TestEventGenerate", 1) == GvcpStatus.SUCCESS
    switch_on(client, EXPOSURE_END)
    assert client.set("TestEventGenerate", 1) == GvcpStatus.SUCCESS
    assert listener.is_silent()
    switch_on(client, TEST)
    assert client.set("TestEventGenerate", 1) == GvcpStatus.SUCCESS
    datagram, _ = listener.datagram()
    assert datagram[2:4] == CommandCode.EVENTDATA.to_bytes(2, "big")
    assert datagram[10:12] == TEST.to_bytes(2, "big")
    assert datagram[24:] == (3).to_bytes(4, "big")  # the third test, two of them untold
    assert client.set("EventSelector", 5) == GvcpStatus.INVALID_PARAMETER
    assert client.set("EventNotification", 0) == GvcpStatus.SUCCESS
    assert client.set("TestEventGenerate", 1) == GvcpStatus.SUCCESS
    assert listener.is_silent()


@pytest.mark.slow
@pytest.mark.parametrize("acknowledged", [0, 1, None])
def test_an_event_is_repeated_until_it_is_acknowledged(
    client: RawClient, acknowledged: int | None
) -> None:
    listener = Listener(client, timeout_ms=RESEND_MS if acknowledged is None else 2000)
    if acknowledged:
        client.write(BootstrapAddress.MESSAGE_TIMEOUT, 300)
    switch_on(client, TEST)
    client.set("TestEventGenerate", 1)
    sent = []
    for number in range(1 + RETRIES):
        datagram, peer = listener.datagram()
        sent.append(datagram)
        if number == acknowledged:
            # By hand: success, EVENTDATA_ACK, no payload, the request's number.
            answer = bytes.fromhex("0000 00C3 0000") + datagram[6:8]
            parse_acknowledge(answer)
            listener.port.sendto(answer, peer)
            break
    assert set(sent) == {sent[0]}
    assert listener.is_silent()
    listener.port.close()


def test_no_event_comes_without_power_or_control(
    bench: PracticeBench, client: RawClient, listener: Listener
) -> None:
    switch_on(client, EXPOSURE_END)
    client.start(AcquisitionFrameRateAbs=50)
    listener.datagram()
    bench.camera.faults = GigeFaults(is_dead=True)
    while not listener.is_silent():
        pass  # what was under way
    bench.camera.faults = GigeFaults()
    listener.datagram()
    client.write(BootstrapAddress.CONTROL_PRIVILEGE, 0)
    assert client.read(BootstrapAddress.MESSAGE_PORT) == 0
    bench.camera.restart()
    assert client.take_control() == GvcpStatus.SUCCESS
    assert client.get("EventNotification") == 0


def test_a_camera_closes_whatever_acknowledge_it_waits_for(
    bench: PracticeBench, client: RawClient
) -> None:
    listener = Listener(client, timeout_ms=0xFFFFFFFF)
    switch_on(client, TEST)
    client.set("TestEventGenerate", 1)
    listener.datagram()
    closing_s = monotonic()
    bench.camera.close()
    assert monotonic() - closing_s < 0.5 + BUSY_S  # it would wait for 49 days
    listener.port.close()


def test_events_go_nowhere_but_to_this_computer(client: RawClient, listener: Listener) -> None:
    switch_on(client, TEST)
    elsewhere = int.from_bytes(socket.inet_aton("192.0.2.1"), "big")
    assert client.write(BootstrapAddress.MESSAGE_DESTINATION, elsewhere) == GvcpStatus.SUCCESS
    client.set("TestEventGenerate", 1)
    assert client.write(BootstrapAddress.MESSAGE_DESTINATION, client.ip) == GvcpStatus.SUCCESS
    client.set("TestEventGenerate", 1)
    datagram, _ = listener.datagram()
    assert datagram[24:] == (2).to_bytes(4, "big")


@pytest.mark.slow
def test_viva_genicam_receives_the_end_of_every_exposure(bench: PracticeBench) -> None:
    viva_genicam = pytest.importorskip("viva_genicam")
    with introduced(bench.camera.address):
        (info,) = viva_genicam.discover(timeout_ms=300, iface="127.0.0.1")
    with (
        viva_genicam.connect_gige(info, iface="127.0.0.1") as camera,
        camera.events(["ExposureEnd", "Test"], iface="127.0.0.1") as events,
    ):
        camera.execute("TestEventGenerate")
        test = events.next_event(20_000)
        assert (test.id, test.data) == (TEST, bytes.fromhex("00000001"))
        assert camera.event_features(test)["EventTestCount"] == "1"
        with camera.stream(iface="127.0.0.1") as frames:
            stamps = {frame.block_id: frame.ts_dev for frame, _ in zip(frames, "123", strict=False)}
            for _ in stamps:
                event = events.next_event(20_000)
                assert event.id == EXPOSURE_END
                features = camera.event_features(event)
                assert features["EventExposureEnd"] == str(EXPOSURE_END)
                assert features["EventExposureEndFrameID"] == str(event.block_id)
                assert features["EventExposureEndTimestamp"] == str(event.ts_dev)
                assert stamps.get(event.block_id, event.ts_dev) == event.ts_dev
