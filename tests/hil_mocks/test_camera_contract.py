"""What every camera does, through the `Camera` contract alone."""

from collections.abc import Iterator

import numpy as np
import pytest

from acquisition.devices import Camera
from acquisition.errors import CameraFeatureError, DeviceError
from hil_mocks.gige._features import MAKERS
from tests.acquisition.aravis_bench import needs_aravis, opened
from tests.hil_mocks.benches import homed_bench
from tests.hil_mocks.gige_bench import gige_bench


@pytest.fixture(
    params=["simulated", *(pytest.param(maker, marks=needs_aravis) for maker in MAKERS)]
)
def camera(request: pytest.FixtureRequest) -> Iterator[Camera]:
    if request.param == "simulated":
        simulated: Camera = homed_bench().camera
        yield simulated
        simulated.close()
    else:
        with gige_bench(maker=request.param) as bench, opened(bench) as camera:
            yield camera


def level_dn(camera: Camera) -> float:
    camera.start()
    image_dn = camera.next_frame(1.0).image_dn.astype(np.float64)
    camera.stop()
    return float(image_dn.mean())


def test_it_is_a_camera(camera: Camera) -> None:
    assert isinstance(camera, Camera)
    assert camera.info.driver
    assert camera.info.serial_number


def test_frames_have_the_shape_and_depth_of_the_settings(camera: Camera) -> None:
    camera.start()
    frame = camera.next_frame(1.0)
    assert frame.is_complete
    assert frame.image_dn.shape == (camera.settings.height_px, camera.settings.width_px)
    assert frame.image_dn.dtype == (np.uint8 if camera.settings.max_level_dn == 255 else np.uint16)
    assert frame.image_dn.max() <= camera.settings.max_level_dn


def test_frame_ids_and_timestamps_ascend(camera: Camera) -> None:
    camera.start()
    frames = [camera.next_frame(1.0) for _ in range(5)]
    assert np.diff([frame.frame_id for frame in frames]).tolist() == [1, 1, 1, 1]
    periods_s = np.diff([frame.timestamp_ns for frame in frames]) * 1e-9
    # Never closer than the frame rate; a busy machine may hold frames up, but not for a second.
    assert periods_s.min() > 0.99 / camera.settings.frame_rate_hz
    assert periods_s.max() < 1.0


def test_exposure_is_read_back_and_the_picture_follows_it_linearly(camera: Camera) -> None:
    levels = []
    for exposure_us in (2000.0, 4000.0, 6000.0):
        assert camera.set_exposure_us(exposure_us) == camera.settings.exposure_us == exposure_us
        levels.append(level_dn(camera))
    # Differences, as not every camera tells its black level in DN.
    assert levels[2] - levels[1] == pytest.approx(levels[1] - levels[0], rel=0.02)
    assert levels[1] > levels[0]


def test_gain_is_read_back_in_db_and_brightens_the_picture_or_is_refused(camera: Camera) -> None:
    def contrast_dn() -> float:
        camera.set_exposure_us(2000.0)
        dim = level_dn(camera)
        camera.set_exposure_us(4000.0)
        return level_dn(camera) - dim

    assert camera.set_gain_db(0.0) == 0.0
    lowest = contrast_dn()
    if camera.settings.gain_db is None:
        assert camera.settings.gain_unit == "counts"
        with pytest.raises(CameraFeatureError):
            camera.set_gain_db(6.0)
        return
    gain_db = camera.set_gain_db(6.0)
    assert gain_db == camera.settings.gain_db == pytest.approx(6.0)
    assert contrast_dn() == pytest.approx(lowest * 10 ** (gain_db / 20), rel=0.02)


def test_a_setting_out_of_range_is_refused_and_changes_nothing(camera: Camera) -> None:
    before = camera.settings
    with pytest.raises(DeviceError):
        camera.set_exposure_us(0.001)
    with pytest.raises(DeviceError):
        camera.set_gain_db(1000.0)
    assert camera.settings == before


def test_a_stopped_camera_starts_again(camera: Camera) -> None:
    for _ in range(2):
        camera.start()
        # A packet may be lost on a busy computer, and a frame with it, but not three in a row.
        assert any(camera.next_frame(1.0).is_complete for _ in range(3))
        camera.stop()


def test_a_camera_that_is_not_started_has_no_frames(camera: Camera) -> None:
    with pytest.raises(DeviceError):
        camera.next_frame(0.1)


def test_statistics_count_complete_frames(camera: Camera) -> None:
    before = camera.statistics().complete_frames
    camera.start()
    for _ in range(3):
        camera.next_frame(1.0)
    assert camera.statistics().complete_frames >= before + 3
    assert camera.statistics().incomplete_frames == 0


def test_closing_twice_is_harmless(camera: Camera) -> None:
    camera.close()
    camera.close()
