"""Find the cameras on the network and on USB, and report what one of them can do.

Only this broadcasts, and opening a camera by its id.
"""

from collections.abc import Callable
from dataclasses import dataclass

from acquisition.aravis.configuration import CameraControls
from acquisition.aravis.controls import StatedValue
from acquisition.aravis.device import GIGE_VISION, open_camera
from acquisition.aravis.errors import translated_errors
from acquisition.aravis.features import Bounds
from acquisition.aravis.library import AravisLibrary, load_aravis, text_of
from acquisition.aravis.pixel_decoding import can_decode
from acquisition.bench import CameraConfig

TEMPERATURE = "DeviceTemperature"


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundCamera:
    """A camera that answered: its address, empty on USB, and its id, which opens it too."""

    address: str
    vendor: str
    model: str
    serial_number: str
    hardware_address: str
    id: str = ""
    transport: str = GIGE_VISION


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraProbe:
    """The present state of one camera; the limits are those at its present settings.

    ``gain`` is its lowest and highest, as the camera states them. ``pixel_formats`` are those that
    can be decoded, ``undecoded_formats`` the others. ``temperature_c`` is None where the camera has
    no such feature, ``packet_size_bytes`` and ``resends_packets``, whether it sends lost packets
    again, where it is not on a network.
    """

    vendor: str
    model: str
    name: str
    is_controllable: bool
    exposure_us: Bounds
    gain: tuple[StatedValue, StatedValue]
    frame_rate_hz: Bounds
    pixel_formats: tuple[str, ...]
    packet_size_bytes: int | None
    temperature_c: float | None
    resends_packets: bool | None = None
    undecoded_formats: tuple[str, ...] = ()


def list_cameras(load: Callable[[], AravisLibrary] = load_aravis) -> tuple[FoundCamera, ...]:
    """List the cameras that answer on any network interface or USB port; takes about a second.

    Raises
    ------
    DriverMissingError
        If Aravis or PyGObject is not installed.
    """
    api = load().api
    api.update_device_list()
    found = [
        FoundCamera(
            address=(
                text_of(api.get_device_address, index)
                if api.get_device_protocol(index) == GIGE_VISION
                else ""
            ),
            vendor=text_of(api.get_device_vendor, index),
            model=text_of(api.get_device_model, index),
            serial_number=text_of(api.get_device_serial_nbr, index),
            hardware_address=text_of(api.get_device_physical_id, index),
            id=text_of(api.get_device_id, index),
            transport=text_of(api.get_device_protocol, index),
        )
        for index in range(api.get_n_devices())
    ]
    return tuple(sorted(found, key=lambda camera: (camera.address, camera.id)))


def probe_camera(config: CameraConfig) -> CameraProbe:
    """Open the camera of a bench file, query it and release it.

    Raises
    ------
    DeviceError
        If it cannot be opened, or does not answer.
    """
    opened = open_camera(config)
    try:
        controls = CameraControls(opened, config.frame_rate_hz)
        has_temperature = controls.features.has(TEMPERATURE)
        formats = controls.pixel_formats()
        with translated_errors(opened.library, "its identity"):
            return CameraProbe(
                vendor=text_of(opened.camera.get_vendor_name),
                model=text_of(opened.camera.get_model_name),
                name=opened.name,
                is_controllable=opened.is_controller,
                exposure_us=controls.levels.exposure_bounds_us(),
                gain=controls.levels.gain_bounds(),
                frame_rate_hz=controls.frame_rate.bounds_hz(),
                pixel_formats=tuple(name for name in formats if can_decode(name)),
                undecoded_formats=tuple(name for name in formats if not can_decode(name)),
                packet_size_bytes=(
                    int(opened.camera.gv_get_packet_size()) if opened.is_gige else None
                ),
                temperature_c=controls.features.number(TEMPERATURE) if has_temperature else None,
                resends_packets=opened.resends_packets,
            )
    finally:
        opened.close()
