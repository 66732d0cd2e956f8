"""The driver against Aravis' own fake camera: a device that shares no code with ours.

It is bound to 127.0.0.1 alone, so one test process at a time has it.
"""

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from acquisition.aravis._camera import AravisCamera, probe_camera
from acquisition.aravis._device import load_aravis
from acquisition.averaging import average_frames
from acquisition.errors import CameraFeatureError
from tests.acquisition.aravis_bench import camera_config, needs_aravis
from tests.hil_mocks.loopback_camera_port import loopback_camera_port

pytestmark = needs_aravis

ADDRESS = "127.0.0.1"
KEYS = {"pixel_format": "Mono8", "region_px": (0, 0, 128, 64), "frame_rate_hz": 100.0}


@pytest.fixture
def fake_camera() -> Iterator[None]:
    with loopback_camera_port():
        fake = load_aravis().api.GvFakeCamera.new(ADDRESS, "GV01")
        assert fake.is_running(), "another program has UDP port 3956 of 127.0.0.1"
        yield
        del fake


@pytest.mark.usefixtures("fake_camera")
def test_it_is_opened_under_its_vendor_names_and_streams() -> None:
    with closing(AravisCamera.open(camera_config(ADDRESS, **KEYS))) as camera:
        assert (camera.info.vendor, camera.info.serial_number) == ("Aravis", "GV01")
        assert (camera.settings.width_px, camera.settings.height_px) == (128, 64)
        assert camera.set_exposure_us(2000.0) == 2000.0  # ExposureTimeAbs
        # Its GainRaw states no unit: 0 dB is the lowest, and no other count is taken for decibels.
        assert camera.set_gain_db(0.0) == 0.0
        assert camera.settings.gain_db is None
        assert (camera.settings.gain, camera.settings.gain_unit) == (0.0, "counts")
        with pytest.raises(CameraFeatureError):
            camera.set_gain_db(2.0)
        averaged = average_frames(camera, 5)
        assert averaged.frames_used == 5
        assert averaged.mean_dn.shape == (64, 128)
        assert np.ptp(averaged.mean_dn) > 0  # its ramp


@pytest.mark.usefixtures("fake_camera")
def test_short_series_follow_each_other_without_loss() -> None:
    with closing(AravisCamera.open(camera_config(ADDRESS, **KEYS))) as camera:
        average_frames(camera, 2)  # the fake's first frame after opening lacks packets
        for _ in range(3):
            assert average_frames(camera, 2).incomplete_frames == 0


@pytest.mark.usefixtures("fake_camera")
def test_a_format_that_it_has_but_nobody_decodes_is_refused() -> None:
    with pytest.raises(CameraFeatureError) as refused:
        AravisCamera.open(camera_config(ADDRESS, **{**KEYS, "pixel_format": "RGB8"}))
    assert refused.value.feature == "PixelFormat"
    assert "'RGB8' cannot be decoded here" in str(refused.value)
    assert "Mono8" in str(refused.value)
    with pytest.raises(CameraFeatureError, match="'Mono12p' is not available"):
        AravisCamera.open(camera_config(ADDRESS, **{**KEYS, "pixel_format": "Mono12p"}))


@pytest.mark.slow  # it lets a second client wait when that one closes
@pytest.mark.usefixtures("fake_camera")
def test_a_probe_tells_the_limits_and_whether_another_program_has_control() -> None:
    with closing(AravisCamera.open(camera_config(ADDRESS, **KEYS))):
        assert not probe_camera(camera_config(ADDRESS)).is_controllable
    probe = probe_camera(camera_config(ADDRESS))
    assert probe.is_controllable
    assert (probe.exposure_us.low, probe.exposure_us.high) == (10.0, 1e7)  # its XML
    assert probe.temperature_c is None
    assert "RGB8" not in probe.pixel_formats
    assert "RGB8" in probe.undecoded_formats
