"""Checks whether this computer is ready for its bench, each with a remedy if it fails."""

import os
import shutil
import stat
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from acquisition.aravis import (
    COUNTS,
    SOCKET_BUFFER_BYTES,
    AravisLibrary,
    Bounds,
    CameraProbe,
    NetworkRoute,
    bench_key,
    load_aravis,
    probe_camera,
    receive_buffer_limit_bytes,
    route_to,
)
from acquisition.bench import BenchConfig, CameraConfig, StageConfig, resolve_address
from acquisition.errors import (
    CameraDescriptionError,
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceTimeoutError,
    DriverMissingError,
    MissingFeatureError,
    NoRouteError,
)
from acquisition.stages import expected_envelopes

CheckStatus = Literal["ok", "warn", "fail"]

JUMBO_MTU_BYTES = 9000
SCARCE_BYTES = 2 * 10**9
"""About 500 captures of 780x580 without raw frames."""

TOO_FEW_BYTES = 100 * 10**6

HELD = "close the other program; if it was killed, wait a few seconds until the camera is free"

REQUIRED_KEYS = ("camera.exposure_us", "camera.gain_db", "camera.pixel_format", "camera.region_px")
"""Keys of the bench file that no camera can do without what they set."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """What one check found; ``remedy`` is empty if nothing needs to be done."""

    name: str
    status: CheckStatus
    found: str
    remedy: str = ""


def _ok(name: str, found: str) -> Check:
    return Check(name=name, status="ok", found=found)


def _warn(name: str, found: str, remedy: str) -> Check:
    return Check(name=name, status="warn", found=found, remedy=remedy)


def _fail(name: str, found: str, remedy: str) -> Check:
    return Check(name=name, status="fail", found=found, remedy=remedy)


def examine(bench: BenchConfig | None, directory: Path) -> tuple[Check, ...]:
    """Run all checks of a bench, or only those of the computer if there is none.

    Its camera is opened and closed, but not configured; its stage is not touched. Sessions will be
    written to the directory.
    """
    needs_aravis = bench is not None and bench.camera.driver == "aravis"
    checks = [check_libraries(needed=needs_aravis), check_receive_buffer()]
    if bench is not None and bench.camera.driver == "aravis":
        checks += _network_and_camera(bench.camera)
    elif bench is not None:
        checks.append(_ok("camera", f"driver {bench.camera.driver!r}: no device"))
    if bench is not None:
        checks.append(check_stage_port(bench.stage))
        if bench.stage.driver == "grbl":
            checks.append(check_stage_travel(bench.stage))
    checks.append(check_disk(directory))
    return tuple(checks)


def check_libraries(*, needed: bool, load: Callable[[], AravisLibrary] = load_aravis) -> Check:
    """Whether Aravis and PyGObject are installed; a failure only if the bench needs them."""
    try:
        library = load()
    except DriverMissingError as error:
        return Check(
            name="libraries",
            status="fail" if needed else "warn",
            found="Aravis cannot be used",
            remedy=str(error),
        )
    return _ok(
        "libraries", f"Aravis {library.aravis_version}, PyGObject {library.pygobject_version}"
    )


def check_receive_buffer(
    read: Callable[[], int | None] = receive_buffer_limit_bytes,
) -> Check:
    """Whether the kernel allows the receive buffer that the driver asks for."""
    limit_bytes = read()
    if limit_bytes is None:
        return _warn(
            "receive buffer",
            "the limit cannot be read on this system",
            f"make sure net.core.rmem_max is at least {SOCKET_BUFFER_BYTES} on the host",
        )
    if limit_bytes >= SOCKET_BUFFER_BYTES:
        return _ok("receive buffer", f"{limit_bytes} bytes")
    return _warn(
        "receive buffer",
        f"limited to {limit_bytes} bytes: frames will be lost",
        f"sudo sysctl -w net.core.rmem_max={SOCKET_BUFFER_BYTES}; to keep it, write "
        f"net.core.rmem_max={SOCKET_BUFFER_BYTES} to /etc/sysctl.d/60-standoff.conf",
    )


def check_route(route: NetworkRoute) -> Check:
    """Which interface leads to the camera."""
    return _ok(
        "network",
        f"{route.address} through {route.interface or 'an interface'} ({route.own_address})",
    )


def check_mtu(route: NetworkRoute) -> Check:
    """Whether jumbo packets fit through the interface."""
    name = route.interface or "INTERFACE"
    if route.mtu_bytes >= JUMBO_MTU_BYTES:
        return _ok("MTU", f"{route.mtu_bytes} bytes: jumbo packets fit")
    return _warn(
        "MTU",
        f"{route.mtu_bytes} bytes: small packets cost more processor time",
        f"sudo ip link set {name} mtu {JUMBO_MTU_BYTES}, if network card and switch allow it; "
        "the driver then uses larger packets automatically",
    )


def advice_on(error: DeviceError) -> str:
    """What to do about an error of a camera, by what kind of error it is."""
    match error:
        case NoRouteError():
            return f"give the network card an address in the subnet of {error.address}"
        case DeviceInUseError():
            return HELD
        case MissingFeatureError():
            key = bench_key(error.feature)
            if key is None:
                return f"this camera model lacks {error.feature}: use another camera"
            if key in REQUIRED_KEYS:
                return f"this camera model cannot set {key}: use another camera"
            return f"this camera model cannot set {key}: leave that out of the bench file"
        case CameraFeatureError() if error.feature.isidentifier():
            key = bench_key(error.feature)
            change = "" if key is None else f"change {key} in the bench file, or "
            return f"{change}set {error.feature} to a possible value in the maker's viewer"
        case CameraDescriptionError():
            return "reinstall the maker's firmware in the camera, or use another camera"
        case DeviceDisconnectedError() | DeviceTimeoutError():
            return (
                "check power, cable and firewall (UDP), and that camera.address or camera.id is "
                "correct: standoff cameras searches for cameras"
            )
        case CameraFeatureError() | DeviceProtocolError() | DeviceRefusalError():
            return "switch the camera off and on again; if that does not help, update its firmware"
        case _:
            return "correct camera.address in the bench file (standoff cameras lists addresses)"


def check_camera(probe: CameraProbe) -> Check:
    """Whether this program may control the camera."""
    who = f"{probe.vendor} {probe.model} at {probe.name}"
    if probe.is_controllable:
        return _ok("camera", who)
    return _fail("camera", f"{who} is in use by another program", HELD)


def check_camera_limits(probe: CameraProbe, config: CameraConfig) -> tuple[Check, ...]:
    """The camera's limits, and whether the bench file keeps within them."""
    rate = probe.frame_rate_hz
    return (
        *_check_resend(probe),
        _within("exposure", "camera.exposure_us", config.exposure_us, probe.exposure_us, "us"),
        _check_gain(probe, config),
        _ok("frame rate", f"up to {rate.high:.1f} Hz with the camera's current settings"),
        _check_pixel_format(probe, config.pixel_format),
        _ok(
            "temperature",
            "not reported by the camera (no DeviceTemperature)"
            if probe.temperature_c is None
            else f"{probe.temperature_c:.1f} C",
        ),
    )


def _check_pixel_format(probe: CameraProbe, pixel_format: str) -> Check:
    formats = ", ".join(probe.pixel_formats) or "none that can be decoded here"
    if pixel_format in probe.pixel_formats:
        return _ok("pixel formats", formats)
    cannot_be_decoded = pixel_format in probe.undecoded_formats
    return _fail(
        "pixel formats",
        f"{formats}; {pixel_format} cannot be decoded here"
        if cannot_be_decoded
        else f"{formats}; not {pixel_format}",
        "set camera.pixel_format in the bench file to one of these"
        if probe.pixel_formats
        else "use a camera with a Mono or Bayer format of 8 to 16 bits",
    )


def check_stage_port(config: StageConfig) -> Check:
    """Whether the stage's serial port exists and this user may open it.

    It is not opened: that would reset a Grbl controller, which then loses its position.
    """
    if config.port is None:
        found = f"driver {config.driver!r}: no port"
        return _ok("stage", found)
    if "://" in config.port:
        return _ok("stage", f"{config.port}: not checked until it is used")
    path = Path(config.port)
    try:
        is_port = stat.S_ISCHR(path.stat().st_mode)
    except OSError as error:
        return _fail(
            "stage",
            f"{config.port}: {error.strerror}",
            "plug the stage in, switch it on, and check ls -l /dev/serial/by-id",
        )
    if not is_port:
        return _fail(
            "stage",
            f"{config.port} is not a serial port",
            "set stage.port in the bench file to a port under /dev/serial/by-id",
        )
    if not os.access(path, os.R_OK | os.W_OK):
        return _fail(
            "stage",
            f"{config.port} exists, but this user may not open it",
            "sudo usermod -aG dialout $USER, then log in again",
        )
    return _ok("stage", f"{config.port} can be opened")


def check_stage_travel(config: StageConfig) -> Check:
    """Whether a Grbl controller reaches the whole of ``limits_mm``, by the bench file alone.

    The settings are the expected ones of the bench file, as the port is not opened. What the
    controller itself is set to is compared when the stage is used.
    """
    name, (low_mm, high_mm) = "stage travel", config.limits_mm
    expected = expected_envelopes(config)
    unnamed = " and ".join(expected.unnamed)
    if expected.largest is None or expected.smallest is None:
        found = (
            f"limits_mm {low_mm:g} to {high_mm:g} mm; name {unnamed} in stage.expected_settings "
            "to have them compared with the controller's travel"
        )
        return _ok(name, found)
    if fault := expected.largest.fault(config.limits_mm):
        return _fail(name, fault.found, fault.remedy)
    if fault := expected.smallest.fault(config.limits_mm):
        if expected.unnamed:
            found = f"this depends on {unnamed} (not in stage.expected_settings): {fault.found}"
        else:
            found = f"on grblHAL: {fault.found}"
        return _warn(name, found, fault.remedy)
    found = f"limits_mm {low_mm:g} to {high_mm:g} mm, within {expected.largest.explanation}"
    return _ok(name, found)


def check_disk(
    directory: Path, free_bytes: Callable[[Path], int] = lambda path: shutil.disk_usage(path).free
) -> Check:
    """Whether ``directory`` has room for sessions."""
    free = free_bytes(directory)
    status: CheckStatus = "ok"
    if free < SCARCE_BYTES:
        status = "fail" if free < TOO_FEW_BYTES else "warn"
    return Check(
        name="disk",
        status=status,
        found=f"{free / 1e9:.1f} GB free in {directory}",
        remedy="" if status == "ok" else "free some space, or write sessions to another disk",
    )


def _network_and_camera(config: CameraConfig) -> list[Check]:
    checks: list[Check] = []
    name = "network"
    try:
        if config.address is not None:
            route = route_to(resolve_address(config.address))
            checks += [check_route(route), check_mtu(route)]
        name = "camera"
        probe = probe_camera(config)
    except DriverMissingError:
        return checks  # reported already by the check of the libraries
    except DeviceError as error:
        remedy = advice_on(error)
        return [*checks, _fail(name, str(error), remedy)]
    return [*checks, check_camera(probe), *check_camera_limits(probe, config)]


def _check_resend(probe: CameraProbe) -> tuple[Check, ...]:
    """Whether a lost packet costs its frame, of a camera on a network."""
    if probe.resends_packets is None:
        return ()
    if probe.resends_packets:
        found = "the camera resends lost packets"
        return (_ok("packet resend", found),)
    return (
        _warn(
            "packet resend",
            "this camera does not resend lost packets: each lost packet costs a frame",
            "give it a network card and cable of its own, the receive buffer and MTU above, "
            "and a camera.frame_rate_hz or camera.bandwidth_limit_bytes_per_s well below "
            "what the link carries",
        ),
    )


def _check_gain(probe: CameraProbe, config: CameraConfig) -> Check:
    """Whether the gain can be set, which cameras state in dB, as a factor, or in counts."""
    low, high = probe.gain
    if low.decibels is not None and high.decibels is not None and config.gain_counts is None:
        bounds = Bounds(low=low.decibels, high=high.decibels)
        return _within("gain", "camera.gain_db", config.gain_db, bounds, "dB")
    if low.unit != COUNTS:
        return _fail(
            "gain",
            f"{low.feature} is in {low.unit}; camera.gain_counts is set",
            "set camera.gain_db instead",
        )
    bounds = Bounds(low=low.value, high=high.value)
    if config.gain_counts is not None:
        return _within("gain", "camera.gain_counts", config.gain_counts, bounds, COUNTS)
    found = f"{bounds.low:g} to {bounds.high:g} counts of {low.feature}, without a scale in dB"
    if config.gain_db == 0:
        return _ok("gain", f"{found}; camera.gain_db 0 is the lowest")
    return _fail(
        "gain",
        f"{found}; camera.gain_db is {config.gain_db:g}",
        "set camera.gain_counts to one of these counts and camera.gain_db to 0",
    )


def _within(name: str, key: str, wanted: float, bounds: Bounds, unit: str) -> Check:
    found = f"{bounds.low:,.10g} to {bounds.high:,.10g} {unit}"
    if bounds.low <= wanted <= bounds.high:
        return _ok(name, found)
    return _fail(
        name,
        f"{found}; {key} is {wanted:g}",
        f"set {key} in the bench file to a value within these limits",
    )
