import numpy as np
import pytest

from acquisition.errors import (
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceTimeoutError,
)
from hil_mocks.devices import CameraFaults, SimulatedCamera, following_frame_id
from tests.hil_mocks.benches import homed_bench


def started(faults: CameraFaults | None = None, **keys: object) -> SimulatedCamera:
    camera = homed_bench(**keys).camera
    if faults is not None:
        camera.faults = faults
    camera.start()
    return camera


def test_frame_ids_are_16_bit_and_wrap_to_1() -> None:
    assert following_frame_id(1) == 2
    assert following_frame_id(65534) == 65535
    assert following_frame_id(65535) == 1


def test_the_same_seed_gives_the_same_frames_and_another_seed_others() -> None:
    first, again, other = (started(simulated__seed=seed) for seed in (3, 3, 4))
    for _ in range(3):
        image_dn = first.next_frame(1.0).image_dn
        np.testing.assert_array_equal(image_dn, again.next_frame(1.0).image_dn)
        assert (image_dn != other.next_frame(1.0).image_dn).any()


def test_every_frame_and_every_capture_has_noise_of_its_own() -> None:
    camera = started()
    frames = [camera.next_frame(1.0).image_dn for _ in range(2)]
    camera.stop()
    camera.start()
    frames.append(camera.next_frame(1.0).image_dn)
    residuals = [frame - np.mean(frames, axis=0) for frame in frames]
    # The residuals of three independent frames correlate by -1/2; sqrt(1 / 6144 px) is 0.013.
    for a, b in ((0, 1), (0, 2), (1, 2)):
        correlation = np.corrcoef(residuals[a].ravel(), residuals[b].ravel())[0, 1]
        assert correlation == pytest.approx(-0.5, abs=0.06)


def test_a_frame_does_not_depend_on_what_failed_before_it() -> None:
    whole, torn = started(), started(CameraFaults(incomplete_frames=frozenset({0})))
    whole.next_frame(1.0)
    assert not torn.next_frame(1.0).is_complete
    np.testing.assert_array_equal(whole.next_frame(1.0).image_dn, torn.next_frame(1.0).image_dn)


def test_an_incomplete_frame_is_empty_and_counted() -> None:
    camera = started(CameraFaults(incomplete_frames=frozenset({1})))
    frames = [camera.next_frame(1.0) for _ in range(3)]
    assert [frame.is_complete for frame in frames] == [True, False, True]
    assert frames[1].image_dn.size == 0
    assert [frame.frame_id for frame in frames] == [1, 2, 3]
    assert camera.statistics().incomplete_frames == 1
    assert camera.statistics().missing_packets > 0


def test_a_lost_frame_is_a_timeout_that_takes_its_time_and_an_id() -> None:
    bench = homed_bench()
    bench.camera.faults = CameraFaults(lost_frames=frozenset({0}))
    bench.camera.start()
    before_s = bench.clock.now_s
    with pytest.raises(DeviceTimeoutError) as refused:
        bench.camera.next_frame(2.0)
    assert refused.value.timeout_s == 2.0
    assert bench.clock.now_s - before_s == pytest.approx(2.0)
    assert bench.camera.next_frame(2.0).frame_id == 2


def test_rates_of_failure_are_seeded_and_about_right() -> None:
    faults = CameraFaults(seed=9, incomplete_rate=0.2, lost_rate=0.1)
    fates = [faults.fate(index) for index in range(2000)]
    assert fates == [faults.fate(index) for index in range(2000)]
    # Binomial: five standard deviations.
    assert fates.count("incomplete") == pytest.approx(400, abs=90)
    assert fates.count("lost") == pytest.approx(200, abs=70)


def test_a_pulled_cable_stays_pulled() -> None:
    camera = started(CameraFaults(disconnect_at=1))
    camera.next_frame(1.0)
    with pytest.raises(DeviceDisconnectedError):
        camera.next_frame(1.0)
    camera.start()
    with pytest.raises(DeviceDisconnectedError):
        camera.next_frame(1.0)


def test_a_frozen_frame_id_stands_still() -> None:
    camera = started(CameraFaults(frozen_id_from=2))
    assert [camera.next_frame(1.0).frame_id for _ in range(5)] == [1, 2, 2, 2, 2]


def test_a_long_exposure_slows_the_camera_down() -> None:
    camera = started(camera__exposure_us=100_000.0)
    first, second = camera.next_frame(1.0), camera.next_frame(1.0)
    assert second.timestamp_ns - first.timestamp_ns == 100_000_000
    with pytest.raises(DeviceTimeoutError):
        camera.next_frame(0.05)


def test_mono8_has_a_sixteenth_of_the_black_level() -> None:
    camera = started(camera__pixel_format="Mono8")
    assert camera.settings.black_level_dn == 4.0
    assert camera.next_frame(1.0).image_dn.dtype == np.uint8


def test_a_pixel_format_that_it_does_not_have_is_refused() -> None:
    with pytest.raises(CameraFeatureError) as refused:
        homed_bench(camera__pixel_format="BayerRG8")
    assert refused.value.feature == "PixelFormat"


def test_a_closed_camera_does_nothing_more() -> None:
    camera = started()
    camera.close()
    with pytest.raises(DeviceDisconnectedError):
        camera.start()


def test_starting_twice_is_an_error() -> None:
    with pytest.raises(DeviceError):
        started().start()


def test_a_late_exposure_is_read_back_at_once_and_seen_frames_later() -> None:
    camera = homed_bench().camera
    camera.faults = CameraFaults(exposure_delay_frames=(2, 2), states_exposure=True)
    camera.start()
    frames = [camera.next_frame(1.0)]
    camera.stop()
    assert camera.set_exposure_us(4000.0) == camera.settings.exposure_us == 4000.0
    camera.start()
    frames += [camera.next_frame(1.0) for _ in range(3)]
    assert [frame.exposure_us for frame in frames] == [8000.0, 8000.0, 8000.0, 4000.0]
    light = [float(frame.image_dn.mean()) - 64.0 for frame in frames]
    # Half the light, to the noise of a mean of 6144 pixels: 0.02 %.
    assert [one / light[0] for one in light] == pytest.approx([1, 1, 1, 0.5], rel=2e-3)


def test_delays_are_drawn_for_each_change_from_the_seed() -> None:
    faults = CameraFaults(seed=4, exposure_delay_frames=(1, 5))
    delays = [faults.exposure_delay(change) for change in range(200)]
    assert set(delays) == {1, 2, 3, 4, 5}
    assert delays == [faults.exposure_delay(change) for change in range(200)]


def test_frames_state_no_exposure_unless_they_are_told_to() -> None:
    assert started().next_frame(1.0).exposure_us is None
