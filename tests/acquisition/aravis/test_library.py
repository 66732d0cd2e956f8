import builtins
import subprocess
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from acquisition.aravis._camera import FoundCamera, list_cameras
from acquisition.aravis._device import AravisLibrary, load_aravis
from acquisition.errors import DriverMissingError
from tests.acquisition.aravis_bench import needs_aravis


def without(monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    """Let one import fail, as if its package were not installed."""
    real = builtins.__import__

    def importing(name: str, *arguments: Any, **keys: Any) -> ModuleType:
        if name == missing:
            raise ImportError(f"No module named {missing!r}")
        return real(name, *arguments, **keys)

    monkeypatch.setattr(builtins, "__import__", importing)


@needs_aravis
def test_the_versions_are_told() -> None:
    library = load_aravis()
    assert library.aravis_version.startswith("0.8")
    assert library.pygobject_version[0].isdigit()


def test_a_missing_pygobject_is_an_error_that_names_the_packages(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    without(monkeypatch, "gi")
    with pytest.raises(DriverMissingError) as caught:
        load_aravis.__wrapped__()
    assert "standoff[aravis]" in str(caught.value)
    assert "gir1.2-aravis-0.8" in str(caught.value)


def test_a_missing_aravis_is_an_error_that_names_the_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def require_version(name: str, version: str) -> None:
        raise ValueError(f"Namespace {name} not available for version {version}")

    monkeypatch.setitem(sys.modules, "gi", SimpleNamespace(require_version=require_version))
    with pytest.raises(DriverMissingError) as refused:
        load_aravis.__wrapped__()
    assert "apt install gir1.2-aravis-0.8" in str(refused.value)


@pytest.mark.slow
def test_importing_the_driver_does_not_import_gi() -> None:
    code = "import acquisition.aravis._camera, standoff.cli, sys; sys.exit('gi' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_found_cameras_are_listed_by_address_and_those_on_usb_by_the_id_that_opens_them() -> None:
    devices = [
        ("10.0.0.9", "Allied Vision", "Manta G-046B", "S2", "00:0f:31:00:00:02", "GigEVision"),
        ("bus 3", "Other", "Stick", "S3", "", "USB3Vision"),
        ("10.0.0.7", "Allied Vision", "Manta G-046C", "S1", "00:0f:31:00:00:01", "GigEVision"),
    ]
    searched: list[str] = []

    def column(place: int) -> Any:
        return lambda index: devices[index][place]

    api = SimpleNamespace(
        update_device_list=lambda: searched.append("broadcast"),
        get_n_devices=lambda: len(devices),
        get_device_address=column(0),
        get_device_vendor=column(1),
        get_device_model=column(2),
        get_device_serial_nbr=column(3),
        get_device_physical_id=column(4),
        get_device_protocol=column(5),
        get_device_id=lambda index: f"{devices[index][1]}-{devices[index][3]}",
    )
    library = AravisLibrary(
        api=api, gio=None, glib=None, aravis_version="0.8", pygobject_version="3.50"
    )
    found = list_cameras(lambda: library)
    assert searched == ["broadcast"]
    assert [camera.address for camera in found] == ["", "10.0.0.7", "10.0.0.9"]
    assert (found[0].id, found[0].transport) == ("Other-S3", "USB3Vision")
    assert found[1] == FoundCamera(
        address="10.0.0.7",
        vendor="Allied Vision",
        model="Manta G-046C",
        serial_number="S1",
        hardware_address="00:0f:31:00:00:01",
        id="Allied Vision-S1",
    )
