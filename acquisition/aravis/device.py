"""Opening and releasing a GigE Vision device at one address."""

from acquisition.aravis.errors import translated_errors
from acquisition.aravis.library import AravisLibrary, AravisObject, load_aravis
from acquisition.aravis.route import route_to
from acquisition.bench import resolve_address
from acquisition.errors import DeviceDisconnectedError


class OpenedDevice:
    """The sole owner of the Aravis objects of a camera: closing it releases the camera.

    Everything else reaches the objects through this and keeps none in a variable of its own: the
    traceback of an error would keep thread, sockets and control alive.

    Parameters
    ----------
    library
        The Aravis modules.
    ip_address
        Address at which it was opened.
    device
        An ``Aravis.GvDevice``.
    camera
        The ``Aravis.Camera`` of that device.
    """

    def __init__(
        self,
        library: AravisLibrary,
        *,
        ip_address: str,
        device: AravisObject,
        camera: AravisObject,
    ) -> None:
        self.library = library
        self.ip_address = ip_address
        self._device = device
        self._camera = camera

    @property
    def device(self) -> AravisObject:
        """The ``Aravis.GvDevice``."""
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
        """Whether we control the camera; otherwise another program does."""
        return bool(self.device.is_controller())

    def close(self) -> None:
        """Release the camera; closing twice is harmless."""
        self._camera = None
        self._device = None


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
                ip_address=ip_address,
                device=device,
                camera=library.api.Camera.new_with_device(device),
            )
        finally:
            del device  # see `OpenedDevice`
