"""Descriptions fetched from a camera, and unpacked."""

import io
import socket
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread

import pytest
from hypothesis import given, strategies as st

from acquisition.aravis import _network as network
from acquisition.aravis._description import LARGEST_BYTES, DescriptionError
from acquisition.aravis._network import (
    ACCESS_DENIED,
    BLOCK_BYTES,
    BUSY,
    MEMORY,
    PENDING,
    _CameraMemory,
    _encode_read,
    _parse_reply,
    _parse_url,
    _Place,
    _unpack,
    read_description,
)
from acquisition.errors import (
    CameraDescriptionError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceProtocolError,
)
from hil_mocks.gige._settings import GigeFaults
from hil_mocks.gige._wire import GVCP_PORT, parse_command, parse_read_memory
from hil_mocks.practice_bench import PracticeBench
from tests.acquisition.aravis.description_texts import simulated, with_nodes
from tests.hil_mocks.gige_bench import free_addresses, gige_bench

OWN_ADDRESS = "127.0.0.1"


@pytest.fixture
def bench() -> Iterator[PracticeBench]:
    with gige_bench() as opened_bench:
        yield opened_bench


def read(bench: PracticeBench) -> bytes:
    return read_description(bench.camera.address, OWN_ADDRESS)


@pytest.mark.parametrize(
    ("url", "place"),
    [
        ("Local:a.xml;20000;12f", _Place(name="a.xml", address=0x20000, length=0x12F)),
        ("LOCAL: a.zip ;0x8001000; 0x395C?SchemaVersion=1.1.0", None),
        ("local:///a b.zip;8001000;395C#end", None),
        ("http://www.maker.com/a.xml", None),
        ("file:///opt/maker/a.xml", Path("/opt/maker/a.xml")),
    ],
)
def test_urls_of_cameras_are_understood(url: str, place: _Place | Path | None) -> None:
    found = _parse_url(url)
    if place is None and "http" not in url:
        assert isinstance(found, _Place)
        assert (found.address, found.length) == (0x8001000, 0x395C)
    else:
        assert found == place


@pytest.mark.parametrize(
    "url",
    [
        "",
        "a.xml;20000;100",
        "Local:a.xml",
        "Local:a.xml;20000;",
        "Local:a.xml;20000;-1",
        "https://example.org/a.xml",
        "ftp://example.org/a.xml",
        "smb://host/a.xml",
        "\x1b[31m",
    ],
)
def test_urls_that_lead_elsewhere_are_refused(url: str) -> None:
    with pytest.raises(DescriptionError) as refused:
        _parse_url(url)
    assert refused.value.fault == "nowhere"


def test_a_description_of_a_size_that_no_memory_has_is_refused_unread() -> None:
    for size in (LARGEST_BYTES + 1, 0x7FFF_FFFF_FFFF_FFFF):
        with pytest.raises(DescriptionError) as refused:
            _parse_url(f"Local:a.xml;20000;{size:x}")
        assert refused.value.fault == "too large"
    with pytest.raises(DescriptionError):
        _parse_url("Local:a.xml;ffffff00;1000")


@pytest.mark.slow
@given(st.text(max_size=60))
def test_any_url_is_understood_or_refused(url: str) -> None:
    for text in (url, f"Local:{url}", f"Local:a;{url}"):
        try:
            _parse_url(text)
        except DescriptionError:
            continue


def test_the_description_of_the_simulated_camera_is_read_whole_and_without_control(
    bench: PracticeBench,
) -> None:
    bench.camera.serve_description(simulated())
    assert read(bench) == simulated()
    assert bench.camera.controller is None


def test_a_packed_description_is_unpacked(bench: PracticeBench) -> None:
    archive = packed(simulated())
    bench.camera.serve_description(archive, f"Local:a.ZIP;20000;{len(archive):x}")
    assert read(bench) == simulated()
    bench.camera.serve_description(archive[:-40], f"Local:a.zip;20000;{len(archive) - 40:x}")
    with pytest.raises(CameraDescriptionError) as refused:
        read(bench)
    assert refused.value.fault == "packed"


def test_a_description_that_the_maker_installed_here_is_read_if_it_is_a_file(
    bench: PracticeBench, tmp_path: Path
) -> None:
    (tmp_path / "a.xml").write_bytes(simulated())
    bench.camera.serve_description(b"", f"file://{tmp_path}/a.xml")
    assert read(bench) == simulated()
    for other in ("/dev/zero", f"{tmp_path}/none.xml", str(tmp_path)):
        bench.camera.serve_description(b"", f"file://{other}")
        with pytest.raises(CameraDescriptionError) as refused:
            read(bench)
        assert refused.value.fault == "nowhere"


@pytest.mark.parametrize("url", ["http://www.maker.com/a.xml", "Local:a.xml;20000;0"])
def test_a_camera_whose_registers_name_no_place_is_refused(bench: PracticeBench, url: str) -> None:
    bench.camera.serve_description(b"", url)  # the second register is empty
    with pytest.raises(CameraDescriptionError) as refused:
        read(bench)
    assert refused.value.fault == "nowhere"
    assert bench.camera.address in str(refused.value)


def test_memory_that_the_camera_does_not_have_is_an_error_with_its_status(
    bench: PracticeBench,
) -> None:
    bench.camera.serve_description(b"", "Local:a.xml;70000000;100")
    with pytest.raises(DeviceProtocolError, match="0x8003 at 0x70000000"):
        read(bench)


def test_a_camera_that_is_off_is_known_after_the_tries_of_aravis(
    bench: PracticeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network, "REPLY_S", 0.01)
    bench.camera.faults = GigeFaults(is_dead=True)
    with pytest.raises(DeviceDisconnectedError):
        read(bench)


@contextmanager
def answering(*answers: bytes | None) -> Iterator[str]:
    """A camera that answers its first requests so, each with the id of the request filled in."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        for address in free_addresses():
            try:
                port.bind((address, GVCP_PORT))
            except OSError:
                continue
            break

        def answer() -> None:
            for reply in answers:
                datagram, peer = port.recvfrom(1024)
                request_id = struct.pack(">H", parse_command(datagram).request_id)
                for part in (reply or b"").split(b"SPLIT"):
                    if part:
                        port.sendto(part.replace(b"ID", request_id), peer)

        thread = Thread(target=answer, daemon=True)
        thread.start()
        yield address
        thread.join(5)


def reply(code: int, payload: bytes, status: int = 0) -> bytes:
    return struct.pack(">HHH", status, code, len(payload)) + b"ID" + payload


DATA = reply(MEMORY, struct.pack(">I", 0) + b"data")


@pytest.mark.parametrize(
    "answers",
    [
        (DATA,),
        (None, DATA),
        (reply(MEMORY, b"", BUSY), DATA),
        (b"SPLIT".join([b"no datagram of ours", DATA.replace(b"ID", b"\xff\xff"), DATA]),),
        (b"SPLIT".join([reply(PENDING, struct.pack(">HH", 0, 300)), DATA]),),
    ],
    ids=["at once", "again", "busy", "others' before", "pending"],
)
def test_memory_is_read_over_what_a_network_does(
    answers: tuple[bytes | None, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network, "REPLY_S", 0.1)
    with answering(*answers) as address, _CameraMemory(address, OWN_ADDRESS) as memory:
        assert memory.read(0, 4) == b"data"


def test_who_may_not_read_is_told_that_another_program_has_the_camera() -> None:
    with (
        answering(reply(MEMORY, b"", ACCESS_DENIED)) as address,
        _CameraMemory(address, OWN_ADDRESS) as memory,
        pytest.raises(DeviceInUseError),
    ):
        memory.read(0, 4)


@pytest.mark.parametrize(
    "payload", [b"", b"\0\0\0\0dat", b"\0\0\0\1data", b"\0\0\0\0data and more"]
)
def test_an_answer_of_another_length_or_place_is_refused(payload: bytes) -> None:
    with (
        answering(reply(MEMORY, payload)) as address,
        _CameraMemory(address, OWN_ADDRESS) as memory,
        pytest.raises(DeviceProtocolError),
    ):
        memory.read(0, 4)


def test_a_camera_that_asks_for_time_without_end_gets_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(network, "PENDING_MOST_S", 0.05)
    monkeypatch.setattr(network, "TRIES", 1)
    forever = b"SPLIT".join([reply(PENDING, struct.pack(">HH", 0, 65535))] * 3)
    with (
        answering(forever) as address,
        _CameraMemory(address, OWN_ADDRESS) as memory,
        pytest.raises(DeviceDisconnectedError),
    ):
        memory.read(0, 4)


def test_a_camera_that_takes_for_ever_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "READ_MOST_S", -1.0)
    with (
        _CameraMemory("127.0.0.2", OWN_ADDRESS) as memory,
        pytest.raises(DeviceDisconnectedError, match="not done within"),
    ):
        memory.read(0, BLOCK_BYTES)


def test_no_way_to_the_camera_is_an_error_of_the_connection() -> None:
    with pytest.raises(DeviceDisconnectedError), _CameraMemory("127.0.0.2", "192.0.2.1"):
        pass


@given(st.binary(max_size=40))
def test_any_datagram_is_a_reply_or_none(datagram: bytes) -> None:
    found = _parse_reply(datagram)
    assert found is None or datagram[8:].startswith(found.payload)


@given(st.integers(0, 2**30), st.integers(1, 130), st.integers(1, 2**16 - 1))
def test_a_request_is_what_the_simulated_camera_understands(
    address: int, words: int, request_id: int
) -> None:
    command = parse_command(_encode_read(4 * address % 2**32, 4 * words, request_id))
    asked = parse_read_memory(command.payload)
    assert (asked.address, asked.length) == (4 * address % 2**32, 4 * words)
    assert command.request_id == request_id
    assert command.wants_acknowledge


def test_only_errors_of_devices_come_out_of_any_served_bytes(bench: PracticeBench) -> None:
    for data in (b"", b"PK", bytes(1000), with_nodes()[:100]):
        bench.camera.serve_description(data, f"Local:a.zip;20000;{len(data):x}")
        with pytest.raises(DeviceError):
            read(bench)


TEXT = b"<RegisterDescription/>" * 40


def packed(*files: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", method) as file:
        for place, data in enumerate(files):
            file.writestr(f"{place}.xml", data)
    return archive.getvalue()


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED])
def test_what_was_packed_comes_out(method: int) -> None:
    assert _unpack(packed(TEXT, method=method)) == TEXT
    assert _unpack(b"before the archive" + packed(TEXT, method=method) + b"\0" * 100) == TEXT


def test_of_several_files_it_is_the_last_which_aravis_takes() -> None:
    assert _unpack(packed(b"one", TEXT)) == TEXT


def test_a_file_that_unpacks_to_more_than_any_description_is_refused_by_what_it_says() -> None:
    bomb = packed(bytes(LARGEST_BYTES + 1))
    assert len(bomb) < 20_000
    with pytest.raises(DescriptionError) as refused:
        _unpack(bomb)
    assert refused.value.fault == "too large"


def test_a_file_that_unpacks_to_more_than_it_says_is_refused() -> None:
    archive = bytearray(packed(TEXT))
    entry = archive.index(b"PK\x01\x02")
    struct.pack_into("<I", archive, entry + 24, len(TEXT) - 1)
    with pytest.raises(DescriptionError) as refused:
        _unpack(bytes(archive))
    assert refused.value.fault == "packed"


@pytest.mark.parametrize("place", [10, 12, 16])
def test_places_outside_the_archive_are_refused(place: int) -> None:
    archive = bytearray(packed(TEXT))
    end = archive.index(b"PK\x05\x06")
    struct.pack_into("<I", archive, end + place, 0x7FFFFFFF)
    with pytest.raises(DescriptionError):
        _unpack(bytes(archive))


@given(st.data())
def test_a_damaged_archive_is_unpacked_or_refused(data: st.DataObject) -> None:
    archive = bytearray(packed(TEXT))
    for _ in range(data.draw(st.integers(1, 4))):
        archive[data.draw(st.integers(0, len(archive) - 1))] = data.draw(st.integers(0, 255))
    with suppress(DescriptionError):
        _unpack(bytes(archive[: data.draw(st.integers(0, len(archive)))]))
    with suppress(DescriptionError):
        _unpack(bytes(archive))
