import time
from pathlib import Path

import pytest

from acquisition.bench import BenchConfig, load_bench
from acquisition.devices import Camera
from acquisition.errors import BenchConfigError
from acquisition.session._reader import Session
from standoff.library.bench._devices import open_bench, open_camera, open_stage
from standoff.shipped_configs import shipped_config
from tests.acquisition.aravis_bench import camera_config, needs_aravis
from tests.acquisition.session_fixtures import bench_of
from tests.hil_mocks.gige_bench import gige_bench
from tests.standoff.commands.test_focus import REAL_CAMERA
from tests.standoff.conftest import SMALL_PLAN, Command


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
            assert time.monotonic() <= devices.clock() <= time.monotonic()
            assert "camera.frame_rate_hz" in devices.warnings[0]
        assert practice.camera.controller is None


def test_a_simulated_device_beside_a_real_one_is_refused() -> None:
    with (
        pytest.raises(BenchConfigError),
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
    with pytest.raises(BenchConfigError):
        open_camera(config.camera)
    with pytest.raises(BenchConfigError):
        open_stage(config.stage)


@needs_aravis
@pytest.mark.slow
def test_a_capture_on_a_real_bench_tells_its_warnings_and_asks_for_target_and_height(
    command: Command, tmp_path: Path
) -> None:
    bench, plan, answers = tmp_path / "b.toml", tmp_path / "p.toml", tmp_path / "answers.txt"
    plan.write_text(
        SMALL_PLAN.replace("[5.0, 50.0, 95.0]", "[5.0]").replace("[180.0, 300.0]", "[200.0]")
    )
    # The target lies there; the stand's scale is read, then at 200 mm, once wrongly set.
    answers.write_text("\n150\n200.3\n200.004\n")
    with gige_bench() as practice:
        practice.place("edge", 5.0)
        bench.write_text(REAL_CAMERA.format(address=practice.camera.address))
        words = ("capture", "--bench", bench, "--plan", plan, "--out", tmp_path / "s")
        done = command(*words, "--answers", answers)
    assert done.status == 0, done.err
    assert "note: " in done.err
    assert "camera.frame_rate_hz" in done.err
    assert "4000 us is not a multiple of the 10 ms" in done.err
    assert "Place edge 'edge' at 5 degrees." in done.err
    [record] = Session(tmp_path / "s").records
    assert "That is +0.300 mm off." in done.err
    assert record.height_mm == 200.004
