"""Discovery of the device: at its own address, and by broadcast in a network of the test's own."""

import json
import socket
import subprocess
import sys

import pytest

from hil_mocks.gige._wire import GVCP_PORT, CommandCode
from hil_mocks.practice_bench import PracticeBench
from tests.hil_mocks.benches import bench_config
from tests.hil_mocks.gige_client import SILENCE_S
from tests.hil_mocks.gige_wire import encode_command, encode_read_registers, parse_acknowledge
from tests.hil_mocks.own_network import give_address, run_in_own_network

ADDRESSES = ("127.0.0.1", "127.9.8.7")
OTHER_NETWORK = "10.1.2.3"
HERE = "tests.hil_mocks.gige.test_discovery"


def bench_at(address: str) -> PracticeBench:
    return PracticeBench(bench_config(), height_mm=lambda: 200.0, address=address)


def answers_to_broadcast(datagram: bytes, source: str = "127.0.0.1") -> list[str]:
    """Addresses that answer a broadcast from an address, in order."""
    found: list[str] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        asking.bind((source, 0))
        asking.settimeout(3 * SILENCE_S)
        asking.sendto(datagram, ("255.255.255.255", GVCP_PORT))
        while True:
            try:
                answer, (address, port) = asking.recvfrom(2000)
            except TimeoutError:
                return sorted(found)
            named = socket.inet_ntoa(parse_acknowledge(answer).payload[0x24:0x28])
            assert (address, port) == (named, GVCP_PORT)
            found.append(named)


def two_cameras() -> dict[str, list[str]]:
    """What answers broadcasts where two cameras are; runs in a network of its own."""
    discovery = encode_command(CommandCode.DISCOVERY, 1)
    reading = encode_command(CommandCode.READREG, 2, encode_read_registers([0]))
    give_address(OTHER_NETWORK)
    with bench_at(ADDRESSES[0]), bench_at(ADDRESSES[1]):
        return {
            "discovery": answers_to_broadcast(discovery),
            "from elsewhere": answers_to_broadcast(discovery, OTHER_NETWORK),
            "reading": answers_to_broadcast(reading),
        }


def clients() -> dict[str, object]:
    """What clients that others wrote find; runs in a network of its own."""
    import viva_genicam

    with bench_at(ADDRESSES[1]):
        command = [sys.executable, "-c", "from standoff.cli import main; main()"]
        done = subprocess.run(
            [*command, "cameras", "--json"], capture_output=True, text=True, check=True
        )
    with bench_at(ADDRESSES[0]):
        # It asks the loopback interface by unicast, at 127.0.0.1.
        by_address = viva_genicam.discover(timeout_ms=500, iface=ADDRESSES[0])
    return {
        "standoff": json.loads(done.stdout)["cameras"],
        "viva": [info.ip for info in by_address],
    }


@pytest.mark.slow
def test_every_camera_answers_a_broadcast_of_this_computer_and_of_no_other() -> None:
    found = run_in_own_network(f"{HERE}:two_cameras")
    assert found["discovery"] == sorted(ADDRESSES)
    assert found["from elsewhere"] == []
    assert found["reading"] == []  # anything but discovery is for one camera


@pytest.mark.slow
def test_aravis_and_viva_genicam_find_the_camera() -> None:
    pytest.importorskip("gi")
    pytest.importorskip("viva_genicam")
    found = run_in_own_network(f"{HERE}:clients")
    (camera,) = found["standoff"]
    assert camera["address"] == ADDRESSES[1]
    assert (camera["vendor"], camera["serial_number"]) == ("standoff", "SIM-591879")
    assert found["viva"] == [ADDRESSES[0]]
