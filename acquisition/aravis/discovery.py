"""Find the GigE Vision cameras on the network, and report what one of them can do.

Nothing else in the driver broadcasts.
"""

from collections.abc import Callable
from dataclasses import dataclass

from acquisition.aravis.configuration import Bounds, CameraControls
from acquisition.aravis.device import open_device
from acquisition.aravis.errors import translated_errors
from acquisition.aravis.library import AravisLibrary, load_aravis

TEMPERATURE = "DeviceTemperature"
GIGE_VISION = "GigEVision"


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundCamera:
    """A camera that answered, and its address."""

    address: str
    vendor: str
    model: str
    serial_number: str
    hardware_address: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraProbe:
    """The present state of one camera; the limits are those at its present settings.

    ``temperature_c`` is None where the camera has no such feature.
    """

    vendor: str
    model: str
    ip_address: str
    is_controllable: bool
    exposure_us: Bounds
    gain_db: Bounds
    frame_rate_hz: Bounds
    pixel_formats: tuple[str, ...]
    packet_size_bytes: int
    temperature_c: float | None


def list_cameras(load: Callable[[], AravisLibrary] = load_aravis) -> tuple[FoundCamera, ...]:
    """List the cameras that answer a broadcast on any network interface; takes about a second.

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


def probe_camera(address: str) -> CameraProbe:
    """Open the camera at one address, query it and release it.

    Raises
    ------
    DeviceError
        If it cannot be opened, or does not answer.
    """
    opened = open_device(address)
    try:
        controls = CameraControls(opened)
        has_temperature = controls.features.has(TEMPERATURE)
        with translated_errors(opened.library, "its identity"):
            return CameraProbe(
                vendor=str(opened.camera.get_vendor_name()),
                model=str(opened.camera.get_model_name()),
                ip_address=opened.ip_address,
                is_controllable=opened.is_controller,
                exposure_us=controls.exposure_bounds_us(),
                gain_db=controls.gain_bounds_db(),
                frame_rate_hz=controls.frame_rate_bounds_hz(),
                pixel_formats=tuple(opened.camera.dup_available_pixel_formats_as_strings()),
                packet_size_bytes=int(opened.camera.gv_get_packet_size()),
                temperature_c=(
                    float(controls.features.read(TEMPERATURE, float)) if has_temperature else None
                ),
            )
    finally:
        opened.close()
