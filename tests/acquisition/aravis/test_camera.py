"""The driver over the real wire protocol, against the simulated GigE camera."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import acquisition.aravis._camera
import acquisition.aravis._device
from acquisition.aravis._camera import AravisCamera
from acquisition.aravis._device import load_aravis, open_device
from acquisition.averaging import average_frames
from acquisition.errors import (
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceTimeoutError,
)
from hil_mocks.gige._settings import GigeFaults
from hil_mocks.practice_bench import PracticeBench
from tests.acquisition.aravis_bench import camera_config, needs_aravis, opened, sent_image
from tests.busy_machine import BUSY_S
from tests.hil_mocks.gige_bench import free_addresses, gige_bench

pytestmark = needs_aravis

MONO = ["Mono8", "Mono12", "Mono12Packed", "Mono16"]
BAYER = ["BayerRG8", "BayerRG12", "BayerRG12Packed"]
SETTINGS = [(1000.0, 0.0), (4000.0, 6.0), (9000.0, 12.0)]


@pytest.fixture
def bench() -> Iterator[PracticeBench]:
    with gige_bench() as opened_bench:
        yield opened_bench


def assert_bit_exact(bench: PracticeBench, camera: AravisCamera) -> None:
    for exposure_us, gain_db in SETTINGS:
        assert camera.set_exposure_us(exposure_us) == exposure_us
        assert camera.set_gain_db(gain_db) == gain_db
        camera.start()
        for _ in range(2):
            frame = camera.next_frame(1.0)
            sent = sent_image(bench, camera, frame)
            assert frame.image_dn.dtype == sent.dtype
            np.testing.assert_array_equal(frame.image_dn, sent)
        camera.stop()


@pytest.mark.slow
@pytest.mark.parametrize("pixel_format", MONO)
def test_pictures_arrive_bit_exact(bench: PracticeBench, pixel_format: str) -> None:
    with opened(bench, pixel_format=pixel_format) as camera:
        assert_bit_exact(bench, camera)


@pytest.mark.slow
@pytest.mark.parametrize("pixel_format", BAYER)
def test_mosaics_of_a_colour_camera_arrive_bit_exact(pixel_format: str) -> None:
    with (
        gige_bench(bayer_order="RG") as bench,
        opened(bench, pixel_format=pixel_format) as camera,
    ):
        assert_bit_exact(bench, camera)


def test_a_region_is_cut_out_where_it_was_asked_for(bench: PracticeBench) -> None:
    with opened(bench, region_px=(20, 6, 40, 32)) as camera:
        assert (camera.settings.width_px, camera.settings.height_px) == (40, 32)
        assert_bit_exact(bench, camera)


def test_without_a_region_the_whole_sensor_is_read_out_whatever_ran_before(
    bench: PracticeBench,
) -> None:
    with opened(bench, region_px=(20, 6, 40, 32)):
        pass
    with opened(bench) as camera:
        assert (camera.settings.width_px, camera.settings.height_px) == (96, 64)
        assert camera.settings.features["OffsetX"] == 0


def test_the_settings_are_those_read_back(bench: PracticeBench) -> None:
    with opened(bench, exposure_us=4000.4, gain_db=3.0) as camera:
        settings = camera.settings
        assert settings.exposure_us == bench.camera.value("ExposureTimeAbs") == 4000.0
        assert settings.gain_db == bench.camera.value("Gain") == 3.0
        assert settings.frame_rate_hz == pytest.approx(60.0)
        assert settings.black_level_dn == bench.truth.black_level_dn
        assert settings.features["GevSCPSPacketSize"] == 1500
        assert camera.info.driver == "aravis"
        assert camera.warnings == ()


def test_the_black_level_of_an_eight_bit_picture_is_in_its_own_dn(bench: PracticeBench) -> None:
    with opened(bench, pixel_format="Mono8") as camera:
        assert camera.settings.black_level_dn == bench.truth.black_level_dn / 16


def test_what_falsifies_levels_is_switched_off_before_the_first_frame(
    bench: PracticeBench,
) -> None:
    left_behind = open_device(bench.camera.address)
    left_behind.camera.set_boolean("GammaEnable", True)
    left_behind.camera.set_float("Gamma", 0.45)
    left_behind.camera.set_boolean("LUTEnable", True)
    for feature, value in (
        ("AcquisitionMode", "SingleFrame"),
        ("TriggerSource", "Software"),
        ("TriggerMode", "On"),
    ):
        left_behind.camera.set_string(feature, value)
    left_behind.close()
    with opened(bench) as camera:
        features = camera.settings.features
        assert features["Gamma"] == 1.0
        assert features["GammaEnable"] is features["LUTEnable"] is False
        assert features["ExposureAuto"] == features["GainAuto"] == features["TriggerMode"] == "Off"
        assert average_frames(camera, 2).frames_used == 2


def test_a_frame_rate_beyond_the_limit_is_lowered_and_said(bench: PracticeBench) -> None:
    with opened(bench, frame_rate_hz=500.0) as camera:
        assert camera.settings.frame_rate_hz == pytest.approx(67.5)
        assert "camera.frame_rate_hz 500" in camera.warnings[0]
        assert "67.50" in camera.warnings[0]


def test_a_long_exposure_lowers_the_frame_rate_that_the_deadlines_go_by(
    bench: PracticeBench,
) -> None:
    with opened(bench) as camera:
        camera.set_exposure_us(100_000.0)
        assert camera.settings.frame_rate_hz == pytest.approx(10.0)
        assert average_frames(camera, 2).frames_used == 2
        camera.set_exposure_us(4000.0)
        assert camera.settings.frame_rate_hz == pytest.approx(60.0)


def test_a_frame_rate_lowered_at_the_opening_rises_when_the_exposure_falls(
    bench: PracticeBench,
) -> None:
    with opened(bench, exposure_us=50_000.0) as camera:
        assert camera.settings.frame_rate_hz == pytest.approx(20.0)
        camera.set_exposure_us(4000.0)
        assert camera.settings.frame_rate_hz == pytest.approx(60.0)


@pytest.mark.slow
def test_the_largest_packet_that_gets_through_is_negotiated_and_read_back() -> None:
    # At power-up the camera has 8228 bytes, more than the link of 1500 carries.
    for link_mtu_bytes, least, most in ((1500, 1500, 1500), (9000, 8000, 9000)):
        with (
            gige_bench(link_mtu_bytes=link_mtu_bytes) as bench,
            opened(bench, packet_size_bytes=None) as camera,
        ):
            assert least <= int(camera.settings.features["GevSCPSPacketSize"]) <= most
            camera.start()
            assert camera.next_frame(1.0).is_complete


def test_a_packet_size_that_is_asked_for_is_kept(bench: PracticeBench) -> None:
    with opened(bench, packet_size_bytes=600) as camera:
        assert camera.settings.features["GevSCPSPacketSize"] == 600
        assert_bit_exact(bench, camera)


def test_a_bandwidth_limit_is_set_and_lowers_the_frame_rate(bench: PracticeBench) -> None:
    with opened(bench, packet_size_bytes=600, bandwidth_limit_bytes_per_s=1_000_000) as camera:
        assert bench.camera.value("StreamBytesPerSecond") == 1_000_000
        assert camera.settings.features["StreamBytesPerSecond"] == 1_000_000
        assert camera.settings.frame_rate_hz == pytest.approx(57, abs=5)


@pytest.mark.parametrize(
    ("keys", "feature"),
    [
        ({"exposure_us": 1.0}, "ExposureTimeAbs"),
        ({"gain_db": 99.0}, "Gain"),
        ({"pixel_format": "BayerRG12"}, "PixelFormat"),
        ({"region_px": (0, 0, 4000, 64)}, "Width"),
        ({"packet_size_bytes": 15999}, "GevSCPSPacketSize"),
    ],
)
def test_a_setting_that_the_camera_does_not_take_is_named(
    bench: PracticeBench, keys: dict[str, Any], feature: str
) -> None:
    with pytest.raises(CameraFeatureError) as caught:
        AravisCamera.open(camera_config(bench.camera.address, **keys))
    assert feature in caught.value.feature
    # The error, though it lives, does not hold the camera.
    with opened(bench):
        pass


def test_a_refused_register_is_an_error_that_names_the_feature(bench: PracticeBench) -> None:
    with opened(bench) as camera:
        bench.camera.faults = GigeFaults(refused_registers=frozenset({"ExposureTimeAbs"}))
        with pytest.raises(CameraFeatureError) as refused:
            camera.set_exposure_us(1000.0)
        assert refused.value.feature == "ExposureTimeAbs"
        assert camera.settings.exposure_us == 4000.0


def test_a_camera_that_another_program_controls_is_refused(bench: PracticeBench) -> None:
    with opened(bench) as camera:
        with pytest.raises(DeviceInUseError):
            AravisCamera.open(camera_config(bench.camera.address))
        assert average_frames(camera, 2).frames_used == 2


@pytest.mark.slow
def test_an_address_without_a_camera_is_an_error_within_seconds_and_nothing_is_searched(
    bench: PracticeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    library = load_aravis()

    class Guarded:
        """The library, which notes whether anyone searches."""

        def __getattr__(self, name: str) -> object:
            asked.append(name)
            return getattr(library.api, name)

    guarded = acquisition.aravis._device.AravisLibrary(
        api=Guarded(),
        gio=library.gio,
        glib=library.glib,
        aravis_version="",
        pygobject_version="",
    )
    monkeypatch.setattr(acquisition.aravis._device, "load_aravis", lambda: guarded)
    begin_s = time.monotonic()
    with pytest.raises(DeviceDisconnectedError):
        AravisCamera.open(camera_config(next(free_addresses())))
    assert time.monotonic() - begin_s < 4 + BUSY_S
    assert asked == []  # no description was read, and Aravis is given none
    with opened(bench):
        assert "GvDevice" in asked
    assert not {"update_device_list", "open_device"} & set(asked)


def test_frames_that_waited_are_dropped_at_the_next_start(bench: PracticeBench) -> None:
    with opened(bench) as camera:
        camera.start()
        while camera.statistics().complete_frames < 6:  # nobody fetches them
            time.sleep(0.01)
        camera.stop()
        camera.start()
        frame = camera.next_frame(1.0)
        assert frame.frame_id == 1
        np.testing.assert_array_equal(frame.image_dn, sent_image(bench, camera, frame))


def test_after_a_short_series_the_next_one_loses_no_frame(bench: PracticeBench) -> None:
    # Aravis takes ids up to ten behind the last one for late packets and drops them.
    with opened(bench, frame_rate_hz=25.0) as camera:  # time for a busy machine
        for _ in range(5):
            camera.start()
            assert [camera.next_frame(1.0).frame_id for _ in range(3)] == [1, 2, 3]
            camera.stop()


def test_frame_ids_wrap_from_65535_to_1_within_an_average(bench: PracticeBench) -> None:
    with opened(bench) as camera:
        bench.camera.begin_blocks_at(65532)
        averaged = average_frames(camera, 8)
        assert (averaged.frames_used, averaged.incomplete_frames) == (8, 0)
        camera.start()
        ids = [camera.next_frame(1.0).frame_id for _ in range(6)]
        assert ids == [65532, 65533, 65534, 65535, 1, 2]


def test_a_frame_that_lost_packets_is_incomplete_and_empty(bench: PracticeBench) -> None:
    bench.camera.faults = GigeFaults(packet_loss_rate=0.5, resend_disabled=True, seed=3)
    with opened(bench, packet_size_bytes=600) as camera:
        camera.start()
        frame = camera.next_frame(1.0)
        assert not frame.is_complete
        assert frame.image_dn.size == 0
        assert camera.statistics().incomplete_frames > 0
        assert camera.statistics().missing_packets > 0


@pytest.mark.slow
def test_waiting_is_bounded_by_the_time_given(bench: PracticeBench) -> None:
    with opened(bench, exposure_us=500_000.0) as camera:
        camera.start()
        begin_s = time.monotonic()
        with pytest.raises(DeviceTimeoutError) as refused:
            camera.next_frame(0.2)
        assert refused.value.timeout_s == 0.2
        assert 0.2 <= time.monotonic() - begin_s < 0.4 + BUSY_S
        assert camera.next_frame(2.0 + BUSY_S).is_complete


def test_a_small_receive_buffer_is_a_warning(
    bench: PracticeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(acquisition.aravis._camera, "receive_buffer_limit_bytes", lambda: 212992)
    with opened(bench) as camera:
        assert "net.core.rmem_max=4194304" in camera.warnings[0]


def test_a_closed_camera_does_nothing_more_and_is_free_for_others(bench: PracticeBench) -> None:
    with opened(bench) as camera:
        camera.start()
    assert bench.camera.controller is None
    for use in (camera.start, lambda: camera.next_frame(1.0), lambda: camera.set_gain_db(1.0)):
        with pytest.raises(DeviceError):
            use()
    camera.stop()
    with opened(bench):
        pass


def test_two_cameras_stream_side_by_side() -> None:
    with (
        gige_bench() as one,
        gige_bench() as other,
        opened(one) as left,
        opened(other) as right,
    ):
        left.start()
        right.start()
        for _ in range(3):
            for bench, camera in ((one, left), (other, right)):
                frame = camera.next_frame(1.0)
                np.testing.assert_array_equal(frame.image_dn, sent_image(bench, camera, frame))
