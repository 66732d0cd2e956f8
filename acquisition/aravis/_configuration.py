"""Configure a camera from the bench file and read its settings back.

Whatever makes levels non-linear, replaces pixels or changes settings by itself is switched off. The
largest stream packet that reaches this computer is found by trial, over the bootstrap registers,
which every camera has: Aravis' own negotiation gives up where the camera's description does not
show ``GevSCPSFireTestPacket`` as a command (Aravis 0.8.26).

References
----------
AIA, GigE Vision, version 2.0 (2011), section "Bootstrap registers", stream channel 0.
"""

import socket
import time
from dataclasses import dataclass, field, replace
from math import inf

from acquisition.aravis._device import OpenedDevice, text_of, translated_errors
from acquisition.aravis._features import (
    COUNTS,
    Bounds,
    CameraFeatures,
    FeatureName,
    FeatureValue,
    LevelControls,
    StatedValue,
    names_for,
    neutral_features,
    whole,
)
from acquisition.aravis._network import route_to
from acquisition.aravis._stream import FrameChunks, can_decode
from acquisition.bench import CameraConfig
from acquisition.devices import CameraSettings
from acquisition.errors import CameraFeatureError, DeviceError, DeviceInUseError

_PACKET_SIZE = "GevSCPSPacketSize"

_SAFE_PACKET_BYTES = 1500
"""Packet size that Ethernet carries without any configuration."""

_PORT_REGISTER = 0x0D00
_SIZE_REGISTER = 0x0D04
_ADDRESS_REGISTER = 0x0D18

_FIRE_TEST_PACKET = 0x8000_0000
_DO_NOT_FRAGMENT = 0x4000_0000
_SIZE_MASK = 0xFFFF

_IP_AND_UDP_HEADER_BYTES = 28
_USUAL_SIZES = (16000, 9000, 8228, 8000, 6000, 4000, 3000, 2000, _SAFE_PACKET_BYTES, 1400, 576)
"""Sizes for jumbo frames and tunnels, and the smallest that every network carries."""

_TRIES = 3
_WAIT_S = 0.02


def _set_packet_size(
    opened: OpenedDevice, features: CameraFeatures, packet_size_bytes: int | None
) -> tuple[str, ...]:
    """Set a packet size, or the largest that gets through; return warnings."""
    warnings: tuple[str, ...] = ()
    with translated_errors(opened.library, _PACKET_SIZE):
        # Making a stream would negotiate, unasked. A Manta's packet size at power-up is above
        # its own maximum; Aravis 0.8.26 then ends the process with an assertion.
        opened.camera.gv_set_packet_size_adjustment(opened.library.api.GvPacketSizeAdjustment.NEVER)
        if packet_size_bytes is None:
            bounds = features.bounds(_PACKET_SIZE)
            route = route_to(opened.name)
            packet_size_bytes = _largest_packet(
                opened,
                own_address=route.own_address,
                mtu_bytes=route.mtu_bytes,
                low=whole(bounds.low, _PACKET_SIZE),
                high=whole(bounds.high, _PACKET_SIZE),
                step=max(1, round(features.step(_PACKET_SIZE))),
            )
        if packet_size_bytes is None:
            packet_size_bytes = _SAFE_PACKET_BYTES
            warnings = (
                "no test packet arrived from the camera: a firewall blocks its stream, or it "
                f"sends none; the packet size is set to {_SAFE_PACKET_BYTES} bytes",
            )
        opened.camera.gv_set_packet_size(packet_size_bytes)
        found = int(opened.camera.gv_get_packet_size())
    if found != packet_size_bytes:
        raise CameraFeatureError(
            f"the camera does not keep {_PACKET_SIZE}: set to {packet_size_bytes}, "
            f"it reads back {found}",
            feature=_PACKET_SIZE,
        )
    return warnings


def _largest_packet(
    opened: OpenedDevice, *, own_address: str, mtu_bytes: int, low: int, high: int, step: int
) -> int | None:
    """Return the largest packet size, in the camera's steps, that arrives; None if none does.

    The camera's own packet size is restored afterwards.
    """
    most = min(mtu_bytes, high)
    sizes = {low + (size - low) // step * step for size in (most, *_USUAL_SIZES) if low <= size}
    sizes = {size for size in sizes if size <= most}
    with (
        translated_errors(opened.library, "GevSCPSPacketSize"),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
    ):
        receiver.bind((own_address, 0))
        before = opened.device.read_register(_SIZE_REGISTER)
        opened.device.write_register(
            _ADDRESS_REGISTER, int.from_bytes(socket.inet_aton(own_address), "big")
        )
        opened.device.write_register(_PORT_REGISTER, receiver.getsockname()[1])
        try:
            # The sizes that always get through reveal a camera that sends no test packets at all;
            # it is not asked for the others.
            certain = sorted(size for size in sizes if size <= _SAFE_PACKET_BYTES)[::-1]
            jumbo = sorted(sizes - set(certain))[::-1]
            arrived = next((s for s in certain if _arrives(opened, receiver, s)), None)
            if arrived is None or arrived < certain[0]:
                return arrived
            return next((s for s in jumbo if _arrives(opened, receiver, s)), arrived)
        finally:
            opened.device.write_register(_PORT_REGISTER, 0)
            opened.device.write_register(_SIZE_REGISTER, before & ~_FIRE_TEST_PACKET)


def _arrives(opened: OpenedDevice, receiver: socket.socket, size: int) -> bool:
    for _ in range(_TRIES):
        opened.device.write_register(_SIZE_REGISTER, _FIRE_TEST_PACKET | _DO_NOT_FRAGMENT | size)
        deadline_s = time.monotonic() + _WAIT_S
        while (remaining_s := deadline_s - time.monotonic()) > 0:
            receiver.settimeout(remaining_s)
            try:
                datagram, sender = receiver.recvfrom(_SIZE_MASK)
            except TimeoutError:
                break
            # A late packet of another trial, or from another sender, does not count.
            if sender[0] == opened.name and len(datagram) == size - _IP_AND_UDP_HEADER_BYTES:
                return True
    return False


@dataclass(slots=True)
class _NeutralFeatures:
    """The features of the table that a camera has, as read back, and what it kept."""

    values: dict[str, FeatureValue] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def _neutralise(features: CameraFeatures, camera: str) -> _NeutralFeatures:
    """Give every feature of the table that the camera has its neutral value.

    It fails if the camera keeps a value that would falsify levels.
    """
    result = _NeutralFeatures()
    switched_off: set[str] = set()
    for row in neutral_features(camera):
        if not features.has(row.name):
            continue
        if not row.selector or not features.has(row.selector):
            _neutralise_one(features, row, row.name, result, switched_off)
            continue
        entries = features.entries(row.selector)
        for entry in entries:
            key = row.name if len(entries) == 1 else f"{row.name}[{entry}]"
            with features.selected(row.selector, entry):
                if features.has(row.name):
                    _neutralise_one(features, row, key, result, switched_off)
    return result


def _neutralise_one(
    features: CameraFeatures,
    row: FeatureName,
    key: str,
    result: _NeutralFeatures,
    switched_off: set[str],
) -> None:
    neutral = _neutral_value(features, row)
    refusal: DeviceError | None = None
    if neutral is not None:
        try:
            features.write(row.name, neutral)
        except (CameraFeatureError, DeviceInUseError) as error:
            refusal = error
    if neutral is None or refusal is not None:
        result.values[key] = kept = features.read(row.name)
        is_a_number = features.type_of(row.name) in ("integer", "float")
        if is_a_number and row.purpose in switched_off:
            return  # a strength without effect, as its switch is off
        told = " or ".join(row.neutral)
        if row.if_kept == "refuse":
            raise CameraFeatureError(
                f"the camera keeps {key} at {kept} instead of {told}, and levels would not be "
                f"those of the sensor ({row.purpose}); set it to {told} with the maker's program",
                feature=row.name,
            ) from refusal
        result.warnings.append(
            f"the camera keeps {key} at {kept} instead of {told} ({row.purpose}); this is recorded"
        )
        return
    result.values[key] = features.read(row.name)
    if features.type_of(row.name) in ("boolean", "enumeration"):
        switched_off.add(row.purpose)


def _neutral_value(features: CameraFeatures, row: FeatureName) -> FeatureValue | None:
    """The neutral value in the type that the feature has in this camera; None if it has none."""
    kind = features.type_of(row.name)
    if kind == "enumeration":
        entries = features.entries(row.name)
        return next((name for name in row.neutral if name in entries), None)
    if kind == "boolean":
        return {"true": True, "false": False}.get(row.neutral[0])
    if row.neutral == ("min",):
        low = features.bounds(row.name).low
        return round(low) if kind == "integer" else low
    number = next((float(text) for text in row.neutral if text.lstrip("-").isdigit()), None)
    if number is None:
        return None
    return round(number) if kind == "integer" else number


_FRAME_TRIGGERS = ("FrameStart", "ExposureStart", "FrameTrigger", "AcquisitionStart")
"""Entry of TriggerSelector that takes one frame, the first of these."""

_EDGES = {"rising": "RisingEdge", "falling": "FallingEdge"}


class _FrameRate:
    """The frame rate of one camera; ``asked_hz`` is reported where it has no such feature."""

    def __init__(self, features: CameraFeatures, camera: str, asked_hz: float) -> None:
        self._features = features
        self._camera = camera
        self._asked_hz = asked_hz

    def hz(self) -> float:
        """Present frame rate, which long exposures lower."""
        name = self._name("frame rate")
        set_hz = self._asked_hz if name is None else self._features.number(name)
        return min(set_hz, self._limit_hz(), self._resulting_hz())

    def bounds_hz(self) -> Bounds:
        """Frame rates at the present exposure, region, packet size and bandwidth."""
        name = self._name("frame rate")
        if name is None:
            return Bounds(low=0.0, high=min(self._limit_hz(), self._resulting_hz()))
        bounds = self._features.bounds(name)
        return Bounds(low=bounds.low, high=min(bounds.high, self._limit_hz()))

    def set(self) -> tuple[str, ...]:
        """Set the frame rate of the bench file, or the highest possible; return warnings."""
        name = self._name("frame rate")
        if name is None:
            return (
                "the camera has no frame rate to set; camera.frame_rate_hz "
                f"{self._asked_hz:g} is used for the time limits only",
            )
        wanted_hz = min(self._asked_hz, self.bounds_hz().high)
        self._features.send(name, wanted_hz)
        found_hz = self._features.number(name)
        if not abs(found_hz - wanted_hz) <= 0.01 * wanted_hz:
            raise CameraFeatureError(
                f"the camera does not keep {name}: set to {wanted_hz:g}, "
                f"it reads back {found_hz:g}",
                feature=name,
            )
        if self.hz() >= 0.999 * self._asked_hz:
            return ()
        return (
            f"camera.frame_rate_hz {self._asked_hz:g} is beyond what the camera can do at this "
            f"exposure, region and packet size; it runs at {self.hz():.2f}",
        )

    def restore(self) -> float:
        """Return to the frame rate of the bench file, as far as the exposure allows; in Hz."""
        if self.hz() < 0.99 * min(self._asked_hz, self.bounds_hz().high):
            self.set()
        return self.hz()

    def _limit_hz(self) -> float:
        name = self._name("frame rate limit")
        return float("inf") if name is None else self._features.number(name)

    def _resulting_hz(self) -> float:
        name = self._name("resulting frame rate")
        return float("inf") if name is None else self._features.number(name) or float("inf")

    def _name(self, purpose: str) -> str | None:
        return self._features.first_of([row.name for row in names_for(purpose, self._camera)])


def _set_trigger(features: CameraFeatures, source: str, edge: str) -> dict[str, FeatureValue]:
    """Let each frame wait for ``software`` or a line like ``Line1``; return what was read back."""
    for name in ("TriggerMode", "TriggerSource"):
        if not features.has(name):
            raise CameraFeatureError(
                f'camera.trigger {source!r}: the camera has no {name}; set camera.trigger to "off"',
                feature=name,
            )
    wanted: dict[str, FeatureValue] = {}
    if features.has("TriggerSelector"):
        entries = features.entries("TriggerSelector")
        selector = next((name for name in _FRAME_TRIGGERS if name in entries), None)
        if selector is not None:
            wanted["TriggerSelector"] = selector
            features.write("TriggerSelector", selector)
    sources = {entry.casefold(): entry for entry in features.entries("TriggerSource")}
    if source.casefold() not in sources:
        raise CameraFeatureError(
            f"camera.trigger {source!r}: this camera is triggered by "
            f"{', '.join(sources.values()) or 'nothing'}",
            feature="TriggerSource",
        )
    wanted["TriggerSource"] = sources[source.casefold()]
    if source.casefold() != "software" and features.has("TriggerActivation"):
        wanted["TriggerActivation"] = _EDGES[edge]
    wanted["TriggerMode"] = "On"
    for name, value in wanted.items():
        features.write(name, value)
    return {name: features.read(name) for name in wanted}


NO_TRIGGER = "off"

_MOST_PIXELS = 100_000
"""No sensor is as wide; a description without a limit says 2**31 and more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _AppliedConfiguration:
    """The settings as read back from the camera, and warnings for the operator."""

    settings: CameraSettings
    warnings: tuple[str, ...]


class CameraControls:
    """Exposure, gain and all other settings of one open camera."""

    def __init__(self, opened: OpenedDevice, frame_rate_asked_hz: float) -> None:
        self._opened = opened
        self.features = CameraFeatures(opened)
        # Without it, values out of range reach the camera, which clips some and accepts others.
        opened.camera.set_range_check_policy(opened.library.api.RangeCheckPolicy.ENABLE)
        with translated_errors(opened.library, "its identity"):
            vendor = text_of(opened.camera.get_vendor_name)
            self._name = f"{vendor} {text_of(opened.camera.get_model_name)}"
        self.levels = LevelControls(self.features, self._name)
        self.frame_rate = _FrameRate(self.features, self._name, frame_rate_asked_hz)

    def configure(self, config: CameraConfig) -> _AppliedConfiguration:
        """Apply all settings of the bench file."""
        with translated_errors(self._opened.library, "AcquisitionStop"):
            # A program that was killed may have left it streaming, with its settings locked.
            self._opened.camera.stop_acquisition()
        self._set_pixel_format(config.pixel_format)
        neutral = _neutralise(self.features, self._name)
        self.levels.select_master_gain()
        self._set_region(config.region_px)
        warnings: tuple[str, ...] = ()
        if self._opened.is_gige:
            warnings = _set_packet_size(self._opened, self.features, config.packet_size_bytes)
        self._set_throughput(config.bandwidth_limit_bytes_per_s)
        self.levels.set_exposure_us(config.exposure_us)
        if config.gain_counts is None:
            self.levels.set_gain_db(config.gain_db)
        else:
            self.levels.set_gain_counts(config.gain_counts)
        warnings += self.frame_rate.set()
        if config.trigger != NO_TRIGGER:
            neutral.values |= _set_trigger(self.features, config.trigger, config.trigger_edge)
        settings = self._read_settings(neutral)
        return _AppliedConfiguration(
            settings=settings,
            warnings=(*warnings, *neutral.warnings, *_unscaled_warnings(settings)),
        )

    def chunks(self) -> FrameChunks:
        """Switch on what the camera states with each frame; before the stream is made."""
        return FrameChunks(self._opened, self.features, self._name)

    def pixel_formats(self) -> tuple[str, ...]:
        """The camera's pixel formats; `can_decode` says which of them can be used."""
        with translated_errors(self._opened.library, "PixelFormat"):
            return tuple(self._opened.camera.dup_available_pixel_formats_as_strings() or ())

    def _read_settings(self, neutral: _NeutralFeatures) -> CameraSettings:
        """Read back everything that a session records."""
        features: dict[str, FeatureValue] = {
            name: self.features.read(name)
            for name in ("OffsetX", "OffsetY", _PACKET_SIZE)
            if self.features.has(name)
        }
        features |= neutral.values
        throughput = self._first("throughput")
        if throughput is not None:
            features[throughput] = self.features.read(throughput)
        gain, black_level = self.levels.gain(), self.levels.black_level()
        for stated in (gain, black_level):
            if stated is not None:
                features[stated.feature] = stated.value
        with translated_errors(self._opened.library, "PixelFormat"):
            pixel_format = str(self._opened.camera.get_pixel_format_as_string())
        settings = CameraSettings(
            width_px=whole(self.features.number("Width"), "Width"),
            height_px=whole(self.features.number("Height"), "Height"),
            pixel_format=pixel_format,
            exposure_us=self.levels.exposure_us(),
            gain_db=gain.decibels,
            frame_rate_hz=self.frame_rate.hz(),
            black_level_dn=0.0,
            gain=gain.value,
            gain_unit=gain.unit,
            features=features,
        )
        _require_usable(settings)
        return _with_black_level(settings, black_level)

    def _set_pixel_format(self, pixel_format: str) -> None:
        offered = self.pixel_formats()
        usable = [name for name in offered if can_decode(name)]
        if pixel_format not in usable:
            cannot = "cannot be decoded here" if pixel_format in offered else "is not available"
            remedy = (
                f"set one of this camera's {', '.join(usable)}"
                if usable
                else "and none of the formats that this camera has can be decoded here either: "
                f"{', '.join(offered) or 'none'}"
            )
            raise CameraFeatureError(
                f"PixelFormat (camera.pixel_format) {pixel_format!r} {cannot}; {remedy}",
                feature="PixelFormat",
            )
        with translated_errors(self._opened.library, "PixelFormat"):
            self._opened.camera.set_pixel_format_from_string(pixel_format)
            found = str(self._opened.camera.get_pixel_format_as_string())
        if found != pixel_format:
            raise CameraFeatureError(
                f"the camera does not keep PixelFormat: set to {pixel_format}, "
                f"it reads back {found}",
                feature="PixelFormat",
            )

    def _set_region(self, region_px: tuple[int, int, int, int] | None) -> None:
        """Set the region, or the largest one: that is how cameras without SensorWidth tell it."""
        for offset in ("OffsetX", "OffsetY"):
            if self.features.has(offset):
                self.features.write(offset, 0)
        sizes = {}
        for size, place in (("Width", 2), ("Height", 3)):
            asked = None if region_px is None else region_px[place]
            sizes[size] = self._fitting(size, asked)
        for size, value in sizes.items():
            self.features.write(size, value)
        if region_px is None:
            return
        for offset, value in (("OffsetX", region_px[0]), ("OffsetY", region_px[1])):
            if value or self.features.has(offset):
                self.features.write(offset, self._fitting(offset, value))

    def _fitting(self, feature: str, asked: int | None) -> int:
        """The size or offset asked for, or the largest one."""
        bounds, step = self.features.bounds(feature), max(1, round(self.features.step(feature)))
        low = whole(bounds.low, feature)
        steps = (whole(bounds.high, feature) - low) // step
        high = low + steps * step
        if high > _MOST_PIXELS:
            raise CameraFeatureError(
                f"the camera does not state how large its sensor is ({feature} up to {high}); set "
                "camera.region_px to left, top, width, height",
                feature=feature,
            )
        if asked is None:
            return high
        if low <= asked <= high and (asked - low) % step == 0:
            return asked
        below = min(max(low + (asked - low) // step * step, low), high)
        nearest = sorted({below, min(below + step, high)})
        raise CameraFeatureError(
            f"camera.region_px: {feature} {asked} is not possible: it goes from {low} to {high} "
            f"in steps of {step}; the nearest: {' and '.join(map(str, nearest))}",
            feature=feature,
        )

    def _set_throughput(self, limit_bytes_per_s: int | None) -> None:
        if limit_bytes_per_s is None:
            return
        feature = self._first("throughput")
        if feature is None:
            raise CameraFeatureError(
                "camera.bandwidth_limit_bytes_per_s: this camera has no such limit",
                feature=names_for("throughput", self._name)[0].name,
            )
        switch = self._first("throughput switch")
        if switch is not None:
            self.features.write(switch, "On")
        self.features.write(feature, limit_bytes_per_s)

    def _first(self, purpose: str) -> str | None:
        return self.features.first_of([row.name for row in names_for(purpose, self._name)])


def _require_usable(settings: CameraSettings) -> None:
    """Refuse sizes and times that no frame can have, before anything is divided by them."""
    for feature, value in (
        ("Width", settings.width_px),
        ("Height", settings.height_px),
        ("ExposureTime", settings.exposure_us),
        ("AcquisitionFrameRate", settings.frame_rate_hz),
    ):
        if not 0 < value < inf:
            raise CameraFeatureError(
                f"the camera states {feature} as {value:g}; restart it, or load its default "
                "settings with the maker's program",
                feature=feature,
            )


def _with_black_level(settings: CameraSettings, stated: StatedValue | None) -> CameraSettings:
    if stated is None:
        return settings
    return replace(
        settings,
        black_level_dn=stated.levels_dn(settings.max_level_dn) or 0.0,
        black_level=stated.value,
        black_level_unit=stated.unit,
    )


def _unscaled_warnings(settings: CameraSettings) -> tuple[str, ...]:
    if settings.black_level_unit != COUNTS or not settings.black_level:
        return ()
    return (
        f"the camera's black level is {settings.black_level:g} counts of unknown scale; it is "
        "recorded as 0 DN beside its counts; captures of kind dark measure it in DN",
    )
