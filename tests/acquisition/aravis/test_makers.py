"""The driver on cameras with the feature names of six makers, as a viewer left them."""

import pytest

from acquisition.aravis._camera import AravisCamera, probe_camera
from acquisition.errors import CameraFeatureError
from hil_mocks.gige._features import MAKERS, Maker
from hil_mocks.gige._settings import GigeFaults
from tests.acquisition.aravis_bench import camera_config, needs_aravis, opened, sent_image
from tests.hil_mocks.gige_bench import gige_bench

pytestmark = needs_aravis

STATED = {
    "allied_vision": ("dB", "DN of 12 bits"),
    "basler": ("counts", "counts"),
    "flir": ("dB", "%"),
    "teledyne_dalsa": ("factor", "counts"),
    "hikrobot": ("dB", "counts"),
    "ids": ("factor", "counts"),
}


@pytest.mark.slow
@pytest.mark.parametrize("maker", MAKERS)
def test_what_a_viewer_left_switched_on_is_off_and_every_pixel_is_the_sensors(
    maker: Maker,
) -> None:
    with gige_bench(maker=maker) as bench, opened(bench) as camera:
        bench.place("brick", 30)  # unlike its mirror image
        bench.source.levels_dn(bench.camera.request)  # rendered before anyone waits for it
        camera.start()
        frame = camera.next_frame(1.0)
        assert (frame.image_dn == sent_image(bench, camera, frame)).all()


@pytest.mark.parametrize("maker", MAKERS)
def test_gain_and_black_level_have_the_units_that_their_maker_gives_them(maker: Maker) -> None:
    with gige_bench(maker=maker) as bench, opened(bench) as camera:
        settings = camera.settings
        assert (settings.gain_unit, settings.black_level_unit) == STATED[maker]
        is_told = settings.black_level_unit != "counts"
        # 64 DN, to the step of a float32 and of the 16 bits of a level.
        assert settings.black_level_dn == pytest.approx(64.0 if is_told else 0.0)
        assert any("black level" in line for line in camera.warnings) is not is_told
        assert bench.camera.value("Gain") == pytest.approx(0.0, abs=1e-3)
        assert bench.camera.value("DigitalGain") == 0.0


def test_a_gain_in_counts_is_set_in_counts_and_never_taken_for_decibels() -> None:
    with gige_bench(maker="basler") as bench:
        with opened(bench, gain_counts=204) as camera:
            assert camera.settings.gain == camera.settings.features["GainRaw"] == 204
            assert camera.settings.gain_db is None
            assert bench.camera.value("Gain") == pytest.approx(6.03, abs=0.01)
        with pytest.raises(CameraFeatureError) as refused, opened(bench, gain_db=6.0):
            pass
        assert refused.value.feature == "GainRaw"
        with pytest.raises(CameraFeatureError), opened(bench, gain_counts=600):
            pass
    with gige_bench() as bench, pytest.raises(CameraFeatureError), opened(bench, gain_counts=3):
        pass


@pytest.mark.parametrize(
    ("maker", "register"),
    [("flir", "GammaEnabled"), ("flir", "SharpnessEnabled"), ("ids", "TestPattern")],
)
def test_a_camera_that_keeps_what_falsifies_levels_is_refused_by_name(
    maker: Maker, register: str
) -> None:
    with gige_bench(maker=maker) as bench:
        bench.camera.faults = GigeFaults(refused_registers=frozenset({register}))
        with pytest.raises(CameraFeatureError) as refused:
            AravisCamera.open(camera_config(bench.camera.address))
        assert refused.value.feature == register


def test_a_defect_correction_that_cannot_be_switched_off_is_recorded_and_said() -> None:
    with gige_bench(maker="flir") as bench:
        register = "pgrDefectPixelCorrectionEnable"
        bench.camera.faults = GigeFaults(refused_registers=frozenset({register}))
        with opened(bench) as camera:
            assert camera.settings.features[register] is True
            assert any(register in line for line in camera.warnings)


@pytest.mark.parametrize("maker", MAKERS)
def test_a_frame_rate_beyond_the_limit_is_lowered_whatever_it_is_called(maker: Maker) -> None:
    with gige_bench(maker=maker) as bench, opened(bench, frame_rate_hz=500.0) as camera:
        assert camera.settings.frame_rate_hz == pytest.approx(67.5)
        assert any("camera.frame_rate_hz 500" in line for line in camera.warnings)


@pytest.mark.parametrize(
    ("region_px", "feature", "nearest"),
    [
        ((0, 0, 41, 32), "Width", "40 and 42"),
        ((0, 0, 40, 33), "Height", "32 and 34"),
        ((3, 0, 40, 32), "OffsetX", "2 and 4"),
        ((0, 0, 4000, 64), "Width", "96$"),
    ],
)
def test_a_region_between_the_steps_of_a_camera_names_the_step_and_the_nearest(
    region_px: tuple[int, int, int, int], feature: str, nearest: str
) -> None:
    with (
        gige_bench() as bench,
        pytest.raises(CameraFeatureError, match=f"steps of 2; the nearest: {nearest}") as odd,
        opened(bench, region_px=region_px),
    ):
        pass
    assert odd.value.feature == feature


def test_a_camera_without_sensor_width_shows_its_whole_sensor() -> None:
    with gige_bench(maker="hikrobot") as bench, opened(bench) as camera:
        assert "SensorWidth" not in camera.settings.features
        assert (camera.settings.width_px, camera.settings.height_px) == (96, 64)


@pytest.mark.parametrize("maker", MAKERS)
def test_the_doctor_reads_every_makers_limits_without_control(maker: Maker) -> None:
    with gige_bench(maker=maker) as bench:
        probe = probe_camera(camera_config(bench.camera.address))
        assert probe.exposure_us.low == 21.0
        assert {value.unit for value in probe.gain} == {STATED[maker][0]}
        assert "Mono12" in probe.pixel_formats
