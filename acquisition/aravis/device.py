"""Opening and releasing a camera: a GigE Vision device at an address, or any camera by its id."""

from acquisition.aravis.errors import translated_errors
from acquisition.aravis.library import AravisLibrary, AravisObject, load_aravis
from acquisition.aravis.route import route_to
from acquisition.bench import CameraConfig, resolve_address
from acquisition.errors import DeviceDisconnectedError, DeviceError


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
        device: AravisObject,
        camera: AravisObject,
    ) -> None:
        self.library = library
        self.name = name
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
    DeviceError
        If the address is not valid.
    """
    library = load_aravis()
    ip_address = resolve_address(address)
    route = route_to(ip_address)
    with translated_errors(library, f"opening it at {ip_address}"):
        # Camera.new(id) searches on every interface, by broadcast, for an id it does not find;
        # a device made of two addresses is spoken to directly.
        device = library.api.GvDevice.new(
            library.gio.InetAddress.new_from_string(route.own_address),
            library.gio.InetAddress.new_from_string(ip_address),
        )
        try:
            return OpenedDevice(
                library,
                name=ip_address,
                device=device,
                camera=library.api.Camera.new_with_device(device),
            )
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
    """
    library = load_aravis()
    library.api.update_device_list()
    ids = [str(library.api.get_device_id(i)) for i in range(library.api.get_n_devices())]
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
            return OpenedDevice(
                library,
                name=name,
                device=device,
                camera=library.api.Camera.new_with_device(device),
            )
        finally:
            del device  # see `OpenedDevice`
