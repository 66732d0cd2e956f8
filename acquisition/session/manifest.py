"""session.json: the settings and devices of a session, fixed when it was made."""

import json
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Self

from pydantic import ValidationError

from acquisition.bench import BenchConfig
from acquisition.devices import Camera, DeviceInfo, Stage
from acquisition.errors import SessionError
from acquisition.plan import CapturePlan, parse_plan
from acquisition.untrusted import parse_json

MANIFEST_NAME = "session.json"
_SCHEMA = "standoff.session/1"
_IDENTITY_KEYS = ("driver", "DeviceVendorName", "DeviceModelName", "DeviceSerialNumber")
_MEASURE_KEYS = ("Width", "Height", "limits_mm")
"""Sensor and travel: compared where both runs tell them."""

_CONNECTION_KEYS = (("stage", "port"), ("camera", "address"), ("camera", "id"))
"""Keys of the bench under which a device is plugged in today; they do not tell which it is."""
_KEYS = ("schema", "uid", "created_utc", "operator", "plan", "bench", "devices", "software")
_BENCH_TABLES = ("camera", "stage", "capture")


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """The content of session.json.

    ``bench`` is the resolved bench config as a JSON object; ``devices`` has a snapshot under
    ``camera`` and ``stage`` where there is one; ``software`` maps package to version.
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
        """What another run would change, by key: in plan, bench and device identities.

        A bench key that is newer than the session counts as its default, and an identity that the
        session does not have is not compared. Ports and addresses are free: see `reconnected`.
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
        """Ports and addresses that are others than when the session was made, by key."""
        changes = _differences("bench", _with_defaults(self.bench), bench)
        keys = (f"bench.{table}.{key}" for table, key in _CONNECTION_KEYS)
        return {key: changes[key] for key in keys if key in changes}


def camera_snapshot(camera: Camera) -> dict[str, Any]:
    """Identity and settings of the camera, as read back from it.

    Names follow the GenICam Standard Features Naming Convention: ``ExposureTime`` in us,
    ``Gain`` in dB (null if it is in counts), ``AcquisitionFrameRate`` in Hz, ``BlackLevel`` in DN.
    What the camera itself states is under ``stated``.
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
