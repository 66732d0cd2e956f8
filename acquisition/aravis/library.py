"""The Aravis library, imported only when a bench asks for it."""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from acquisition.errors import DriverMissingError

AravisObject = Any
"""An object of the GObject bindings, which have no type annotations."""


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


def _loaded_version(maps: Path) -> str:
    """Version in the file name of the loaded library: the 0.8 bindings do not report it."""
    for line in maps.read_text(encoding="utf-8", errors="replace").splitlines():
        found = _LIBRARY_FILE.search(line)
        if found is not None:
            return found[1]
    return "0.8"
