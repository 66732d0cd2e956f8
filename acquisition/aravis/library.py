"""The Aravis library, imported only when a bench asks for it."""

import ctypes
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from acquisition.errors import DriverMissingError

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
    """Import Aravis 0.8 through PyGObject.

    Raises
    ------
    DriverMissingError
        If one of the two is not installed; the error names the packages.
    """
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
    """The text that a function of Aravis returns; bytes that are no UTF-8 show as question marks.

    Texts lie in a camera's registers, where anything can be.
    """
    try:
        return str(read(*arguments))
    except UnicodeDecodeError as error:
        return error.object.decode("utf-8", "replace")


def description_of(device: AravisObject) -> bytes:
    """The description that an ``Aravis.Device`` has of its camera.

    The bindings take it for a text that ends with a zero byte, which it does not: they read on
    behind its end (PyGObject 3.50 with Aravis 0.8.26). So the function is called directly.
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
