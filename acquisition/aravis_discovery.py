"""Search for GigE Vision cameras: the one place that broadcasts."""

from collections.abc import Callable
from dataclasses import dataclass

from acquisition.aravis_library import AravisLibrary, load_aravis

__all__ = ["FoundCamera", "list_cameras"]

GIGE_VISION = "GigEVision"


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundCamera:
    """A camera that answered, and where."""

    address: str
    vendor: str
    model: str
    serial_number: str
    hardware_address: str


def list_cameras(load: Callable[[], AravisLibrary] = load_aravis) -> tuple[FoundCamera, ...]:
    """Ask every network interface, by broadcast, who is there; takes about a second.

    Raises
    ------
    DriverMissingError
        If Aravis or PyGObject is not installed.
    """
    api = load().api
    api.update_device_list()
    found = [
        FoundCamera(
            address=str(api.get_device_address(index)),
            vendor=str(api.get_device_vendor(index)),
            model=str(api.get_device_model(index)),
            serial_number=str(api.get_device_serial_nbr(index)),
            hardware_address=str(api.get_device_physical_id(index)),
        )
        for index in range(api.get_n_devices())
        if api.get_device_protocol(index) == GIGE_VISION
    ]
    return tuple(sorted(found, key=lambda camera: camera.address))
