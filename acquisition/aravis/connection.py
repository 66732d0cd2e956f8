"""An opened and configured camera with its stream, made and dropped as a whole."""

from dataclasses import replace

from acquisition.aravis.configuration import CameraControls
from acquisition.aravis.device import OpenedDevice, open_camera
from acquisition.aravis.errors import translated_errors
from acquisition.aravis.library import text_of
from acquisition.aravis.route import receive_buffer_limit_bytes
from acquisition.aravis.stream import SOCKET_BUFFER_BYTES, FrameStream
from acquisition.bench import CameraConfig
from acquisition.devices import CameraSettings, DeviceInfo
from acquisition.errors import DeviceError, DeviceInUseError

FIRMWARE_NAMES = ("DeviceFirmwareVersion", "DeviceVersion")
SERIAL_NUMBER_NAMES = ("DeviceSerialNumber", "DeviceID")


def connect_camera(config: CameraConfig) -> "AravisConnection":
    """Open the camera of a bench file and configure it.

    Raises
    ------
    DeviceError
        As for `open_camera` and `AravisConnection`.
    """
    return AravisConnection(open_camera(config), config)


class AravisConnection:
    """A camera under our control, configured, with a stream that can be started.

    A lost connection is of no further use: close it and make a new one.

    Parameters
    ----------
    opened
        The camera.
    config
        Its settings.

    Raises
    ------
    DeviceInUseError
        If another program controls the camera.
    DeviceError
        If it cannot be configured as asked.
    """

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
        """Whether the control channel has ended: the camera is gone or another program has it.

        Aravis' heartbeat thread notices. It is polled, because the signal ``control-lost`` holds
        the device while a handler runs in that thread: if all other references are dropped
        meanwhile, the thread drops the device, joins itself and ends the process.
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
        """Drop stream, camera and device, and with them threads, sockets and control.

        A camera that does not answer delays this by about 10 s.
        """
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
        firmware = features.first_of(FIRMWARE_NAMES)
        serial_number = features.first_of(SERIAL_NUMBER_NAMES)
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
