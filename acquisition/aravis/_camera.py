"""A GenICam camera through Aravis: the `Camera` contract, with a watchdog and reconnection."""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from threading import Lock

from acquisition.aravis._configuration import NO_TRIGGER, CameraControls
from acquisition.aravis._device import (
    GIGE_VISION,
    AravisLibrary,
    OpenedDevice,
    load_aravis,
    open_camera,
    text_of,
    translated_errors,
)
from acquisition.aravis._features import Bounds, StatedValue
from acquisition.aravis._network import receive_buffer_limit_bytes
from acquisition.aravis._stream import (
    SOCKET_BUFFER_BYTES,
    FrameStream,
    can_decode,
    total_statistics,
)
from acquisition.bench import CameraConfig
from acquisition.devices import CameraSettings, DeviceInfo, Frame, StreamStatistics
from acquisition.errors import (
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceProtocolError,
    DeviceTimeoutError,
    StreamInterruptedError,
)

_FIRMWARE_NAMES = ("DeviceFirmwareVersion", "DeviceVersion")
_SERIAL_NUMBER_NAMES = ("DeviceSerialNumber", "DeviceID")


def _connect_camera(config: CameraConfig) -> "_AravisConnection":
    """Open the camera of a bench file and configure it."""
    return _AravisConnection(open_camera(config), config)


class _AravisConnection:
    """A camera under our control, configured, with a stream; of no further use once it is lost."""

    def __init__(self, opened: OpenedDevice, config: CameraConfig) -> None:
        self._opened = opened
        self._stream: FrameStream | None = None
        try:
            self._require_control()
            self._controls = CameraControls(opened, config.frame_rate_hz)
            applied = self._controls.configure(config)
            self.settings = applied.settings
            self.warnings = (*applied.warnings, *_receive_buffer_warnings(opened))
            self.info = self._read_info()
            chunks = self._controls.chunks() if config.chunk_data else None
            bounds = self._controls.levels.exposure_bounds_us()
            self.exposure_limits_us = (bounds.low, bounds.high)
            self._stream = FrameStream(opened, self.settings, chunks)
        except BaseException:
            self.close()
            raise

    @property
    def is_lost(self) -> bool:
        """Whether the control channel has ended, as Aravis' heartbeat thread noticed.

        Polled: in a handler of the signal ``control-lost`` that thread might drop the device, join
        itself and end the process.
        """
        return not self._opened.is_controller

    @property
    def stream(self) -> FrameStream:
        """The stream of its frames."""
        if self._stream is None:
            raise DeviceError("the connection to the camera is closed")
        return self._stream

    def set_exposure_us(self, exposure_us: float) -> CameraSettings:
        """Set the exposure and return all settings: the frame rate may change with it."""
        self.settings = replace(
            self.settings,
            exposure_us=self._controls.levels.set_exposure_us(exposure_us),
            frame_rate_hz=self._controls.frame_rate.restore(),
        )
        return self.settings

    def set_gain_db(self, gain_db: float) -> CameraSettings:
        """Set the gain and return all settings."""
        gain = self._controls.levels.set_gain_db(gain_db)
        self.settings = replace(
            self.settings,
            gain_db=gain.decibels,
            gain=gain.value,
            features={**self.settings.features, gain.feature: gain.value},
        )
        return self.settings

    def trigger(self) -> None:
        """Take one frame, of a camera that waits for the software trigger."""
        self._controls.features.execute("TriggerSoftware")

    def close(self) -> None:
        """Drop stream, camera and device; 10 s later where the camera does not answer."""
        if self._stream is not None:
            self._stream.close()
        self._opened.close()

    def _require_control(self) -> None:
        if not self._opened.is_controller:
            raise DeviceInUseError(
                f"the camera at {self._opened.name} is in use by another program; close "
                "that program (one that was killed holds the camera for a few more seconds)"
            )

    def _read_info(self) -> DeviceInfo:
        features = self._controls.features
        firmware = features.first_of(_FIRMWARE_NAMES)
        serial_number = features.first_of(_SERIAL_NUMBER_NAMES)
        with translated_errors(self._opened.library, "DeviceVendorName"):
            return DeviceInfo(
                vendor=text_of(self._opened.camera.get_vendor_name),
                model=text_of(self._opened.camera.get_model_name),
                serial_number=(
                    str(features.read(serial_number))
                    if serial_number is not None
                    else text_of(self._opened.camera.get_device_serial_number)
                ),
                firmware="" if firmware is None else str(features.read(firmware)),
                driver="aravis",
            )


def _receive_buffer_warnings(opened: OpenedDevice) -> tuple[str, ...]:
    if not opened.is_gige:
        return ()
    limit_bytes = receive_buffer_limit_bytes()
    if limit_bytes is None or limit_bytes >= SOCKET_BUFFER_BYTES:
        return ()
    return (
        f"the receive buffer is limited to {limit_bytes} bytes, so frames will be lost; run "
        f"'sudo sysctl -w net.core.rmem_max={SOCKET_BUFFER_BYTES}'",
    )


_SFNC_NAMES = {
    "vendor": "DeviceVendorName",
    "model": "DeviceModelName",
    "serial_number": "DeviceSerialNumber",
    "firmware": "DeviceFirmwareVersion",
    "width_px": "Width",
    "height_px": "Height",
    "pixel_format": "PixelFormat",
    "exposure_us": "ExposureTime",
    "gain_db": "Gain",
    "gain": "Gain as stated",
    "gain_unit": "unit of Gain",
    "black_level": "BlackLevel as stated",
    "black_level_unit": "unit of BlackLevel",
    "frame_rate_hz": "AcquisitionFrameRate",
    "black_level_dn": "BlackLevel",
}

_RELATIVE_ROUNDING = 1e-6
_SOFTWARE = "software"


def _require_same_camera(
    info: DeviceInfo,
    info_now: DeviceInfo,
    settings: CameraSettings,
    settings_now: CameraSettings,
) -> None:
    """Compare identity and settings of a camera before and after it was reopened."""
    before = {**_named(info), **_named(settings)}
    now = {**_named(info_now), **_named(settings_now)}
    for feature in before | now:
        was, found = before.get(feature), now.get(feature)
        if not _is_same(was, found):
            raise CameraFeatureError(
                f"the camera came back with a different {feature}: {was} before, {found} now; the "
                "captures would not be comparable, so nothing more was captured",
                feature=feature,
            )


def _named(facts: DeviceInfo | CameraSettings) -> dict[str, object]:
    # A feature that has the name of a fact states the same in the camera's own unit.
    named = asdict(facts)
    return {
        **named.pop("features", {}),
        **{_SFNC_NAMES.get(field, field): value for field, value in named.items()},
    }


def _is_same(was: object, found: object) -> bool:
    if isinstance(was, float) and isinstance(found, float):
        return abs(found - was) <= _RELATIVE_ROUNDING * max(abs(was), abs(found))
    return was == found


_STALL_S = 1.0
_STALL_PERIODS = 5
"""A stream has stalled if no frame comes in the longer of these two times spent waiting for one."""

_WAIT_SLICE_S = 0.1
"""Longest wait inside Aravis, where neither Ctrl-C nor a lost control channel is noticed."""

_RECONNECT_PAUSE_S = 0.1

_LONG_S = 1.0
"""Exposures above it are aborted when the stream is stopped, and are given time to end."""


class AravisCamera:
    """A camera that has been opened; `open` makes one.

    A stream that stalls, or whose control channel ends, raises `StreamInterruptedError`. The next
    `start` then drops every Aravis object, reopens the camera within ``reconnect_timeout_s``,
    configures it again and compares all settings: no series mixes frames from before and after.
    With a software trigger each `next_frame` takes one frame; a silent trigger line is no stall.
    """

    def __init__(
        self,
        connection: _AravisConnection,
        config: CameraConfig,
        *,
        connect: Callable[[CameraConfig], _AravisConnection] = _connect_camera,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._connection: _AravisConnection | None = connection
        self._config = config
        self._connect = connect
        self._clock = clock
        self._sleep = sleep
        self._exposure_limits_us = connection.exposure_limits_us
        self._info = connection.info
        self._settings = connection.settings
        self._warnings = connection.warnings
        self._is_closed = False
        self._is_streaming = False
        self._is_interrupted = False
        self._waited_s = 0.0
        self._is_triggered = False
        self._triggered_s = -math.inf
        self._busy_until_s = -math.inf
        self._counting = Lock()
        self._counted_before = StreamStatistics(
            complete_frames=0, incomplete_frames=0, resent_packets=0, missing_packets=0
        )

    @classmethod
    def open(cls, config: CameraConfig) -> "AravisCamera":
        """Open the camera that the bench file names and apply its settings."""
        return cls(_connect_camera(config), config)

    @property
    def info(self) -> DeviceInfo:
        """See `Camera.info`."""
        return self._info

    @property
    def settings(self) -> CameraSettings:
        """See `Camera.settings`."""
        return self._settings

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the operator should know about network and settings, one line each."""
        return self._warnings

    @property
    def exposure_limits_us(self) -> tuple[float, float]:
        """See `LimitedExposureCamera`; read when the camera was opened."""
        return self._exposure_limits_us

    def set_exposure_us(self, exposure_us: float) -> float:
        """See `Camera.set_exposure_us`; the frame rate may change with it."""
        if self._period_s() > _LONG_S:
            # A camera that cannot abort finishes what it exposes.
            self._busy_until_s = self._clock() + self._period_s()
        self._settings = self._open_connection().set_exposure_us(exposure_us)
        self._config = self._config.model_copy(update={"exposure_us": self._settings.exposure_us})
        return self._settings.exposure_us

    def set_gain_db(self, gain_db: float) -> float:
        """See `Camera.set_gain_db`; the lowest gain of a camera that counts gain returns 0."""
        self._settings = self._open_connection().set_gain_db(gain_db)
        found_db = gain_db if self._settings.gain_db is None else self._settings.gain_db
        update = {"gain_db": found_db, "gain_counts": None}
        self._config = self._config.model_copy(update=update)
        return found_db

    def start(self) -> None:
        """See `Camera.start`; a lost camera is reopened first.

        It may take 15 s more than ``reconnect_timeout_s``: Aravis waits that long for an answer.
        """
        if self._is_closed:
            raise DeviceDisconnectedError("the camera is closed")
        if self._is_streaming:
            raise DeviceError("the camera is already streaming")
        deadline_s = self._clock() + self._config.reconnect_timeout_s
        if self._is_interrupted or not self._has_started():
            self._reconnect(deadline_s)
            self._open_connection().stream.start()
        self._is_streaming = True
        self._waited_s = 0.0
        self._is_triggered = False

    def next_frame(self, timeout_s: float) -> Frame:
        """See `Camera.next_frame`; if the stream stalled or the camera is lost, start it again."""
        connection = self._open_connection()
        if not self._is_streaming:
            raise DeviceError("the camera has not been started")
        deadline_s = self._clock() + timeout_s
        stall_s = max(_STALL_S, _STALL_PERIODS * self._period_s())
        stall_s += max(0.0, self._busy_until_s - self._clock())
        if self._is_software_triggered:
            self._sleep_until_ready(timeout_s)
            self._trigger(connection)
        elif self._config.trigger != NO_TRIGGER:
            stall_s = math.inf
        while True:
            wait_s = min(deadline_s - self._clock(), stall_s - self._waited_s, _WAIT_SLICE_S)
            frame = connection.stream.pop(wait_s)
            if connection.is_lost:
                raise self._interrupted(
                    "the control channel to the camera was lost (cable, power or another program)"
                )
            if frame is not None:
                self._waited_s = 0.0
                self._busy_until_s = -math.inf
                self._is_triggered = False
                return frame
            if connection.stream.restart_if_deaf() and self._is_software_triggered:
                self._is_triggered = False  # the frame that was asked for is lost
                self._trigger(connection)
            # The wait that was asked for, not the time that passed: while this program is not
            # scheduled, what receives its frames is not either.
            self._waited_s += max(wait_s, 0.0)
            if self._waited_s >= stall_s:
                raise self._interrupted(
                    f"the camera sent no frame for {stall_s:.1f} s (cable, power, firewall, or "
                    "packets too large for the network)"
                )
            if self._clock() >= deadline_s:
                raise DeviceTimeoutError(
                    f"no frame from the camera within {timeout_s:g} s", timeout_s=timeout_s
                )

    def stop(self) -> None:
        """See `Camera.stop`; a camera whose stream was interrupted is already stopped."""
        if not self._is_streaming:
            return
        self._is_streaming = False
        try:
            self._open_connection().stream.stop(is_exposing_long=self._period_s() > _LONG_S)
        except (DeviceDisconnectedError, DeviceInUseError) as error:
            raise self._interrupted(str(error)) from error

    def statistics(self) -> StreamStatistics:
        """See `Camera.statistics`; they continue across reconnections."""
        with self._counting:
            return self._counted()

    def close(self) -> None:
        """See `Camera.close`."""
        # A camera that no longer accepts the stop ends its stream when our control of it ends.
        with suppress(DeviceError):
            self.stop()
        self._is_closed = True
        self._drop_connection()

    @property
    def _ready_s(self) -> float:
        """When the next frame may be asked for."""
        return self._triggered_s + self._period_s()

    def _sleep_until_ready(self, timeout_s: float) -> None:
        """Wait until a frame may be asked for, no longer than ``timeout_s``."""
        left_s = self._ready_s - self._clock()
        if left_s > timeout_s and not self._is_triggered:
            self._sleep(timeout_s)
            raise DeviceTimeoutError(
                f"no frame from the camera within {timeout_s:g} s", timeout_s=timeout_s
            )

    def _trigger(self, connection: _AravisConnection) -> None:
        """Take one frame, unless one that was asked for has not come yet."""
        if self._is_triggered:
            return
        self._sleep(max(0.0, self._ready_s - self._clock()))
        connection.trigger()
        self._is_triggered = True
        self._triggered_s = self._clock()
        self._waited_s = 0.0

    @property
    def _is_software_triggered(self) -> bool:
        return self._config.trigger.casefold() == _SOFTWARE

    def _period_s(self) -> float:
        return max(1 / self._settings.frame_rate_hz, 1e-6 * self._settings.exposure_us)

    def _open_connection(self) -> _AravisConnection:
        if self._connection is None:
            raise DeviceDisconnectedError(
                "the camera is closed" if self._is_closed else "the camera is lost; start it again"
            )
        return self._connection

    def _counted(self) -> StreamStatistics:
        if self._connection is None:
            return self._counted_before
        return total_statistics(self._counted_before, self._connection.stream.statistics())

    def _drop_connection(self) -> None:
        if self._connection is None:
            return
        # Closing can take 10 s: another thread that asks for the statistics meanwhile is answered.
        with self._counting:
            self._counted_before = self._counted()
            connection, self._connection = self._connection, None
        connection.close()

    def _interrupted(self, reason: str) -> StreamInterruptedError:
        # What is left is dropped at the next start: that can take 10 s, and the error is due now.
        self._is_streaming = False
        self._is_interrupted = True
        return StreamInterruptedError(reason)

    def _has_started(self) -> bool:
        """Try to start; False if the camera is gone or another program has taken it."""
        if self._connection is None or self._connection.is_lost:
            return False
        try:
            self._connection.stream.start()
        except (DeviceDisconnectedError, DeviceInUseError):
            return False
        return True

    def _reconnect(self, deadline_s: float) -> None:
        self._drop_connection()
        while True:
            try:
                self._connection = self._connect(self._config)
            except (DeviceDisconnectedError, DeviceInUseError, DeviceProtocolError) as error:
                # Until the lost connection's heartbeat expires, the camera refuses a new one;
                # while it starts, its answers may be wrong.
                if self._clock() >= deadline_s:
                    raise DeviceDisconnectedError(
                        "the camera was lost and did not come back within "
                        f"{self._config.reconnect_timeout_s:g} s ({error}); check power and "
                        "cable, then run again"
                    ) from error
            else:
                break
            self._sleep(_RECONNECT_PAUSE_S)
        try:
            _require_same_camera(
                self._info, self._connection.info, self._settings, self._connection.settings
            )
        except DeviceError:
            self._drop_connection()
            raise
        self._settings = self._connection.settings
        self._warnings = self._connection.warnings
        self._is_interrupted = False


_TEMPERATURE = "DeviceTemperature"


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundCamera:
    """A camera that answered: its identity, its address (empty on USB), and its id.

    A bench file can name the camera by its address or its id.
    """

    address: str
    vendor: str
    model: str
    serial_number: str
    hardware_address: str
    id: str = ""
    transport: str = GIGE_VISION


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraProbe:
    """The present state of one camera; the limits are those at its present settings.

    ``temperature_c`` is None where the camera has no such feature, ``packet_size_bytes`` and
    ``resends_packets`` where it is not on a network.
    """

    vendor: str
    model: str
    name: str
    is_controllable: bool
    exposure_us: Bounds
    gain: tuple[StatedValue, StatedValue]
    frame_rate_hz: Bounds
    pixel_formats: tuple[str, ...]
    packet_size_bytes: int | None
    temperature_c: float | None
    resends_packets: bool | None = None
    undecoded_formats: tuple[str, ...] = ()


def list_cameras(load: Callable[[], AravisLibrary] = load_aravis) -> tuple[FoundCamera, ...]:
    """List the cameras that answer on any network interface or USB port; takes about a second."""
    api = load().api
    api.update_device_list()
    found = [
        FoundCamera(
            address=(
                text_of(api.get_device_address, index)
                if api.get_device_protocol(index) == GIGE_VISION
                else ""
            ),
            vendor=text_of(api.get_device_vendor, index),
            model=text_of(api.get_device_model, index),
            serial_number=text_of(api.get_device_serial_nbr, index),
            hardware_address=text_of(api.get_device_physical_id, index),
            id=text_of(api.get_device_id, index),
            transport=text_of(api.get_device_protocol, index),
        )
        for index in range(api.get_n_devices())
    ]
    return tuple(sorted(found, key=lambda camera: (camera.address, camera.id)))


def probe_camera(config: CameraConfig) -> CameraProbe:
    """Open the camera of a bench file, query it and release it."""
    opened = open_camera(config)
    try:
        controls = CameraControls(opened, config.frame_rate_hz)
        has_temperature = controls.features.has(_TEMPERATURE)
        formats = controls.pixel_formats()
        with translated_errors(opened.library, "its identity"):
            return CameraProbe(
                vendor=text_of(opened.camera.get_vendor_name),
                model=text_of(opened.camera.get_model_name),
                name=opened.name,
                is_controllable=opened.is_controller,
                exposure_us=controls.levels.exposure_bounds_us(),
                gain=controls.levels.gain_bounds(),
                frame_rate_hz=controls.frame_rate.bounds_hz(),
                pixel_formats=tuple(name for name in formats if can_decode(name)),
                undecoded_formats=tuple(name for name in formats if not can_decode(name)),
                packet_size_bytes=(
                    int(opened.camera.gv_get_packet_size()) if opened.is_gige else None
                ),
                temperature_c=controls.features.number(_TEMPERATURE) if has_temperature else None,
                resends_packets=opened.resends_packets,
            )
    finally:
        opened.close()
