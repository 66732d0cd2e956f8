"""What a session records: settings, devices, and everything about a capture but its pixels."""

import json
import math
import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, TypeAdapter, ValidationError

from acquisition.averaging import AveragedFrames
from acquisition.bench import BenchConfig
from acquisition.bracket import BracketExposure, MergedBracket
from acquisition.choices import CaptureKind
from acquisition.devices import Camera, CameraSettings, DeviceInfo, FrameImage, Stage
from acquisition.errors import SessionError
from acquisition.plan import CapturePlan, parse_plan
from acquisition.untrusted import parse_json
from acquisition.written_files import validation_keys, validation_lines

_SCHEMA = "standoff.session/1"
_IDENTITY_KEYS = ("driver", "DeviceVendorName", "DeviceModelName", "DeviceSerialNumber")
_MEASURE_KEYS = ("Width", "Height", "limits_mm")
"""Sensor and travel: compared where both runs tell them."""

_CONNECTION_KEYS = (
    ("stage", "port"),
    ("stage", "release_dtr"),
    ("camera", "address"),
    ("camera", "id"),
)
"""Keys of the bench under which a device is plugged in today; they do not tell which it is."""
_KEYS = ("schema", "uid", "created_utc", "operator", "plan", "bench", "devices", "software")
_BENCH_TABLES = ("camera", "stage", "capture")


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """The contents of session.json.

    ``bench`` is the resolved bench config as a JSON object. ``devices`` describes ``camera`` and
    ``stage`` as they were when the session was made, if there were any. ``software`` maps packages
    to versions.
    """

    uid: str
    created_utc: str
    operator: str
    plan: CapturePlan
    bench: Mapping[str, Any]
    devices: Mapping[str, Mapping[str, Any]]
    software: Mapping[str, str]

    def to_bytes(self) -> bytes:
        """The file's text, indented for readability."""
        document = {
            "schema": _SCHEMA,
            "uid": self.uid,
            "created_utc": self.created_utc,
            "operator": self.operator,
            "plan": self.plan.to_json(),
            "bench": self.bench,
            "devices": self.devices,
            "software": self.software,
        }
        text = json.dumps(document, ensure_ascii=False, allow_nan=False, indent=2)
        return text.encode() + b"\n"

    @classmethod
    def from_bytes(cls, data: bytes, *, source: str) -> Self:
        """Read the file's text; an error message starts with ``source``.

        Raises
        ------
        SessionError
            If it is not the session.json of a session of this version.
        """
        try:
            document = parse_json(data)
        except ValueError as error:
            raise SessionError(
                f"{source}: damaged ({error}); restore it from a copy", fault="damaged"
            ) from error
        if not isinstance(document, dict) or document.get("schema") != _SCHEMA:
            raise SessionError(f"{source}: its schema is not {_SCHEMA}", keys=("schema",))
        if set(document) != set(_KEYS):
            odd = tuple(sorted(set(document) ^ set(_KEYS)))
            raise SessionError(f"{source}: missing or unknown key: {', '.join(odd)}", keys=odd)
        for key in _no_tables(document):
            raise SessionError(f"{source}: {key} is not a table", keys=(key,))
        return cls(
            uid=str(document["uid"]),
            created_utc=str(document["created_utc"]),
            operator=str(document["operator"]),
            plan=parse_plan(document["plan"], source=f"{source}, plan"),
            bench=document["bench"],
            devices=document["devices"],
            software=document["software"],
        )

    def differences(
        self,
        plan: CapturePlan,
        bench: Mapping[str, Any],
        devices: Mapping[str, Mapping[str, Any]],
    ) -> dict[str, str]:
        """Differences of another run from the session, by key: in plan, bench and device identity.

        A bench key that is newer than the session counts as having its default value, and an
        identity that the session does not have is not compared. Ports and addresses may differ: see
        `reconnected`.
        """
        bench_changes = _differences("bench", _with_defaults(self.bench), bench)
        for table, key in _CONNECTION_KEYS:
            bench_changes.pop(f"bench.{table}.{key}", None)
        old, new = _identities(self.devices), _identities(devices)
        return {
            **_differences("plan", self.plan.to_json(), plan.to_json()),
            **bench_changes,
            **_differences("devices", _known_to(new, old), _known_to(old, new)),
        }

    def reconnected(self, bench: Mapping[str, Any]) -> dict[str, str]:
        """Ports and addresses that differ from those when the session was made, by key."""
        changes = _differences("bench", _with_defaults(self.bench), bench)
        keys = (f"bench.{table}.{key}" for table, key in _CONNECTION_KEYS)
        return {key: changes[key] for key in keys if key in changes}


def camera_snapshot(camera: Camera) -> dict[str, Any]:
    """Identity and settings of the camera, as read back from it, and what it states itself.

    Names follow the GenICam Standard Features Naming Convention: ``ExposureTime`` in us, ``Gain``
    in dB (null if in counts), ``BlackLevel`` in DN.
    """
    settings = camera.settings
    return {
        **settings.features,
        **_identity(camera.info),
        "Width": settings.width_px,
        "Height": settings.height_px,
        "PixelFormat": settings.pixel_format,
        "ExposureTime": settings.exposure_us,
        "Gain": settings.gain_db,
        "AcquisitionFrameRate": settings.frame_rate_hz,
        "BlackLevel": settings.black_level_dn,
        "stated": {
            "gain": settings.gain,
            "gain_unit": settings.gain_unit,
            "black_level": settings.black_level,
            "black_level_unit": settings.black_level_unit,
        },
    }


def stage_snapshot(stage: Stage) -> dict[str, Any]:
    """Identity and travel of the stage."""
    return {**_identity(stage.info), "limits_mm": list(stage.limits_mm)}


def software_versions() -> dict[str, str]:
    """Versions of Python and of the packages whose code affects a capture."""
    versions = {"python": platform.python_version()}
    for package in ("standoff", "numpy", "tifffile", "opencv-contrib-python-headless", "PyGObject"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return versions


def _identity(info: DeviceInfo) -> dict[str, Any]:
    return {
        "driver": info.driver,
        "DeviceVendorName": info.vendor,
        "DeviceModelName": info.model,
        "DeviceSerialNumber": info.serial_number,
        "DeviceFirmwareVersion": info.firmware,
    }


def _no_tables(document: Mapping[str, Any]) -> Iterator[str]:
    """Dotted keys of what is looked into as a table and is none."""
    for key in ("plan", "bench", "devices", "software"):
        table = document[key]
        if not isinstance(table, dict):
            yield key
        elif key in ("bench", "devices"):
            for name, value in table.items():
                is_table = key == "devices" or name in _BENCH_TABLES
                if is_table and not isinstance(value, dict):
                    yield f"{key}.{name}"


def _with_defaults(bench: Mapping[str, Any]) -> Mapping[str, Any]:
    try:
        return BenchConfig.model_validate(bench).model_dump(mode="json")
    except ValidationError:
        return bench


def _identities(devices: Mapping[str, object]) -> dict[str, Any]:
    return {
        role: {key: device[key] for key in (*_IDENTITY_KEYS, *_MEASURE_KEYS) if key in device}
        for role, device in devices.items()
        if isinstance(device, Mapping)
    }


def _known_to(other: Mapping[str, Any], identities: Mapping[str, Any]) -> dict[str, Any]:
    """The identities without a sensor or travel that another run does not tell."""
    return {
        role: {
            key: value
            for key, value in identity.items()
            if key not in _MEASURE_KEYS or key in other.get(role, identity)
        }
        for role, identity in identities.items()
    }


def _differences(path: str, old: object, new: object) -> dict[str, str]:
    """Old and new value of every key that differs."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        pairs = {key: (old.get(key), new.get(key)) for key in (*old, *new)}
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = {str(number): pair for number, pair in enumerate(zip(old, new, strict=True))}
    else:
        return {} if old == new else {path: f"was {_brief(old)}, now {_brief(new)}"}
    return {
        deeper: text
        for key, pair in pairs.items()
        for deeper, text in _differences(f"{path}.{key}", *pair).items()
    }


def _brief(value: object) -> str:
    if value is None:
        return "not set"
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."


_LONGEST_PATH = 255
"""Bytes of a file's path in a session: no more than a file system takes for a single name."""

_UTC_TEXT = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureRecord:
    """One capture, as the journal and the Info of its TIFF record it.

    What an imported photograph does not state, such as exposure, gain and time stamps, is None.

    Parameters
    ----------
    index, uid
        Number of the capture in the plan, from 0, and its unique identity.
    height_asked_mm, height_mm
        Height of the plan, and height read back from the stage.
    saturated_pixels
        Number of pixels saturated in any frame; in a bracket, in all exposures.
    exposure_us
        Exposure time in us; in a bracket the shortest, in whose DN the levels are.
    gain_db, black_level_dn
        Gain and black level; None and 0 if the camera states them in counts, whose scale is not
        known.
    started_utc, finished_utc
        Time of the computer's clock before and after the capture.
    first_timestamp_ns, last_timestamp_ns
        Time stamps of the camera for the first and the last frame used.
    focus_value
        Focus value; None for flat and dark captures.
    file, frames_file
        Paths of the capture and of its raw frames, relative to the session, with forward slashes.
    sha256, frames_sha256
        Hashes of the two files; ``sha256`` is None in the file itself.
    gain, gain_unit, black_level, black_level_unit
        Gain and black level as the camera states them, in these units; None in older records.
    bracket
        Exposures of a bracket, shortest first; None for a capture with one exposure.
    """

    index: int
    uid: str
    kind: CaptureKind
    target: str
    orientation_deg: float
    height_asked_mm: float
    height_mm: float
    frames_used: int
    incomplete_frames: int
    resent_packets: int
    saturated_pixels: int
    min_dn: float
    max_dn: float
    exposure_us: float | None
    gain_db: float | None
    pixel_format: str
    black_level_dn: float
    max_level_dn: float
    started_utc: str
    finished_utc: str
    first_timestamp_ns: int | None
    last_timestamp_ns: int | None
    focus_value: float | None
    scale_px_per_mm: float | None
    file: str
    frames_file: str | None
    frames_sha256: str | None
    sha256: str | None
    gain: float | None = None
    gain_unit: str | None = None
    black_level: float | None = None
    black_level_unit: str | None = None
    bracket: tuple[BracketExposure, ...] | None = None

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True)

    def __post_init__(self) -> None:
        for name in ("index", "incomplete_frames", "resent_packets", "saturated_pixels"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if self.frames_used < 1:
            raise ValueError(f"frames_used must be at least 1, got {self.frames_used}")
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"{field.name} must be finite, got {value}")
        for name in ("started_utc", "finished_utc"):
            if not _UTC_TEXT.fullmatch(getattr(self, name)):
                raise ValueError(f"{name} must be a time in UTC, got {getattr(self, name)!r}")
        for name in ("file", "frames_file"):
            path = getattr(self, name)
            if path is not None and not _is_inside(path):
                got = (
                    path if len(path) <= _LONGEST_PATH else f"{path[:20]}... ({len(path)} letters)"
                )
                raise ValueError(f"{name} must be a file inside the session, got {got}")

    def to_json(self) -> dict[str, Any]:
        """The record as a JSON object, which ``from_json`` reads back exactly.

        Without a bracket, it is the same object as in earlier versions.
        """
        document = asdict(self)
        bracket = document.pop("bracket")
        return document if bracket is None else {**document, "bracket": list(bracket)}

    @staticmethod
    def from_json(
        document: Mapping[str, object], *, source: str = "capture record"
    ) -> "CaptureRecord":
        """Read a record; an error message starts with ``source``.

        Raises
        ------
        SessionError
            If a key is missing, unknown or of the wrong type; the message names it.
        """
        try:
            # pydantic's strict mode takes a dataclass from JSON text, not from a dict.
            return _adapter().validate_json(json.dumps(document))
        except ValidationError as error:
            raise SessionError(
                f"{source}: {validation_lines(error)}",
                fault="damaged",
                keys=validation_keys(error),
            ) from error


def _is_inside(path: str) -> bool:
    """Whether a relative path can be that of a file in its folder."""
    parts = path.split("/")
    is_short = len(path.encode(errors="surrogatepass")) <= _LONGEST_PATH
    return is_short and "" not in parts and ".." not in parts


def utc_text(moment: datetime) -> str:
    """ISO 8601 text of a moment in UTC, to the microsecond: ``2025-03-04T05:06:07.000008Z``."""
    text = moment.astimezone(UTC).isoformat(timespec="microseconds")
    return text.removesuffix("+00:00") + "Z"


@cache
def _adapter() -> TypeAdapter[CaptureRecord]:
    return TypeAdapter(CaptureRecord)


@dataclass(frozen=True, slots=True, kw_only=True)
class Take:
    """The averaged frames of a plan entry, with height, times and settings.

    Settings and height are as read back; of a bracket the settings have its shortest exposure.
    ``focus_value`` is None for flat and dark captures.
    """

    averaged: AveragedFrames
    settings: CameraSettings
    height_mm: float
    focus_value: float | None
    started: datetime
    finished: datetime
    scale_px_per_mm: float | None = None
    raw_frames: Sequence[FrameImage] = ()
    bracket: MergedBracket | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Photograph:
    """An image from another camera, or the mean of ``frames`` of them with their variance.

    None stands for what it does not state.
    """

    image_dn: NDArray[np.float32]
    pixel_format: str
    max_level_dn: float
    black_level_dn: float = 0.0
    exposure_us: float | None = None
    gain_db: float | None = None
    scale_px_per_mm: float | None = None
    variance_dn2: NDArray[np.float32] | None = None
    frames: int = 1
