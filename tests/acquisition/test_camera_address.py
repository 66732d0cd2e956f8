from pathlib import Path

import pytest

from acquisition.aravis._network import receive_buffer_limit_bytes, route_to
from acquisition.bench import BenchConfig, _address_fault, resolve_address
from acquisition.errors import DeviceDisconnectedError, DeviceError
from tests.acquisition.session_fixtures import bench_of


@pytest.mark.parametrize("text", ["192.168.10.46", "127.3.4.5", "camera", "cam-1.lab.example"])
def test_addresses_and_host_names_can_name_a_camera(text: str) -> None:
    assert _address_fault(text) is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "Allied Vision-02-2142",
        "1.2.3",
        "300.1.1.1",
        "-cam",
        "eth0:1",
        "::1",
        "255.255.255.255",
        "224.0.0.1",
        "0.0.0.0",
        "b" * 64,
        "bench." + "b" * 64,
    ],
)
def test_what_is_no_address_of_one_camera_is_refused_by_the_bench_and_the_driver(
    text: str,
) -> None:
    assert _address_fault(text) is not None
    with pytest.raises(DeviceError):
        resolve_address(text)
    with pytest.raises(ValueError):
        bench_of(driver="aravis", address=text)


def test_aravis_needs_an_address() -> None:
    with pytest.raises(ValueError):
        bench_of(driver="aravis")


def test_a_region_has_a_size() -> None:
    with pytest.raises(ValueError):
        bench_of(region_px=[0, 0, 0, 10])
    assert isinstance(bench_of(region_px=[0, 0, 8, 8]), BenchConfig)


def test_a_host_name_is_resolved_here() -> None:
    assert resolve_address("localhost") == "127.0.0.1"


def test_a_label_of_63_characters_is_a_host_name() -> None:
    for name in ("b" * 63, "bench." + "b" * 63, "b", "bench-2.lab"):
        assert _address_fault(name) is None


def test_an_unknown_host_name_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> list[object]:
        raise OSError(-2, "Name or service not known")

    monkeypatch.setattr("socket.getaddrinfo", unknown)
    with pytest.raises(DeviceError):
        resolve_address("camera-7")


def test_a_host_name_that_stands_for_everyone_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [(2, 2, 17, "", ("255.255.255.255", 0))]
    monkeypatch.setattr("socket.getaddrinfo", lambda *_: found)
    with pytest.raises(DeviceError):
        resolve_address("everyone")


def test_the_way_to_the_loopback_network_is_known() -> None:
    route = route_to("127.9.9.9")
    assert (route.own_address, route.interface) == ("127.0.0.1", "lo")
    assert route.mtu_bytes >= 16384


def test_an_address_that_no_interface_leads_to_counts_as_disconnected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Unrouted:
        """A socket of a computer whose cable is out."""

        def __init__(self, *_: object) -> None: ...
        def __enter__(self) -> "Unrouted":
            return self

        def __exit__(self, *_: object) -> None: ...
        def connect(self, _: object) -> None:
            raise OSError(101, "Network is unreachable")

    monkeypatch.setattr("socket.socket", Unrouted)
    with pytest.raises(DeviceDisconnectedError):
        route_to("192.0.2.7")


def test_the_receive_buffer_limit_is_read_or_unknown(tmp_path: Path) -> None:
    path = tmp_path / "rmem_max"
    assert receive_buffer_limit_bytes(path) is None
    path.write_text("212992\n")
    assert receive_buffer_limit_bytes(path) == 212992
