"""What the devices said they are and how they were set, under GenICam SFNC names."""

from typing import Any

from acquisition.devices import Camera, DeviceInfo, Stage

__all__ = ["camera_snapshot", "stage_snapshot"]


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


def _identity(info: DeviceInfo) -> dict[str, Any]:
    return {
        "driver": info.driver,
        "DeviceVendorName": info.vendor,
        "DeviceModelName": info.model,
        "DeviceSerialNumber": info.serial_number,
        "DeviceFirmwareVersion": info.firmware,
    }
