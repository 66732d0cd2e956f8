"""Configure a GigE Vision camera from the bench file and read its settings back."""

from dataclasses import dataclass, replace

from acquisition.aravis.device import OpenedDevice
from acquisition.aravis.errors import translated_errors
from acquisition.aravis.features import CameraFeatures, FeatureValue
from acquisition.aravis.library import AravisObject
from acquisition.aravis.packet_size import SAFE_PACKET_BYTES, largest_packet
from acquisition.aravis.pixel_decoding import can_decode
from acquisition.aravis.route import route_to
from acquisition.bench import CameraConfig
from acquisition.devices import CameraSettings
from acquisition.errors import CameraFeatureError, DeviceError

EXPOSURE_NAMES = ("ExposureTime", "ExposureTimeAbs")
GAIN_NAMES = ("Gain", "GainRaw", "GainAbs")
FRAME_RATE_NAMES = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
BANDWIDTH_NAMES = ("StreamBytesPerSecond", "DeviceLinkThroughputLimit")
"""The SFNC name first, then the older vendor name, as in Allied Vision's Manta."""

FRAME_RATE_LIMIT = "AcquisitionFrameRateLimit"

UNPROCESSED: tuple[tuple[str, FeatureValue], ...] = (
    ("AcquisitionMode", "Continuous"),
    ("ExposureMode", "Timed"),
    ("ExposureAuto", "Off"),
    ("GainAuto", "Off"),
    ("BalanceWhiteAuto", "Off"),
    ("GammaEnable", False),
    ("Gamma", 1.0),
    ("LUTEnable", False),
    ("BinningHorizontal", 1),
    ("BinningVertical", 1),
    ("DecimationHorizontal", 1),
    ("DecimationVertical", 1),
)
"""Processing that must be off in a measurement, for the features that a camera has."""

PACKET_SIZE = "GevSCPSPacketSize"

BLACK_LEVEL_SCALE = 4096
"""``BlackLevel`` counts in DN of the 12 bits of the converter, whatever the pixel format."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Smallest and largest value that a camera accepts at present."""

    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AppliedConfiguration:
    """The settings as read back from the camera, and warnings for the operator."""

    settings: CameraSettings
    warnings: tuple[str, ...]


class CameraControls:
    """Exposure, gain and all other settings of one open camera.

    Parameters
    ----------
    opened
        The camera; everything but the bounds needs control of it.
    """

    def __init__(self, opened: OpenedDevice) -> None:
        self._opened = opened
        self.features = CameraFeatures(opened)
        # Without it, values out of range reach the camera, which clips some and accepts others.
        opened.camera.set_range_check_policy(opened.library.api.RangeCheckPolicy.ENABLE)

    def configure(self, config: CameraConfig) -> AppliedConfiguration:
        """Apply all settings of the bench file.

        Raises
        ------
        CameraFeatureError
            If a setting is refused or not kept; the error names the feature.
        DeviceDisconnectedError, DeviceInUseError
            If the camera was lost meanwhile.
        """
        with translated_errors(self._opened.library, "AcquisitionStop"):
            # A program that was killed may have left it streaming, with its settings locked.
            self._opened.camera.stop_acquisition()
        for feature, value in UNPROCESSED:
            if self.features.has(feature):
                self.features.write(feature, value)
        with translated_errors(self._opened.library, "TriggerMode"):
            self._opened.camera.clear_triggers()
        self._set_pixel_format(config.pixel_format)
        self._set_region(config.region_px)
        warnings = self._set_packet_size(config.packet_size_bytes)
        self._set_bandwidth(config.bandwidth_limit_bytes_per_s)
        self.set_exposure_us(config.exposure_us)
        self.set_gain_db(config.gain_db)
        warnings += self._set_frame_rate(config.frame_rate_hz)
        return AppliedConfiguration(settings=self.read_settings(), warnings=warnings)

    def set_exposure_us(self, exposure_us: float) -> float:
        """Set the exposure and return the one read back, in us."""
        name = self._name(EXPOSURE_NAMES)
        with translated_errors(self._opened.library, name):
            self._opened.camera.set_exposure_time(exposure_us)
            found = float(self._opened.camera.get_exposure_time())
        self._require_kept(name, exposure_us, found)
        return found

    def raise_frame_rate(self, frame_rate_hz: float) -> float:
        """Return to the frame rate of the bench file, as far as the present exposure allows.

        Returns
        -------
        float
            The frame rate, in Hz.
        """
        wanted_hz = min(frame_rate_hz, self.frame_rate_bounds_hz().high)
        if self.frame_rate_hz() < 0.99 * wanted_hz:
            self._set_frame_rate(wanted_hz)
        return self.frame_rate_hz()

    def set_gain_db(self, gain_db: float) -> float:
        """Set the gain and return the one read back, in dB."""
        name = self._name(GAIN_NAMES)
        with translated_errors(self._opened.library, name):
            self._opened.camera.set_gain(gain_db)
            found = float(self._opened.camera.get_gain())
        self._require_kept(name, gain_db, found)
        return found

    def frame_rate_hz(self) -> float:
        """Present frame rate, which long exposures lower."""
        name = self._name(FRAME_RATE_NAMES)
        with translated_errors(self._opened.library, name):
            return min(
                float(self._opened.camera.get_frame_rate()), self.frame_rate_bounds_hz().high
            )

    def exposure_bounds_us(self) -> Bounds:
        """Exposures that the camera accepts, in us."""
        with translated_errors(self._opened.library, self._name(EXPOSURE_NAMES)):
            return _bounds(self._opened.camera.get_exposure_time_bounds())

    def gain_bounds_db(self) -> Bounds:
        """Gains that the camera accepts, in dB."""
        with translated_errors(self._opened.library, self._name(GAIN_NAMES)):
            return _bounds(self._opened.camera.get_gain_bounds())

    def frame_rate_bounds_hz(self) -> Bounds:
        """Frame rates at the present exposure, region, packet size and bandwidth."""
        with translated_errors(self._opened.library, self._name(FRAME_RATE_NAMES)):
            bounds = _bounds(self._opened.camera.get_frame_rate_bounds())
        if not self.features.has(FRAME_RATE_LIMIT):
            return bounds
        limit_hz = float(self.features.read(FRAME_RATE_LIMIT, float))
        return Bounds(low=bounds.low, high=min(bounds.high, limit_hz))

    def read_settings(self) -> CameraSettings:
        """Read back everything that a session records."""
        with translated_errors(self._opened.library, "the settings"):
            region = self._opened.camera.get_region()
            pixel_format = str(self._opened.camera.get_pixel_format_as_string())
            exposure_us = float(self._opened.camera.get_exposure_time())
            gain_db = float(self._opened.camera.get_gain())
            packet_size_bytes = int(self._opened.camera.gv_get_packet_size())
        features: dict[str, FeatureValue] = {
            "OffsetX": int(region.x),
            "OffsetY": int(region.y),
            PACKET_SIZE: packet_size_bytes,
        }
        for feature, value in UNPROCESSED:
            if self.features.has(feature):
                features[feature] = self.features.read(feature, type(value))
        if self.features.has("TriggerMode"):
            features["TriggerMode"] = self.features.read("TriggerMode", str)
        bandwidth = self.features.first_of(BANDWIDTH_NAMES)
        if bandwidth is not None:
            features[bandwidth] = self.features.read(bandwidth, int)
        settings = CameraSettings(
            width_px=int(region.width),
            height_px=int(region.height),
            pixel_format=pixel_format,
            exposure_us=exposure_us,
            gain_db=gain_db,
            frame_rate_hz=self.frame_rate_hz(),
            black_level_dn=0.0,
            features=features,
        )
        scale = (settings.max_level_dn + 1) / BLACK_LEVEL_SCALE
        return replace(settings, black_level_dn=self._black_level() * scale)

    def _black_level(self) -> float:
        with translated_errors(self._opened.library, "BlackLevel"):
            if not self._opened.camera.is_black_level_available():
                return 0.0
            return float(self._opened.camera.get_black_level())

    def _set_pixel_format(self, pixel_format: str) -> None:
        with translated_errors(self._opened.library, "PixelFormat"):
            offered = list(self._opened.camera.dup_available_pixel_formats_as_strings())
        usable = [name for name in offered if can_decode(name)]
        if pixel_format not in usable:
            raise CameraFeatureError(
                f"PixelFormat (camera.pixel_format) {pixel_format!r} is not available; this "
                f"camera has {', '.join(usable)}",
                feature="PixelFormat",
            )
        with translated_errors(self._opened.library, "PixelFormat"):
            self._opened.camera.set_pixel_format_from_string(pixel_format)
            found = str(self._opened.camera.get_pixel_format_as_string())
        _require_equal("PixelFormat", pixel_format, found)

    def _set_region(self, region_px: tuple[int, int, int, int] | None) -> None:
        with translated_errors(self._opened.library, "Width, Height, OffsetX, OffsetY"):
            if region_px is None:
                sensor = self._opened.camera.get_sensor_size()
                region_px = (0, 0, int(sensor.width), int(sensor.height))
            self._opened.camera.set_region(*region_px)
            found = self._opened.camera.get_region()
        for name, wanted, read in zip(
            ("OffsetX", "OffsetY", "Width", "Height"),
            region_px,
            (found.x, found.y, found.width, found.height),
            strict=True,
        ):
            _require_equal(name, wanted, int(read))

    def _set_packet_size(self, packet_size_bytes: int | None) -> tuple[str, ...]:
        warnings: tuple[str, ...] = ()
        with translated_errors(self._opened.library, PACKET_SIZE):
            # Making a stream would negotiate, unasked. A Manta's packet size at power-up is above
            # its own maximum; Aravis 0.8.26 then ends the process with an assertion.
            self._opened.camera.gv_set_packet_size_adjustment(
                self._opened.library.api.GvPacketSizeAdjustment.NEVER
            )
            if packet_size_bytes is None:
                bounds = self._opened.camera.get_integer_bounds(PACKET_SIZE)
                route = route_to(self._opened.ip_address)
                packet_size_bytes = largest_packet(
                    self._opened,
                    own_address=route.own_address,
                    mtu_bytes=route.mtu_bytes,
                    low=int(bounds.min),
                    high=int(bounds.max),
                    step=self._packet_size_step(),
                )
            if packet_size_bytes is None:
                packet_size_bytes = SAFE_PACKET_BYTES
                warnings = (
                    "no test packet arrived from the camera: a firewall blocks its stream, or it "
                    f"sends none; the packet size is set to {SAFE_PACKET_BYTES} bytes",
                )
            self._opened.camera.gv_set_packet_size(packet_size_bytes)
            found = int(self._opened.camera.gv_get_packet_size())
        _require_equal(PACKET_SIZE, packet_size_bytes, found)
        return warnings

    def _packet_size_step(self) -> int:
        try:
            return max(1, int(self._opened.camera.get_integer_increment(PACKET_SIZE)))
        except self._opened.library.glib.Error:
            return 1

    def _set_bandwidth(self, limit_bytes_per_s: int | None) -> None:
        if limit_bytes_per_s is None:
            return
        feature = self.features.first_of(BANDWIDTH_NAMES)
        if feature is None:
            raise CameraFeatureError(
                "camera.bandwidth_limit_bytes_per_s: this camera has no such limit",
                feature=BANDWIDTH_NAMES[0],
            )
        self.features.write(feature, limit_bytes_per_s)

    def _set_frame_rate(self, frame_rate_hz: float) -> tuple[str, ...]:
        name = self._name(FRAME_RATE_NAMES)
        high_hz = self.frame_rate_bounds_hz().high
        wanted_hz = min(frame_rate_hz, high_hz)
        with translated_errors(self._opened.library, name):
            self._opened.camera.set_frame_rate(wanted_hz)
            found_hz = float(self._opened.camera.get_frame_rate())
        if not abs(found_hz - wanted_hz) <= 0.01 * wanted_hz:
            raise CameraFeatureError(
                f"the camera does not keep {name}: set to {wanted_hz:g}, it reads {found_hz:g}",
                feature=name,
            )
        if wanted_hz == frame_rate_hz:
            return ()
        return (
            f"camera.frame_rate_hz {frame_rate_hz:g} is beyond what the camera can do at this "
            f"exposure, region and packet size; it runs at {found_hz:.2f}",
        )

    def _require_kept(self, feature: str, wanted: float, found: float) -> None:
        if not abs(found - wanted) <= max(self.features.step(feature), 0.001 * wanted):
            raise CameraFeatureError(
                f"the camera does not keep {feature}: set to {wanted:g}, it reads {found:g}",
                feature=feature,
            )

    def _name(self, names: tuple[str, ...]) -> str:
        found = self.features.first_of(names)
        if found is None:
            raise DeviceError(f"the camera has no feature {' or '.join(names)}; it cannot be used")
        return found


def _bounds(pair: AravisObject) -> Bounds:
    return Bounds(low=float(pair.min), high=float(pair.max))


def _require_equal(feature: str, wanted: FeatureValue, found: FeatureValue) -> None:
    if found != wanted:
        raise CameraFeatureError(
            f"the camera does not keep {feature}: set to {wanted}, it reads {found}",
            feature=feature,
        )
