"""Opening and releasing a camera: a GigE Vision device at an address, or any camera by its id."""

import ctypes
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from acquisition.aravis._description import (
    LONGEST_REGISTER_BYTES,
    SoundDescription,
    require_sound_description,
)
from acquisition.aravis._network import read_description, route_to
from acquisition.bench import CameraConfig, resolve_address
from acquisition.errors import (
    CameraDescriptionError,
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceProtocolError,
    DriverMissingError,
    MissingFeatureError,
)

AravisObject = Any
"""An object of the GObject bindings, which have no type annotations."""


_LIBRARY_NAME = "libaravis-0.8.so.0"
_LIBRARY_FILE = re.compile(r"/libaravis-0\.8\.so\.(\d+(?:\.\d+)+)$", re.MULTILINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class AravisLibrary:
    """The modules of the GObject bindings and their versions."""

    api: AravisObject
    gio: AravisObject
    glib: AravisObject
    aravis_version: str
    pygobject_version: str


@cache
def load_aravis() -> AravisLibrary:
    """Import Aravis 0.8 through PyGObject."""
    try:
        import gi
    except ImportError as error:
        raise DriverMissingError(
            "camera.driver 'aravis' needs PyGObject; install standoff[aravis] "
            f"and the system package gir1.2-aravis-0.8 ({error})"
        ) from error
    try:
        # 0.10 exists and breaks the API.
        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis, Gio, GLib
    except (ImportError, ValueError) as error:
        raise DriverMissingError(
            "camera.driver 'aravis' needs the system package gir1.2-aravis-0.8 "
            f"(apt install gir1.2-aravis-0.8) ({error})"
        ) from error
    Aravis.device_error_quark()  # the library itself is loaded by the first call
    return AravisLibrary(
        api=Aravis,
        gio=Gio,
        glib=GLib,
        aravis_version=_loaded_version(Path("/proc/self/maps")),
        pygobject_version=".".join(str(part) for part in gi.version_info),
    )


def text_of(read: Callable[..., object], *arguments: object) -> str:
    """The text that a function of Aravis returns; what is no UTF-8 shows as question marks."""
    try:
        return str(read(*arguments))
    except UnicodeDecodeError as error:
        return error.object.decode("utf-8", "replace")


def _description_of(device: AravisObject) -> bytes:
    """The description that an ``Aravis.Device`` has of its camera.

    Called directly: the bindings (PyGObject 3.50, Aravis 0.8.26) read on behind its end.
    """
    read = ctypes.CDLL(_LIBRARY_NAME).arv_device_get_genicam_xml
    read.restype = ctypes.c_void_p
    pointer_of = ctypes.pythonapi.PyCapsule_GetPointer
    pointer_of.restype, pointer_of.argtypes = ctypes.c_void_p, (ctypes.py_object, ctypes.c_void_p)
    size = ctypes.c_size_t()
    start = read(ctypes.c_void_p(pointer_of(device.__gpointer__, None)), ctypes.byref(size))
    return b"" if start is None else ctypes.string_at(start, size.value)


def _loaded_version(maps: Path) -> str:
    """Version in the file name of the loaded library: the 0.8 bindings do not report it."""
    for line in maps.read_text(encoding="utf-8", errors="replace").splitlines():
        found = _LIBRARY_FILE.search(line)
        if found is not None:
            return found[1]
    return "0.8"


@contextmanager
def translated_errors(library: AravisLibrary, feature: str) -> Iterator[None]:
    """Turn an Aravis error inside the block into one of ours that names the feature."""
    try:
        yield
    except UnicodeDecodeError as error:
        raise DeviceProtocolError(f"what the camera says of {feature} is not text") from error
    except library.glib.Error as error:
        raise _device_error(library, feature, error) from error


def _device_error(library: AravisLibrary, feature: str, error: AravisObject) -> DeviceError:
    codes = library.api.DeviceError
    if _is_code(error, codes.NOT_CONTROLLER, codes.PROTOCOL_ERROR_ACCESS_DENIED):
        return DeviceInUseError(
            f"the camera denies access to {feature}; another program controls the camera, or it "
            "does not allow this at present"
        )
    if _is_code(
        error,
        codes.TIMEOUT,
        codes.NOT_CONNECTED,
        codes.NOT_FOUND,
        codes.TRANSFER_ERROR,
        codes.GENICAM_NOT_FOUND,
    ):
        return DeviceDisconnectedError(f"the camera does not answer ({feature}: {error.message})")
    if _is_code(error, codes.FEATURE_NOT_FOUND):
        return MissingFeatureError(f"the camera has no feature {feature}", names=(feature,))
    return CameraFeatureError(f"the camera refuses {feature}: {error.message}", feature=feature)


def _is_code(error: AravisObject, *codes: AravisObject) -> bool:
    is_device_error = error.domain == "arv-device-error-quark"
    return is_device_error and error.code in [int(code) for code in codes]


GIGE_VISION = "GigEVision"
_CAPABILITY_REGISTER, _PACKET_RESEND = 0x0934, 1 << 2
"""GVCP capabilities (GigE Vision 2.0, section "Bootstrap registers")."""
_IDENTITY = ("DeviceVendorName", "DeviceModelName")
"""What Aravis reads itself as soon as it is given a device."""


class OpenedDevice:
    """The sole owner of the Aravis objects of a camera: closing it releases the camera.

    Nothing else keeps one in a variable: the traceback of an error would keep thread, sockets and
    control alive. ``name`` is an IP address, or the id of a camera not on the network.
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
        """Whether we control the camera; only GigE Vision tells that another program does."""
        return bool(self.device.is_controller()) if self.is_gige else True

    @property
    def resends_packets(self) -> bool | None:
        """Whether the camera says that it sends lost packets again; None if it is on no network."""
        if not self.is_gige:
            return None
        return bool(self.device.read_register(_CAPABILITY_REGISTER) & _PACKET_RESEND)

    def close(self) -> None:
        """Release the camera; closing twice is harmless."""
        self._camera = None
        self._device = None


def open_camera(config: CameraConfig) -> OpenedDevice:
    """Open the camera that a bench file names."""
    if config.address is not None:
        return open_device(config.address)
    if config.id is not None:
        return _open_by_id(config.id)
    raise DeviceError("camera.address is missing; driver 'aravis' needs it, or camera.id")


def open_device(address: str) -> OpenedDevice:
    """Open the camera at one address; nothing is sent to any other address."""
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


def _open_by_id(camera_id: str) -> OpenedDevice:
    """Open any camera that Aravis finds; this BROADCASTS on every network interface."""
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
                f"camera.id {camera_id!r} is not among the cameras found: "
                f"{', '.join(sorted(ids))} ({error.message})"
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
    """Refuse a feature in a register so long that Aravis would fill the memory with it."""
    _require_bounded(_open_lengths(opened.description, opened.device, feature), feature)


def _opened(library: AravisLibrary, name: str, device: AravisObject) -> OpenedDevice:
    """Let Aravis evaluate the description that it has itself, once that is found sound."""
    try:
        description = require_sound_description(_description_of(device), f"the camera at {name}")
        for feature in _IDENTITY:
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
                "reinstall its maker's firmware",
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
