"""Cameras by their id: Aravis' own fake device, which is on no network, and those of a network.

Aravis' fake device shares no code with ours and speaks neither GigE nor USB3 Vision, so that
nothing of either is needed of a camera. The search on a network is made where there is none but
this computer's own.
"""

import ipaddress
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from acquisition.aravis._camera import AravisCamera, list_cameras, probe_camera
from acquisition.aravis._device import load_aravis
from acquisition.averaging import average_frames
from acquisition.bench import CameraConfig
from acquisition.errors import (
    CameraDescriptionError,
    CameraFeatureError,
    DeviceDisconnectedError,
)
from tests.acquisition.aravis.description_texts import with_width
from tests.acquisition.aravis_bench import needs_aravis
from tests.hil_mocks.gige_bench import gige_bench
from tests.hil_mocks.own_network import run_in_own_network

pytestmark = needs_aravis

NETWORKS = ("GigEVision", "USB3Vision")


@pytest.fixture
def _only_the_fake_device() -> Iterator[None]:
    """Aravis finds its fake device alone, and sends nothing to find it."""
    api = load_aravis().api
    for name in NETWORKS:
        api.disable_interface(name)
    api.enable_interface("Fake")
    yield
    api.disable_interface("Fake")
    for name in NETWORKS:
        api.enable_interface(name)


def config(camera_id: str, **keys: object) -> CameraConfig:
    return CameraConfig.model_validate(
        {
            "driver": "aravis",
            "id": camera_id,
            "pixel_format": "Mono8",
            "exposure_us": 4000.0,
            "gain_db": 0.0,
            "frame_rate_hz": 50.0,
            "region_px": (0, 0, 128, 64),
            **keys,
        }
    )


@pytest.mark.slow
@pytest.mark.usefixtures("_only_the_fake_device")
def test_a_camera_that_is_on_no_network_is_opened_by_its_id_and_captures() -> None:
    with closing(AravisCamera.open(config("Fake_1"))) as camera:
        assert camera.info.vendor == "Aravis"
        assert camera.set_exposure_us(2000.0) == 2000.0
        averaged = average_frames(camera, 3)
        assert averaged.mean_dn.shape == (64, 128)
        assert np.ptp(averaged.mean_dn) > 0
        assert camera.statistics().complete_frames >= 4


@pytest.mark.usefixtures("_only_the_fake_device")
def test_the_limits_of_a_camera_on_no_network_have_no_packet_size() -> None:
    probe = probe_camera(config("Fake_1"))
    assert probe.name == "Fake_1"
    assert probe.packet_size_bytes is None
    assert [(camera.id, camera.address) for camera in list_cameras()] == [("Fake_1", "")]


@pytest.mark.usefixtures("_only_the_fake_device")
def test_an_id_that_no_camera_has_is_refused_with_those_found() -> None:
    with pytest.raises(DeviceDisconnectedError, match="Fake_1"):
        AravisCamera.open(config("Nobody"))


@pytest.mark.usefixtures("_only_the_fake_device")
def test_what_a_camera_by_id_lacks_is_named() -> None:
    with pytest.raises(CameraFeatureError) as refused:
        AravisCamera.open(config("Fake_1", bandwidth_limit_bytes_per_s=1_000_000))
    assert refused.value.feature == "StreamBytesPerSecond"


def test_a_camera_is_named_by_its_address_or_its_id_but_not_by_both() -> None:
    for keys in ({"id": None}, {"address": "192.168.1.2"}):
        with pytest.raises(ValueError, match=r"camera\.id"):
            config("Fake_1", **keys)


def capture_by_id() -> dict[str, object]:
    """Captures from the camera that a broadcast finds."""
    with gige_bench() as bench:
        bench.place("flat")
        (found,) = list_cameras()
        with closing(AravisCamera.open(config(found.id, region_px=None))) as camera:
            averaged = average_frames(camera, 3)
    return {
        "address": [found.address, bench.camera.address],
        "serial_number": camera.info.serial_number,
        "frames": averaged.frames_used,
        "mean_dn": float(averaged.mean_dn.mean()),
    }


def list_with_odd_names() -> list[str]:
    """The cameras found, of which one has a name that is no text."""
    with gige_bench() as bench:
        registers = bench.camera._registers
        page = bytearray(registers._bootstrap)
        page[0x48:0x68] = b"\xff\xfem\xfcller".ljust(32, b"\0")
        registers._bootstrap = bytes(page)
        return [camera.vendor for camera in list_cameras()]


def capture_circular_by_id() -> str:
    """What comes of a camera by its id whose description refers to itself."""
    with gige_bench() as bench:
        bench.camera.serve_description(with_width("<pValue>Width</pValue>"))
        (found,) = list_cameras()
        try:
            AravisCamera.open(config(found.id, region_px=None)).close()
        except CameraDescriptionError as error:
            return error.fault
    return ""


def seen_on_the_network() -> dict[str, object]:
    """All of these, one after the other; runs in a network of its own."""
    return {
        "captured": capture_by_id(),
        "vendors": list_with_odd_names(),
        "fault": capture_circular_by_id(),
    }


@pytest.fixture(scope="module")
def on_the_network() -> Any:
    return run_in_own_network(f"{__name__}:seen_on_the_network")


@pytest.mark.slow
def test_a_camera_of_the_network_is_opened_by_the_id_that_it_is_listed_with(
    on_the_network: dict[str, Any],
) -> None:
    captured = on_the_network["captured"]
    address, own_address = captured["address"]
    assert address == own_address
    number = int(ipaddress.IPv4Address(address)) % 2**24
    assert (captured["serial_number"], captured["frames"]) == (f"SIM-{number}", 3)
    # White paper: 12,000 of 30,000 electrons in 8 ms are some 50 DN of Mono8 in 4 ms.
    assert captured["mean_dn"] > 30


@pytest.mark.slow
def test_a_camera_whose_name_is_no_text_is_listed_like_any_other(
    on_the_network: dict[str, Any],
) -> None:
    (vendor,) = on_the_network["vendors"]
    assert vendor.endswith("m\N{REPLACEMENT CHARACTER}ller")


@pytest.mark.slow
def test_the_description_of_a_camera_by_id_is_checked_as_well(
    on_the_network: dict[str, Any],
) -> None:
    assert on_the_network["fault"] == "circle"
