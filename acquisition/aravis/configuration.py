"""Configure a camera from the bench file and read its settings back."""

from dataclasses import dataclass, replace
from math import inf

from acquisition.aravis.chunks import FrameChunks
from acquisition.aravis.controls import (
    COUNTS,
    FrameRate,
    LevelControls,
    NeutralFeatures,
    StatedValue,
    neutralise,
    set_trigger,
)
from acquisition.aravis.device import OpenedDevice
from acquisition.aravis.errors import translated_errors
from acquisition.aravis.feature_names import names_for
from acquisition.aravis.features import CameraFeatures, FeatureValue, whole
from acquisition.aravis.library import text_of
from acquisition.aravis.packet_size import PACKET_SIZE, set_packet_size
from acquisition.aravis.pixel_decoding import can_decode
from acquisition.bench import CameraConfig
from acquisition.devices import CameraSettings
from acquisition.errors import CameraFeatureError

NO_TRIGGER = "off"

MOST_PIXELS = 100_000
"""No sensor is as wide; a description without a limit says 2**31 and more."""


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
    frame_rate_asked_hz
        Frame rate of the bench file.
    """

    def __init__(self, opened: OpenedDevice, frame_rate_asked_hz: float) -> None:
        self._opened = opened
        self.features = CameraFeatures(opened)
        # Without it, values out of range reach the camera, which clips some and accepts others.
        opened.camera.set_range_check_policy(opened.library.api.RangeCheckPolicy.ENABLE)
        with translated_errors(opened.library, "its identity"):
            vendor = text_of(opened.camera.get_vendor_name)
            self._name = f"{vendor} {text_of(opened.camera.get_model_name)}"
        self.levels = LevelControls(self.features, self._name)
        self.frame_rate = FrameRate(self.features, self._name, frame_rate_asked_hz)

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
        self._set_pixel_format(config.pixel_format)
        neutral = neutralise(self.features, self._name)
        self.levels.select_master_gain()
        self._set_region(config.region_px)
        warnings: tuple[str, ...] = ()
        if self._opened.is_gige:
            warnings = set_packet_size(self._opened, self.features, config.packet_size_bytes)
        self._set_throughput(config.bandwidth_limit_bytes_per_s)
        self.levels.set_exposure_us(config.exposure_us)
        if config.gain_counts is None:
            self.levels.set_gain_db(config.gain_db)
        else:
            self.levels.set_gain_counts(config.gain_counts)
        warnings += self.frame_rate.set()
        if config.trigger != NO_TRIGGER:
            neutral.values |= set_trigger(self.features, config.trigger, config.trigger_edge)
        settings = self._read_settings(neutral)
        return AppliedConfiguration(
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

    def _read_settings(self, neutral: NeutralFeatures) -> CameraSettings:
        """Read back everything that a session records."""
        features: dict[str, FeatureValue] = {
            name: self.features.read(name)
            for name in ("OffsetX", "OffsetY", PACKET_SIZE)
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
        require_usable(settings)
        return _with_black_level(settings, black_level)

    def _set_pixel_format(self, pixel_format: str) -> None:
        offered = self.pixel_formats()
        usable = [name for name in offered if can_decode(name)]
        if pixel_format not in usable:
            cannot = "cannot be decoded here" if pixel_format in offered else "is not available"
            remedy = (
                f"set one of this camera's {', '.join(usable)}"
                if usable
                else f"nor can what this camera has: {', '.join(offered) or 'nothing'}"
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
                f"the camera does not keep PixelFormat: set to {pixel_format}, it reads {found}",
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
        """The size or offset asked for, or the largest one.

        Raises
        ------
        CameraFeatureError
            If the camera does not have it; the error names the step and the nearest that it has.
        """
        bounds, step = self.features.bounds(feature), max(1, round(self.features.step(feature)))
        low = whole(bounds.low, feature)
        steps = (whole(bounds.high, feature) - low) // step
        high = low + steps * step
        if high > MOST_PIXELS:
            raise CameraFeatureError(
                f"the camera does not tell how large its sensor is ({feature} up to {high}); set "
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


def require_usable(settings: CameraSettings) -> None:
    """Refuse sizes and times that no frame can have, before anything is divided by them.

    Raises
    ------
    CameraFeatureError
        Names the first that is not possible.
    """
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
        "recorded as 0 DN beside its counts, and captures of kind dark tell it in DN",
    )
