"""session.json: the settings and devices of a session, fixed when it was made."""

import json
import platform
from collections.abc import Mapping
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
_KEYS = ("schema", "uid", "created_utc", "operator", "plan", "bench", "devices", "software")


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
        for key in ("plan", "bench", "devices", "software"):
            if not isinstance(document[key], dict):
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

        A bench key that is newer than the session counts as its default.
        """
        return {
            **_differences("plan", self.plan.to_json(), plan.to_json()),
            **_differences("bench", _with_defaults(self.bench), bench),
            **_differences("devices", _identities(self.devices), _identities(devices)),
        }


def camera_snapshot(camera: Camera) -> dict[str, Any]:
    """Identity and settings of the camera, as read back from it.

    Names follow the GenICam Standard Features Naming Convention: ``ExposureTime`` in us,
    ``Gain`` in dB, ``AcquisitionFrameRate`` in Hz, ``BlackLevel`` in DN.
    """
    settings = camera.settings
    return {
        **_identity(camera.info),
        "Width": settings.width_px,
        "Height": settings.height_px,
        "PixelFormat": settings.pixel_format,
        "ExposureTime": settings.exposure_us,
        "Gain": settings.gain_db,
        "AcquisitionFrameRate": settings.frame_rate_hz,
        "BlackLevel": settings.black_level_dn,
        **settings.features,
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


def _with_defaults(bench: Mapping[str, Any]) -> Mapping[str, Any]:
    try:
        return BenchConfig.model_validate(bench).model_dump(mode="json")
    except ValidationError:
        return bench


def _identities(devices: Mapping[str, object]) -> dict[str, Any]:
    return {
        role: {key: device[key] for key in _IDENTITY_KEYS if key in device}
        for role, device in devices.items()
        if isinstance(device, Mapping)
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
