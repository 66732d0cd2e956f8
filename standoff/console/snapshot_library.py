"""Snapshots of the live picture: 16-bit or floating point TIFF files, each with its record."""

import io
import json
import re
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tifffile
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from acquisition.devices import CameraSettings, DeviceInfo
from acquisition.session import write_shared
from standoff.errors import ApplicationError
from standoff.library import make_folder

_NAME = re.compile(r"\d{4}-\d\d-\d\d \d\d\.\d\d\.\d\d(-\d{1,3})?\.tif")
_MOST_A_SECOND = 100


class CameraIdentity(BaseModel):
    """Which camera took a snapshot, as it says itself."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    vendor: str
    model: str
    serial_number: str
    firmware: str
    driver: str


class SnapshotRecord(BaseModel):
    """How a snapshot was taken; the JSON in the file's ``ImageDescription``.

    ``frames`` is the number of frames of which the levels are the mean. ``height_mm`` is as read
    back from the stage, None if it is not known. ``region_px`` is left, top, width and height of
    the focus region, None for the whole picture. Levels are in DN of ``pixel_format``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    schema_name: Literal["standoff.snapshot/1"] = Field(
        default="standoff.snapshot/1", alias="schema"
    )
    taken_utc: str
    operator: str
    frames: int = Field(ge=1)
    exposure_us: float
    gain_db: float | None
    black_level_dn: float
    max_level_dn: int
    pixel_format: str
    frame_rate_hz: float
    height_mm: float | None
    region_px: tuple[int, int, int, int] | None
    camera: CameraIdentity | None

    def to_text(self) -> str:
        """The record as JSON in ASCII, to which TIFF limits its texts."""
        document = self.model_dump(mode="json", by_alias=True)
        return json.dumps(document, ensure_ascii=True, allow_nan=False, indent=1)


def settings_of_record(settings: CameraSettings) -> dict[str, Any]:
    """What the record says of the camera's settings."""
    return {
        "exposure_us": settings.exposure_us,
        "gain_db": settings.gain_db,
        "black_level_dn": settings.black_level_dn,
        "max_level_dn": settings.max_level_dn,
        "pixel_format": settings.pixel_format,
        "frame_rate_hz": settings.frame_rate_hz,
    }


def identity_of(info: DeviceInfo | None) -> CameraIdentity | None:
    """Identity of a camera for the record; None if it is not known."""
    return None if info is None else CameraIdentity(**asdict(info))


def snapshot_bytes(
    levels_dn: NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32], record: SnapshotRecord
) -> memoryview:
    """Make the bytes of a snapshot's file: one page, uncompressed, of the levels as they are.

    Their shape is ``(rows, cols)``; a frame is stored in 16 bits, a mean in float32.
    """
    pixels = np.asarray(levels_dn, np.float32 if levels_dn.dtype.kind == "f" else np.uint16)
    file = io.BytesIO()
    tifffile.imwrite(
        file,
        pixels,
        byteorder="<",
        photometric="minisblack",
        description=record.to_text(),
        metadata=None,
        software="standoff",
    )
    return file.getbuffer()


class SnapshotLibrary:
    """The snapshots in one folder; names from outside are checked before they touch a path."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.latest = ""
        """Name of the last snapshot since the console was started; empty before the first."""

    def save(self, data: memoryview, taken: datetime) -> str:
        """Store a snapshot under the local time at which it was taken, and return its name."""
        make_folder(self.folder)
        stem = taken.astimezone().strftime("%Y-%m-%d %H.%M.%S")
        names = (f"{stem}.tif", *(f"{stem}-{number}.tif" for number in range(2, _MOST_A_SECOND)))
        free = (name for name in names if not (self.folder / name).exists())
        name = next(free, None)
        if name is None:
            raise ApplicationError("There are too many snapshots of this second: try again.")
        try:
            write_shared(self.folder / name, data)
        except OSError as error:
            raise ApplicationError(f"The snapshot was not stored: {error.strerror}.") from error
        self.latest = name
        return name

    def read(self, name: str) -> bytes | None:
        """The file of that name; None if there is no such snapshot."""
        path = self.folder / name
        if _NAME.fullmatch(name) is None or self.folder.is_symlink():
            return None
        if path.is_symlink() or not path.is_file():
            return None
        return path.read_bytes()


def utc_text(taken: datetime) -> str:
    """A moment in UTC to the millisecond, as ISO 8601 writes it."""
    return taken.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
