"""Opening and releasing a camera: a GigE Vision device at an address, or any camera by its id."""

from acquisition.aravis.description import (
    LONGEST_REGISTER_BYTES,
    SoundDescription,
    read_description,
    require_sound_description,
)
from acquisition.aravis.errors import translated_errors
from acquisition.aravis.library import (
    AravisLibrary,
    AravisObject,
    description_of,
    load_aravis,
    text_of,
)
from acquisition.aravis.route import route_to
from acquisition.bench import CameraConfig, resolve_address
from acquisition.errors import (
    CameraDescriptionError,
    DeviceDisconnectedError,
    DeviceError,
)

GIGE_VISION = "GigEVision"
CAPABILITY_REGISTER, PACKET_RESEND = 0x0934, 1 << 2
"""GVCP capabilities (GigE Vision 2.0, section "Bootstrap registers")."""
IDENTITY = ("DeviceVendorName", "DeviceModelName")
"""What Aravis reads itself as soon as it is given a device."""


class OpenedDevice:
    """The sole owner of the Aravis objects of a camera: closing it releases the camera.

    Everything else reaches the objects through this and keeps none in a variable of its own: the
    traceback of an error would keep thread, sockets and control alive.

    Parameters
    ----------
    library
        The Aravis modules.
    name
        Its IP address, or the id of a camera that is not on the network.
    description
        What it says of itself, checked.
    device
        An ``Aravis.Device``.
    camera
        The ``Aravis.Camera`` of that device.
    """

    def __init__(
        self,
        library: AravisLibrary,
        *,
        name: str,
        description: SoundDescription,
        device: AravisObject,
        camera: AravisObject,
    ) -> None:
        self.library = library
        self.name = name
        self.description = description
        self.is_gige = bool(camera.is_gv_device())
        self._device = device
        self._camera = camera

    @property
    def device(self) -> AravisObject:
        """The ``Aravis.Device``."""
        if self._device is None:
            raise DeviceDisconnectedError("the connection to the camera is closed")
        return self._device

    @property
    def camera(self) -> AravisObject:
        """The ``Aravis.Camera``."""
        if self._camera is None:
            raise DeviceDisconnectedError("the connection to the camera is closed")
        return self._camera

    @property
    def is_controller(self) -> bool:
        """Whether we control the camera; otherwise another program does.

        Only GigE Vision tells: whoever has opened another camera has it alone.
        """
        return bool(self.device.is_controller()) if self.is_gige else True

    @property
    def resends_packets(self) -> bool | None:
        """Whether the camera says that it sends lost packets again; None if it is on no network."""
        if not self.is_gige:
            return None
        return bool(self.device.read_register(CAPABILITY_REGISTER) & PACKET_RESEND)

    def close(self) -> None:
        """Release the camera; closing twice is harmless."""
        self._camera = None
        self._device = None


def open_camera(config: CameraConfig) -> OpenedDevice:
    """Open the camera that a bench file names.

    Raises
    ------
    DeviceError
        As for `open_device` and `open_by_id`.
    """
    if config.address is not None:
        return open_device(config.address)
    if config.id is not None:
        return open_by_id(config.id)
    raise DeviceError("camera.address is missing; driver 'aravis' needs it, or camera.id")


def open_device(address: str) -> OpenedDevice:
    """Open the camera at one address; nothing is sent to any other address.

    Raises
    ------
    DriverMissingError
        If Aravis or PyGObject is not installed.
    DeviceDisconnectedError
        If no camera answers there, or no network interface leads there.
    CameraDescriptionError
        If the camera's description of itself would take Aravis down.
    DeviceError
        If the address is not valid.
    """
    library = load_aravis()
    ip_address = resolve_address(address)
    route = route_to(ip_address)
    _require_sound_description_at(ip_address)
    with translated_errors(library, f"opening it at {ip_address}"):
        # Camera.new(id) searches on every interface, by broadcast, for an id it does not find;
        # a device made of two addresses is spoken to directly.
        device = library.api.GvDevice.new(
            library.gio.InetAddress.new_from_string(route.own_address),
            library.gio.InetAddress.new_from_string(ip_address),
        )
        try:
            return _opened(library, ip_address, device)
        finally:
            del device  # see `OpenedDevice`


def open_by_id(camera_id: str) -> OpenedDevice:
    """Open any camera that Aravis finds; this BROADCASTS on every network interface.

    Raises
    ------
    DriverMissingError
        If Aravis or PyGObject is not installed.
    DeviceDisconnectedError
        If there is no such camera, or it does not answer.
    CameraDescriptionError
        As for `open_device`.
    """
    library = load_aravis()
    library.api.update_device_list()
    ids = [text_of(library.api.get_device_id, i) for i in range(library.api.get_n_devices())]
    for address in _addresses_of(library, camera_id):
        _require_sound_description_at(address)
    device = None
    # Every name that Aravis knows a camera by: with a serial number, an address, a user's name.
    with translated_errors(library, f"opening {camera_id!r}"):
        try:
            device = library.api.open_device(camera_id)
        except library.glib.Error as error:
            if not ids:
                raise
            raise DeviceDisconnectedError(
                f"camera.id {camera_id!r} is none of the cameras found: {', '.join(sorted(ids))}"
                f" ({error.message})"
            ) from error
        if device is None:
            raise DeviceDisconnectedError(f"camera.id {camera_id!r}: no such camera was found")
        name = camera_id
        if isinstance(device, library.api.GvDevice):
            name = str(device.get_device_address().get_address().to_string())
        try:
            return _opened(library, name, device)
        finally:
            del device  # see `OpenedDevice`


def require_bounded(opened: OpenedDevice, feature: str) -> None:
    """Refuse a feature in a register that is longer than any.

    Aravis takes as much memory as the camera says that a register is long.

    Raises
    ------
    CameraDescriptionError
        If the camera says so.
    """
    _require_bounded(_open_lengths(opened.description, opened.device, feature), feature)


def _opened(library: AravisLibrary, name: str, device: AravisObject) -> OpenedDevice:
    """Let Aravis evaluate the description that it has itself, once that is found sound."""
    try:
        description = require_sound_description(description_of(device), f"the camera at {name}")
        for feature in IDENTITY:
            _require_bounded(_open_lengths(description, device, feature), feature)
        return OpenedDevice(
            library,
            name=name,
            description=description,
            device=device,
            camera=library.api.Camera.new_with_device(device),
        )
    finally:
        del device  # see `OpenedDevice`


def _open_lengths(
    description: SoundDescription, device: AravisObject, feature: str
) -> dict[str, int]:
    """The present lengths of the registers of a feature whose length the camera tells."""
    try:
        return {
            node: int(device.get_feature(node).get_length())
            for node in description.nodes_of(feature)
            if node in description.of_open_length
        }
    finally:
        del device  # see `OpenedDevice`


def _require_bounded(lengths: dict[str, int], feature: str) -> None:
    for node, length in lengths.items():
        if not 0 < length <= LONGEST_REGISTER_BYTES:
            raise CameraDescriptionError(
                f"the camera says that {feature} is {length} bytes long; restart the camera, or "
                "install its maker's firmware anew",
                fault="register",
                nodes=(feature, node),
            )


def _require_sound_description_at(address: str) -> None:
    """Refuse a description before Aravis has it, which trusts whatever it is told to take."""
    data = read_description(address, route_to(address).own_address)
    require_sound_description(data, f"the camera at {address}")


def _addresses_of(library: AravisLibrary, camera_id: str) -> tuple[str, ...]:
    """Addresses of the cameras found on a network that go by this name."""
    api = library.api
    addresses: dict[str, None] = {}
    for index in range(api.get_n_devices()):
        if api.get_device_protocol(index) != GIGE_VISION:
            continue
        vendor, serial_number = (
            text_of(read, index) for read in (api.get_device_vendor, api.get_device_serial_nbr)
        )
        names = {
            f"{vendor}-{serial_number}",
            *(
                text_of(read, index)
                for read in (
                    api.get_device_id,
                    api.get_device_physical_id,
                    api.get_device_address,
                )
            ),
        }
        if camera_id in names:
            addresses[text_of(api.get_device_address, index)] = None
    return tuple(addresses)
