"""Whether a camera that was opened again is the one that ran before, set as it was."""

from collections.abc import Iterator
from dataclasses import asdict

from acquisition.devices import CameraSettings, DeviceInfo
from acquisition.errors import CameraFeatureError

__all__ = ["require_same_camera"]

SFNC_NAMES = {
    "vendor": "DeviceVendorName",
    "model": "DeviceModelName",
    "serial_number": "DeviceSerialNumber",
    "firmware": "DeviceFirmwareVersion",
    "width_px": "Width",
    "height_px": "Height",
    "pixel_format": "PixelFormat",
    "exposure_us": "ExposureTime",
    "gain_db": "Gain",
    "frame_rate_hz": "AcquisitionFrameRate",
    "black_level_dn": "BlackLevel",
}

RELATIVE_ROUNDING = 1e-6


def require_same_camera(
    info: DeviceInfo,
    info_now: DeviceInfo,
    settings: CameraSettings,
    settings_now: CameraSettings,
) -> None:
    """Compare identity and settings of a camera before and after it was opened again.

    Raises
    ------
    CameraFeatureError
        If anything differs; it names the first feature and both values.
    """
    before = {**_named(info), **_named(settings)}
    now = {**_named(info_now), **_named(settings_now)}
    for feature in before | now:
        was, found = before.get(feature), now.get(feature)
        if not _is_same(was, found):
            raise CameraFeatureError(
                f"the camera came back with another {feature}: {was} before, {found} now; the "
                "captures would not compare, so nothing more was captured",
                feature=feature,
            )


def _named(facts: DeviceInfo | CameraSettings) -> dict[str, object]:
    return dict(_names_and_values(facts))


def _names_and_values(facts: DeviceInfo | CameraSettings) -> Iterator[tuple[str, object]]:
    for field, value in asdict(facts).items():
        if field == "features":
            yield from value.items()
        else:
            yield SFNC_NAMES.get(field, field), value


def _is_same(was: object, found: object) -> bool:
    if isinstance(was, float) and isinstance(found, float):
        return abs(found - was) <= RELATIVE_ROUNDING * max(abs(was), abs(found))
    return was == found
