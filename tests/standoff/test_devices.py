import time
from pathlib import Path

import pytest

from acquisition.bench import BenchConfig, load_bench
from acquisition.devices import Camera
from acquisition.errors import BenchConfigError
from standoff.devices import open_bench, open_camera, open_stage
from standoff.shipped_configs import shipped_config
from tests.acquisition.aravis_bench import camera_config, needs_aravis
from tests.acquisition.session_fixtures import bench_of
from tests.hil_mocks.gige_bench import gige_bench


@needs_aravis
def test_the_aravis_driver_opens_the_camera_of_a_bench_file() -> None:
    with gige_bench() as bench:
        camera = open_camera(camera_config(bench.camera.address))
        assert isinstance(camera, Camera)
        assert camera.info.driver == "aravis"
        camera.close()
        assert bench.camera.controller is None


@needs_aravis
def test_a_bench_of_real_devices_lives_in_real_time_and_gives_them_back() -> None:
    with gige_bench() as practice:
        config = BenchConfig.model_validate(
            {
                "camera": camera_config(practice.camera.address, frame_rate_hz=500.0).model_dump(),
                "stage": {"driver": "manual", "limits_mm": [0.0, 300.0]},
                "optics": {"focal_length_mm": 8.0, "pixel_pitch_um": 8.3},
            }
        )
        with open_bench(config) as devices:
            assert devices.simulated is None
            assert devices.clock() == pytest.approx(time.monotonic(), abs=1.0)
            assert "camera.frame_rate_hz" in devices.warnings[0]
        assert practice.camera.controller is None


def test_a_simulated_device_beside_a_real_one_is_refused() -> None:
    with (
        pytest.raises(BenchConfigError, match=r"'aravis' with stage\.driver 'simulated'"),
        open_bench(bench_of(driver="aravis", address="127.0.0.1")),
    ):
        pass


def test_the_shipped_manta_bench_is_one_of_real_devices() -> None:
    config = load_bench(Path(shipped_config("manta_g046.toml")))
    assert (config.camera.driver, config.stage.driver) == ("aravis", "manual")
    assert config.camera.frame_rate_hz == 67.5


def test_a_driver_that_opens_no_real_device_is_refused_with_those_that_do() -> None:
    config = bench_of()
    assert (config.camera.driver, config.stage.driver) == ("simulated", "simulated")
    with pytest.raises(BenchConfigError, match="'simulated' opens no camera; use 'aravis'"):
        open_camera(config.camera)
    with pytest.raises(BenchConfigError, match="opens no stage; use 'grbl', 'zaber' or 'manual'"):
        open_stage(config.stage)
