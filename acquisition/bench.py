"""The bench: its file, validated key by key, the camera's address, and the opened devices."""

import ipaddress
import re
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from acquisition.devices import Camera, Stage
from acquisition.errors import BenchConfigError, DeviceError
from acquisition.quantities import nearest_key
from acquisition.untrusted import parse_toml
from acquisition.written_files import (
    WrittenTable,
    dotted_keys,
    read_toml,
    validate_written,
    validation_keys,
    validation_lines,
)

_HOST_NAME = re.compile(
    r"(?=.{1,253}$)[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?(\.[A-Za-z0-9-]{1,63})*"
)
"""Labels have at most 63 characters (RFC 1035, section 2.3.4): Python resolves no longer ones."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Fraction = Annotated[float, Field(ge=0, lt=1)]


class CameraConfig(WrittenTable):
    """``[camera]``: which camera, and its settings."""

    driver: Literal["aravis", "simulated", "files"]
    address: str | None = Field(None, description="IP address or host name of a GigE Vision camera")
    id: str | None = Field(
        None,
        min_length=1,
        description="name by which Aravis finds a camera on any network or USB port, in place of "
        "address; it broadcasts",
    )
    pixel_format: str = Field(description="GenICam PFNC name, such as Mono12")
    exposure_us: Positive
    gain_db: NonNegative
    gain_counts: NonNegative | None = Field(
        None,
        description="gain in counts, for a camera without a scale in dB; gain_db is then 0",
    )
    frame_rate_hz: Positive
    trigger: str = Field(
        "off",
        min_length=1,
        description='what starts a frame: "off" (the frame rate), "software", or a line such as '
        "Line1, whose pulses come at frame_rate_hz",
    )
    trigger_edge: Literal["rising", "falling"] = "rising"
    chunk_data: bool = Field(
        True, description="whether to have exposure and counter in each frame, if the camera can"
    )
    region_px: tuple[int, int, int, int] | None = Field(
        None, description="left, top, width, height on the sensor; default: the whole sensor"
    )
    packet_size_bytes: int | None = Field(
        None, ge=220, le=16000, description="default: the largest that gets through"
    )
    bandwidth_limit_bytes_per_s: int | None = Field(
        None, gt=0, description="for cameras that share a cable; default: the camera's own"
    )
    reconnect_timeout_s: NonNegative = Field(
        30.0, description="how long to wait for a lost camera; 0: not at all"
    )

    @model_validator(mode="after")
    def _aravis_has_an_address(self) -> "CameraConfig":
        if self.driver == "aravis" and (self.address is None) == (self.id is None):
            trouble = "is missing" if self.address is None else "and camera.id are both given"
            raise ValueError(
                f"camera.address {trouble}; driver 'aravis' requires it, or camera.id instead"
            )
        if self.gain_counts is not None and self.gain_db != 0:
            raise ValueError(
                f"camera.gain_counts and camera.gain_db {self.gain_db:g} are both given; with "
                "gain_counts, gain_db must be 0"
            )
        fault = None if self.address is None else _address_fault(self.address)
        if fault is not None:
            raise ValueError(f"camera.address: {fault}")
        return self

    @model_validator(mode="after")
    def _region_is_on_a_sensor(self) -> "CameraConfig":
        if self.region_px is not None:
            left, top, width, height = self.region_px
            if min(left, top) < 0 or min(width, height) < 1:
                raise ValueError(
                    f"region_px must be left, top, width, height, got {self.region_px}"
                )
        return self


class StageConfig(WrittenTable):
    """``[stage]``: which stage, its travel and settling."""

    driver: Literal["grbl", "zaber", "manual", "simulated"]
    port: str | None = Field(None, description="serial port, preferably under /dev/serial/by-id")
    baud_rate: int = Field(115200, gt=0)
    release_dtr: bool = Field(
        False,
        description="whether to let go of DTR and RTS, for boards that these lines keep in reset",
    )
    limits_mm: tuple[float, float]
    feed_mm_per_min: Positive = 300.0
    settle_s: NonNegative = 0.5
    tolerance_mm: Positive = 0.01
    approach: Literal["from_below", "from_above"] = "from_below"
    backlash_mm: NonNegative = Field(
        0.5, description="how far a move from the other side first overshoots its target"
    )
    home_offset_mm: float = Field(0.0, description="height where the controller reads 0")
    direction: Literal["up", "down"] = Field(
        "up", description="direction of the camera when the controller counts up"
    )
    park_mm: float | None = None
    axis: Literal["X", "Y", "Z"] = Field("Z", description="Grbl axis that moves the camera")
    homing: Literal["all_axes", "single_axis"] = Field(
        "all_axes",
        description="whether Grbl homes with $H or with the axis's own command, such as $HZ",
    )
    device_address: int = Field(
        1, ge=1, le=99, description="address of the Zaber device in the chain"
    )
    axis_number: int = Field(1, ge=1, le=9, description="axis of the Zaber device")
    microstep_um: Positive | None = Field(None, description="travel of one Zaber microstep")
    expected_settings: dict[str, float] = Field(
        default_factory=dict,
        description='settings the controller must have, such as "$102" or "resolution"',
    )
    wire_log: str | None = Field(None, description="file for a log of every line on the wire")

    @model_validator(mode="after")
    def _keys_fit(self) -> "StageConfig":
        low_mm, high_mm = self.limits_mm
        if not low_mm < high_mm:
            raise ValueError(f"limits_mm must ascend, got {list(self.limits_mm)}")
        if self.park_mm is not None and not low_mm <= self.park_mm <= high_mm:
            raise ValueError(f"park_mm must be within limits_mm, got {self.park_mm:g}")
        if self.driver in ("grbl", "zaber") and not self.port:
            raise ValueError(f"port is missing; driver {self.driver!r} requires it")
        if self.driver == "zaber" and self.microstep_um is None:
            raise ValueError("microstep_um is missing; driver 'zaber' requires it")
        return self


class OpticsConfig(WrittenTable):
    """``[optics]``: lens and sensor."""

    focal_length_mm: Positive
    pixel_pitch_um: Positive
    lens: str = ""


class LabelsConfig(WrittenTable):
    """``[labels]``: lens, camera, target, customer and operator for the first page of reports."""

    lens: str = ""
    camera: str = ""
    target: str = ""
    customer: str = ""
    operator: str = ""


class CaptureConfig(WrittenTable):
    """``[capture]``: how many frames a capture averages, and the mains frequency."""

    frames_per_capture: int = Field(10, ge=2, le=1000)
    mains_hz: Literal[0, 50, 60] = Field(
        50, description="mains frequency of the lamps; 0: they do not flicker"
    )


class SimulatedConfig(WrittenTable):
    """``[simulated]``: the truth of the simulated bench, for its two simulated drivers only."""

    seed: int = Field(1, ge=0)
    width_px: int = Field(780, ge=16, le=16384)
    height_px: int = Field(580, ge=16, le=16384)
    optical_sigma_x_px: Annotated[float, Field(ge=0.2, le=10)] = 0.55
    optical_sigma_y_px: Annotated[float, Field(ge=0.2, le=10)] = 0.55
    optical_rho: Annotated[float, Field(gt=-0.95, lt=0.95)] = 0.0
    corner_sigma_gain: NonNegative = Field(
        0.0, description="relative growth of sigma from the centre to the corner"
    )
    pupil_offset_mm: float = Field(
        0.0, description="distance of the entrance pupil above height zero"
    )
    focus_distance_mm: Positive | None = Field(
        None, description="distance in focus; default: refocused at every height"
    )
    f_number: Positive = 4.0
    k1: float = Field(0.0, description="radial distortion at the image corner, relative")
    vignetting: _Fraction = Field(0.0, description="relative fall-off at the image corner")
    gloss: NonNegative = Field(0.0, description="peak of a highlight, relative to white paper")
    shadow: _Fraction = Field(0.0, description="relative loss of light in a soft shadow")
    dimming_per_100mm: _Fraction = Field(
        0.0, description="relative loss of light for every 100 mm of height"
    )
    white_e_per_us: Positive = Field(
        1.5, description="electrons per pixel and microsecond from white paper"
    )
    gain_e_per_dn: Positive = Field(5.0, description="conversion at 0 dB, e-/DN at 12 bits")
    read_noise_e: NonNegative = 12.0
    full_well_e: Positive = 22000.0
    black_level_dn: NonNegative = Field(64.0, description="offset, in DN at 12 bits")


class BenchConfig(WrittenTable):
    """A bench file: camera, stage, optics, and the truth of a simulated bench."""

    camera: CameraConfig
    stage: StageConfig
    optics: OpticsConfig
    capture: CaptureConfig = CaptureConfig(frames_per_capture=10, mains_hz=50)
    simulated: SimulatedConfig | None = None
    labels: LabelsConfig | None = None

    @property
    def frame_shape(self) -> tuple[int, int] | None:
        """Rows and columns of a frame, or None if the bench file does not say."""
        if self.camera.region_px is not None:
            return self.camera.region_px[3], self.camera.region_px[2]
        if self.camera.driver == "simulated" and self.simulated is not None:
            return self.simulated.height_px, self.simulated.width_px
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchDevices:
    """Camera and stage of a bench, opened and configured according to ``config``.

    ``clock`` returns the monotonic time of both devices in s; ``sleep`` waits for a time in s.
    """

    config: BenchConfig
    camera: Camera
    stage: Stage
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


def load_bench(path: Path, overrides: dict[str, Any] | None = None) -> BenchConfig:
    """Read a bench file; ``overrides`` replace individual keys (``"camera.gain_db": 3``)."""
    try:
        table = read_toml(path)
    except OSError as error:
        raise BenchConfigError(f"bench file {path}: {error.strerror}", path=path) from error
    except ValueError as error:
        raise BenchConfigError(f"bench file {path}: {error}", path=path) from error
    for key, value in (overrides or {}).items():
        section, _, name = key.partition(".")
        keys = table.setdefault(section, {})
        if not isinstance(keys, dict):
            raise BenchConfigError(
                f"bench file {path}: {section} is not a table", path=path, keys=(section,)
            )
        keys[name] = value
    try:
        return validate_written(BenchConfig, table)
    except ValidationError as error:
        raise BenchConfigError(
            f"bench file {path}: {validation_lines(error, BenchConfig)}",
            path=path,
            keys=validation_keys(error),
        ) from error


def parse_overrides(settings: list[str]) -> dict[str, Any]:
    """Split ``section.key=value`` arguments; a value that is not TOML is taken as text."""
    overrides: dict[str, Any] = {}
    known = [key for key in dotted_keys(BenchConfig) if "." in key]
    for setting in settings:
        key, equals, text = setting.partition("=")
        key = key.strip()
        if not equals or key not in known:
            raise BenchConfigError(f"--set {setting}: {_key_fault(key, known)}", keys=(key,))
        try:
            value = parse_toml(f"value = {text}")["value"]
        except ValueError:
            value = text.strip()
        overrides[key] = value
    return overrides


def _key_fault(key: str, known: list[str]) -> str:
    """What is wrong with an override: its key is unknown, or it has no value."""
    if key in known:
        return f"expected {key}=VALUE"
    section, dot, _ = key.partition(".")
    nearest = None if key in BenchConfig.model_fields else nearest_key(key, known)
    if nearest is not None:
        return f"unknown bench key {key}; did you mean {nearest}?"
    others = [name for other in known for at, _, name in [other.partition(".")] if at == section]
    if dot and others:
        return f"unknown bench key {key}; {section} has {', '.join(others)}"
    return "expected section.key=value of a bench file"


def _address_fault(text: str) -> str | None:
    """Say why ``text`` cannot name one camera; None where it can.

    A command sent to a broadcast, multicast or other many-host address would reach every camera.
    """
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        if _HOST_NAME.fullmatch(text) and not text.replace(".", "").isdigit():
            return None
        return f"{text!r} is neither an IPv4 address nor a host name"
    if address.version != 4:
        return f"{text} is an IPv6 address; GigE Vision supports only IPv4"
    if address.is_multicast or address.is_unspecified or address.is_reserved:
        return f"{text} is not the address of one camera"
    return None


def resolve_address(address: str) -> str:
    """Return the IPv4 address of a camera given by address or host name."""
    fault = _address_fault(address)
    if fault is not None:
        raise DeviceError(f"camera.address: {fault}")
    try:
        found = socket.getaddrinfo(address, None, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise DeviceError(
            f"camera.address: the host name {address!r} cannot be resolved ({error.strerror}); "
            "give the camera's IP address"
        ) from error
    resolved = str(found[0][4][0])
    fault = _address_fault(resolved)
    if fault is not None:
        raise DeviceError(f"camera.address: the host name {address!r} cannot be used: {fault}")
    return resolved
