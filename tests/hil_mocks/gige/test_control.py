"""The control channel of the running device, spoken to with bytes."""

import socket
import struct
import threading
from time import monotonic
from xml.etree import ElementTree

import numpy as np
import pytest

from acquisition.errors import DeviceError
from hil_mocks.gige import GigeDevice, GigeFaults
from hil_mocks.gige._registers import BootstrapAddress, Capability
from hil_mocks.gige._wire import CommandCode, GvcpStatus, RegisterWrite
from hil_mocks.practice_bench import PracticeBench
from tests.busy_machine import BUSY_S
from tests.hil_mocks.gige_bench import gige_bench
from tests.hil_mocks.gige_client import SILENCE_S, RawClient, wait_for
from tests.hil_mocks.gige_wire import (
    encode_command,
    encode_read_memory,
    encode_read_registers,
    encode_write_memory,
    encode_write_registers,
)

FUZZED = 3000
BURST = 50
"""So few fit into a socket's buffer: of more at once some are lost before they are read."""
CCP = BootstrapAddress.CONTROL_PRIVILEGE
HEARTBEAT = BootstrapAddress.HEARTBEAT_TIMEOUT
HEARTBEAT_MS = 2000


def description_of(client: RawClient) -> bytes:
    url = client.read_memory(BootstrapAddress.FIRST_URL, 512).rstrip(b"\0").decode()
    place, _, rest = url.removeprefix("Local:").partition(";")
    assert place.endswith(".xml")
    address, length = (int(number, 16) for number in rest.split(";"))
    data = b"".join(
        client.read_memory(at, min(512, -(-(address + length - at) // 4) * 4))
        for at in range(address, address + length, 512)
    )
    return data[:length]


def test_discovery_says_who_the_camera_is(client: RawClient, bench: PracticeBench) -> None:
    payload = client.ask(CommandCode.DISCOVERY).payload
    assert len(payload) == 0xF8
    assert payload[0x24:0x28] == socket.inet_aton(bench.camera.address)
    assert payload[0x48:0x68].rstrip(b"\0") == b"standoff"
    _, high, middle, low = (int(part) for part in bench.camera.address.split("."))
    serial = f"SIM-{(high * 256 + middle) * 256 + low}"
    assert payload[0xD8:0xE8].rstrip(b"\0").decode() == serial  # of each address another one


def test_the_description_is_where_the_url_says(client: RawClient) -> None:
    root = ElementTree.fromstring(description_of(client))
    names = {node.get("Name") for node in root.iter()}
    for name in (
        "Width", "Height", "OffsetX", "OffsetY", "SensorWidth", "SensorHeight", "PixelFormat",
        "ExposureTimeAbs", "ExposureAuto", "Gain", "GainAuto", "AcquisitionFrameRateAbs",
        "AcquisitionFrameRateLimit", "GevSCPSPacketSize", "StreamBytesPerSecond", "TriggerMode",
        "TriggerSource", "TriggerSoftware", "TriggerSelector", "AcquisitionMode",
        "AcquisitionStart", "AcquisitionStop", "Gamma", "GammaEnable", "LUTEnable",
        "BinningHorizontal", "BinningVertical", "BlackLevel", "PayloadSize", "DeviceVendorName",
        "DeviceModelName", "DeviceID",
    ):  # fmt: skip
        assert name in names, name
    assert "DeviceTemperature" not in names


def test_memory_beyond_the_description_is_padded(client: RawClient) -> None:
    length = len(description_of(client))
    end = 0x20000 + -(-length // 4) * 4
    assert client.read_memory(end - 4, 536)[4:] == bytes(532)


def test_a_temperature_is_described_once_it_is_asked_for(
    client: RawClient, bench: PracticeBench
) -> None:
    bench.camera.faults = GigeFaults(temperature_present=True)
    assert b"DeviceTemperature" in description_of(client)
    assert client.get("DeviceTemperature") == 41.5
    bench.camera.faults = GigeFaults()
    assert b"DeviceTemperature" not in description_of(client)


def test_power_up_is_that_of_a_manta(client: RawClient) -> None:
    assert client.get("GevSCPSPacketSize") == 8228
    assert client.get("StreamBytesPerSecond") == 124_000_000
    assert client.get("ExposureAuto") == client.get("GainAuto") == client.get("TriggerMode") == 0
    assert (client.get("Width"), client.get("Height")) == (96, 64)
    assert client.get("PayloadSize") == 96 * 64


def test_only_the_client_in_control_writes(bench: PracticeBench, client: RawClient) -> None:
    assert client.set("Gain", 3) == GvcpStatus.ACCESS_DENIED
    assert client.take_control() == GvcpStatus.SUCCESS
    assert client.set("Gain", 3) == GvcpStatus.SUCCESS
    with RawClient(bench.camera.address) as other:
        assert other.take_control() == GvcpStatus.ACCESS_DENIED
        assert other.set("Gain", 6) == GvcpStatus.ACCESS_DENIED
        assert other.get("Gain") == 3
        assert client.write(CCP, 0) == GvcpStatus.SUCCESS
        assert other.take_control() == GvcpStatus.SUCCESS
    assert client.set("Gain", 6) == GvcpStatus.ACCESS_DENIED


def test_a_refused_write_says_which_register_or_byte_was_refused(client: RawClient) -> None:
    client.take_control()
    gain, black_level = client.features["Gain"], client.features["BlackLevel"]
    assert gain.address + gain.length == black_level.address
    # Gain takes its 8 bytes; the level after them is out of range.
    data = struct.pack(">dd", 3.0, 1e6)
    refused = client.ask(CommandCode.WRITEMEM, encode_write_memory(gain.address, data))
    assert refused.status == GvcpStatus.INVALID_PARAMETER
    # By hand, section 16.4: reserved, index of the first byte that was not written.
    assert refused.payload == bytes.fromhex("0000 0008")
    assert client.get("Gain") == 3.0

    heartbeat = RegisterWrite(address=HEARTBEAT, value=HEARTBEAT_MS)
    nowhere = RegisterWrite(address=0x9000, value=1)
    writes = encode_write_registers([heartbeat, heartbeat, nowhere, heartbeat])
    refused = client.ask(CommandCode.WRITEREG, writes)
    assert refused.status == GvcpStatus.INVALID_ADDRESS
    assert refused.payload == bytes.fromhex("0000 0002")

    # A read that is refused has no payload.
    refused = client.ask(CommandCode.READREG, encode_read_registers([0x9000]))
    assert (refused.status, refused.payload) == (GvcpStatus.INVALID_ADDRESS, b"")


def test_a_write_without_control_is_refused_from_its_first_byte(client: RawClient) -> None:
    data = encode_write_memory(client.features["Gain"].address, struct.pack(">d", 3.0))
    refused = client.ask(CommandCode.WRITEMEM, data)
    assert (refused.status, refused.payload) == (GvcpStatus.ACCESS_DENIED, bytes(4))


def test_an_exclusive_client_keeps_others_from_reading(
    bench: PracticeBench, client: RawClient
) -> None:
    assert client.write(CCP, 1) == GvcpStatus.SUCCESS
    with RawClient(bench.camera.address) as other:
        read = other.ask(CommandCode.READREG, encode_read_registers([CCP]))
        assert read.status == GvcpStatus.ACCESS_DENIED
        assert other.is_answered()  # a discovery


@pytest.mark.slow
def test_control_expires_without_a_heartbeat_and_the_stream_ends(
    bench: PracticeBench, client: RawClient
) -> None:
    client.start(AcquisitionFrameRateAbs=50)
    client.block()
    heard_s = monotonic()
    assert client.write(HEARTBEAT, 500) == GvcpStatus.SUCCESS
    wait_for(lambda: bench.camera.controller is None)
    assert 0.5 <= monotonic() - heard_s < 0.6 + BUSY_S
    assert bench.camera.value("AcquisitionActive") == 0
    with RawClient(bench.camera.address) as other:
        assert other.take_control() == GvcpStatus.SUCCESS
        assert other.read(BootstrapAddress.STREAM_PORT) == 0


@pytest.mark.slow
def test_commands_keep_control_alive(bench: PracticeBench, client: RawClient) -> None:
    client.take_control()
    client.write(HEARTBEAT, HEARTBEAT_MS)
    begun_s = monotonic()
    # Long enough that no busy machine keeps a read waiting for as long.
    while monotonic() - begun_s < 1.2e-3 * HEARTBEAT_MS:
        assert client.read(CCP) == 2
    assert bench.camera.controller is not None


@pytest.mark.slow
def test_heartbeats_can_get_lost(bench: PracticeBench, client: RawClient) -> None:
    client.take_control()
    client.write(HEARTBEAT, 500)
    bench.camera.faults = GigeFaults(heartbeat_lost=True)
    wait_for(lambda: client.read(CCP) == 0)
    assert client.set("Gain", 3) == GvcpStatus.ACCESS_DENIED


def test_control_can_be_taken_away(bench: PracticeBench, client: RawClient) -> None:
    client.start()
    bench.camera.drop_control()
    assert client.set("Gain", 3) == GvcpStatus.ACCESS_DENIED
    assert client.read(BootstrapAddress.STREAM_PORT) == 0


def test_a_restart_loses_control_and_settings(bench: PracticeBench, client: RawClient) -> None:
    client.start(Gain=6, GevSCPSPacketSize=1500)
    client.block()
    bench.camera.restart()
    assert client.set("Gain", 3) == GvcpStatus.ACCESS_DENIED
    assert client.get("Gain") == 0
    assert client.get("GevSCPSPacketSize") == 8228
    assert bench.camera.value("AcquisitionActive") == 0


@pytest.mark.slow
def test_a_dead_camera_answers_nothing_until_it_is_back(
    bench: PracticeBench, client: RawClient
) -> None:
    client.start(AcquisitionFrameRateAbs=50)
    client.block()
    bench.camera.faults = GigeFaults(is_dead=True)
    assert not client.is_answered(SILENCE_S)
    list(client.packets())
    assert not client.is_streamed_to()
    bench.camera.faults = GigeFaults()
    wait_for(lambda: client.is_answered(SILENCE_S))


def test_a_refused_register_refuses_and_others_do_not(
    bench: PracticeBench, client: RawClient
) -> None:
    client.take_control()
    bench.camera.faults = GigeFaults(refused_registers=frozenset({"Gain", "AcquisitionStart"}))
    assert client.set("Gain", 3) == GvcpStatus.WRITE_PROTECT
    assert client.set("AcquisitionStart", 1) == GvcpStatus.WRITE_PROTECT
    assert client.set("ExposureTimeAbs", 500) == GvcpStatus.SUCCESS
    assert client.get("Gain") == 0


def test_a_slow_write_is_announced_to_clients_that_understand_it(
    bench: PracticeBench, client: RawClient
) -> None:
    client.take_control()
    bench.camera.faults = GigeFaults(slow_writes_s=0.05)
    assert client.set("Gain", 3) == GvcpStatus.SUCCESS  # no word of patience before
    assert client.write(BootstrapAddress.GVCP_CONFIGURATION, 0x4) == GvcpStatus.SUCCESS
    payload = encode_write_registers(
        [RegisterWrite(address=client.features["TriggerMode"].address, value=1)]
    )
    pending = client.ask_raw(encode_command(CommandCode.WRITEREG, 999, payload))
    assert (pending.code, pending.request_id) == (0x89, 999)
    assert int.from_bytes(pending.payload[2:], "big") >= 50
    done = client.acknowledge()
    assert (done.code, done.status) == (0x83, GvcpStatus.SUCCESS)


@pytest.mark.parametrize(
    ("name", "value", "kept"),
    [
        ("ExposureTimeAbs", 20.0, 15_000.0),
        ("ExposureTimeAbs", float("nan"), 15_000.0),
        ("ExposureTimeAbs", float("inf"), 15_000.0),
        ("Gain", 31.5, 0.0),
        ("Width", 97, 96),
        ("Width", 17, 96),  # steps of 2
        ("OffsetX", 2, 0),  # the region fills the sensor
        ("PixelFormat", 0x12345678, 0x01080001),
        ("GammaEnable", 2, 0),
        ("AcquisitionFrameRateAbs", 70.0, 30.0),
        ("StreamBytesPerSecond", 125_000_000, 124_000_000),
    ],
)
def test_what_is_out_of_range_is_refused_and_nothing_changes(
    client: RawClient, name: str, value: float, kept: float
) -> None:
    client.take_control()
    assert client.set(name, value) == GvcpStatus.INVALID_PARAMETER
    assert client.get(name) == kept


def test_the_limits_of_the_region_follow_its_offset(client: RawClient) -> None:
    client.take_control()
    for name, value in (("Width", 32), ("OffsetX", 20)):
        assert client.set(name, value) == GvcpStatus.SUCCESS
    assert (client.get("WidthMax"), client.get("WidthLimit")) == (96, 76)
    assert client.get("OffsetXMax") == 64
    assert client.set("Width", 78) == GvcpStatus.INVALID_PARAMETER
    assert client.set("Width", 76) == GvcpStatus.SUCCESS


def test_values_are_rounded_to_the_step_of_the_camera(client: RawClient) -> None:
    client.take_control()
    for name, asked, got in (("ExposureTimeAbs", 99.6, 100.0), ("Gain", 2.4, 2.0)):
        assert client.set(name, asked) == GvcpStatus.SUCCESS
        assert client.get(name) == got


def test_a_packet_size_that_it_cannot_have_becomes_the_nearest_below(client: RawClient) -> None:
    client.take_control()
    for asked, got in ((9000, 8228), (1502, 1500), (100, 500)):
        assert client.write(BootstrapAddress.STREAM_PACKET_SIZE, asked) == GvcpStatus.SUCCESS
        assert client.get("GevSCPSPacketSize") == got


def test_the_geometry_is_locked_while_frames_are_taken(client: RawClient) -> None:
    client.start(AcquisitionFrameRateAbs=50)
    assert client.set("Width", 32) == GvcpStatus.WRITE_PROTECT
    assert client.set("ExposureTimeAbs", 5000) == GvcpStatus.SUCCESS
    client.set("AcquisitionStop", 1)
    assert client.set("Width", 32) == GvcpStatus.SUCCESS


def test_wrong_addresses_have_the_status_of_the_standard(client: RawClient) -> None:
    client.take_control()
    assert client.write(0x0938 + 2, 0) == GvcpStatus.BAD_ALIGNMENT
    assert client.write(0x0000, 0) == GvcpStatus.WRITE_PROTECT
    assert client.write(0x7000_0000, 0) == GvcpStatus.INVALID_ADDRESS
    read = client.ask(CommandCode.READMEM, encode_read_memory(0x7000_0000, 4))
    assert read.status == GvcpStatus.INVALID_ADDRESS
    assert client.ask(0x0100).status == GvcpStatus.NOT_IMPLEMENTED  # ACTION


def test_force_ip_and_commands_without_acknowledge_are_not_answered(client: RawClient) -> None:
    for datagram in (
        encode_command(CommandCode.FORCEIP, 5, bytes(56)),
        encode_command(CommandCode.READREG, 6, encode_read_registers([0]), flags=0),
    ):
        with pytest.raises(TimeoutError):
            client.ask_raw(datagram, 0.2)
    assert client.is_answered()


def test_a_repeated_command_is_answered_again_but_done_once(
    bench: PracticeBench, client: RawClient
) -> None:
    client.take_control()
    payload = encode_write_registers(
        [RegisterWrite(address=client.features["AcquisitionStart"].address, value=1)]
    )
    start = encode_command(CommandCode.WRITEREG, 77, payload)
    assert client.ask_raw(start).status == GvcpStatus.SUCCESS
    client.set("AcquisitionStop", 1)
    again = client.ask_raw(start)
    assert (again.status, again.request_id) == (GvcpStatus.SUCCESS, 77)
    assert client.ask_raw(start).status == GvcpStatus.SUCCESS
    assert bench.camera.acquisitions == 2  # another command lay between the first two
    assert client.set("Gain", 1) == GvcpStatus.SUCCESS


def test_the_capabilities_follow_the_fault(bench: PracticeBench, client: RawClient) -> None:
    place = BootstrapAddress.CAPABILITY
    assert client.read(place) & Capability.PACKETRESEND
    bench.camera.faults = GigeFaults(resend_disabled=True)
    assert not client.read(place) & Capability.PACKETRESEND


def test_the_user_name_can_be_written_and_read(client: RawClient) -> None:
    client.take_control()
    name = b"left".ljust(16, b"\0")
    payload = BootstrapAddress.USER_NAME.to_bytes(4, "big") + name
    assert client.ask(CommandCode.WRITEMEM, payload).status == GvcpStatus.SUCCESS
    assert client.read_memory(BootstrapAddress.USER_NAME, 16) == name


def _arbitrary_datagram(rng: np.random.Generator, number: int) -> bytes:
    """Noise for every third; else a command, and for every fifth one near the registers."""
    payload = rng.bytes(int(rng.integers(0, 60)))
    if number % 3 == 0:
        return payload
    codes = [int(code) for code in CommandCode]
    code = codes[number % len(codes)] if number % 2 else int(rng.integers(0, 65536))
    if number % 5 == 0:
        place = int(rng.choice([0x0A00, 0x0D00, 0x0D04, 0xA010, 0xA108]))
        payload = place.to_bytes(4, "big") + rng.bytes(4 * int(rng.integers(1, 4)))
    return encode_command(code, int(rng.integers(1, 65536)), payload)


def test_arbitrary_datagrams_do_not_end_the_camera(bench: PracticeBench, client: RawClient) -> None:
    rng = np.random.default_rng(3)
    client.take_control()
    with RawClient(bench.camera.address) as other:
        for number in range(FUZZED):
            client.control.sendto(_arbitrary_datagram(rng, number), client.camera)
            if number % BURST == BURST - 1:
                wait_for(lambda: other.is_answered(SILENCE_S))
        bench.camera.drop_control()
        wait_for(lambda: other.take_control() == GvcpStatus.SUCCESS)
        assert other.set("Gain", 5) == GvcpStatus.SUCCESS
        bench.camera.restart()
        other.start(AcquisitionFrameRateAbs=50)
        assert other.block().leader.width == 96


def test_closing_leaves_no_thread_and_no_socket() -> None:
    threads = threading.active_count()
    with gige_bench() as bench:
        camera = bench.camera
    for _ in range(30):
        with camera, RawClient(camera.address) as client:
            client.start(AcquisitionFrameRateAbs=60)
            client.block()
        assert threading.active_count() == threads
        camera.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind((camera.address, 3956))


def test_an_address_in_use_is_named_in_one_line() -> None:
    with gige_bench() as bench:
        other = GigeDevice(bench.source, address=bench.camera.address)
        with pytest.raises(DeviceError) as refused:
            other.open()
        assert bench.camera.address in str(refused.value)


@pytest.mark.parametrize("address", ["192.0.2.1", "0.0.0.0", "bench", "::1"])
def test_an_address_outside_the_loopback_network_is_refused(address: str) -> None:
    with gige_bench() as bench, pytest.raises(ValueError):
        GigeDevice(bench.source, address=address)


def test_two_cameras_live_side_by_side() -> None:
    with gige_bench() as left, gige_bench() as right:
        assert left.camera.address != right.camera.address
        with RawClient(left.camera.address) as one, RawClient(right.camera.address) as two:
            for client in (one, two):
                client.start(AcquisitionFrameRateAbs=50)
            assert one.block().leader.width == two.block().leader.width == 96
