from dataclasses import replace

import pytest

from acquisition.aravis.camera import require_same_camera
from acquisition.devices import CameraSettings, DeviceInfo
from acquisition.errors import CameraFeatureError
from tests.acquisition.fakes import SETTINGS

INFO = DeviceInfo(vendor="V", model="M", serial_number="S1", firmware="1", driver="aravis")


def test_the_same_camera_set_the_same_passes() -> None:
    nearly = replace(SETTINGS, exposure_us=SETTINGS.exposure_us * (1 + 1e-9))
    require_same_camera(INFO, INFO, SETTINGS, nearly)


@pytest.mark.parametrize(
    ("changes", "feature"),
    [
        ({"exposure_us": 2001.0}, "ExposureTime"),
        ({"gain_db": 1.0}, "Gain"),
        ({"width_px": 8}, "Width"),
        ({"pixel_format": "Mono8"}, "PixelFormat"),
        ({"frame_rate_hz": 49.0}, "AcquisitionFrameRate"),
        ({"features": {"Gamma": 0.5}}, "Gamma"),
        ({"features": {}}, "Gamma"),
        ({"features": {"Gamma": 1.0, "LUTEnable": True}}, "LUTEnable"),
    ],
)
def test_a_setting_that_differs_is_named(changes: dict[str, object], feature: str) -> None:
    now: CameraSettings = replace(SETTINGS, **changes)  # type: ignore[arg-type]  # by table
    with pytest.raises(CameraFeatureError) as caught:
        require_same_camera(INFO, INFO, SETTINGS, now)
    assert caught.value.feature == feature


def test_another_camera_at_the_same_address_is_named() -> None:
    other = replace(INFO, serial_number="S2")
    with pytest.raises(CameraFeatureError) as refused:
        require_same_camera(INFO, other, SETTINGS, SETTINGS)
    assert refused.value.feature == "DeviceSerialNumber"
