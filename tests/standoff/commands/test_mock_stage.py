"""The stage of ``standoff mock``: its port, and the height that the camera sees."""

import json
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from acquisition.bench import load_bench, parse_overrides
from acquisition.stages._grbl import open_grbl_stage
from acquisition.stages.zaber import open_zaber_stage
from hil_mocks.practice_bench import PracticeBench
from hil_mocks.stages._serial_stage import SerialStage, StageProtocol
from standoff.shipped_configs import shipped_config
from tests.standoff.conftest import Command

FASTER = 20.0


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["grbl", "zaber"])
def test_the_camera_sees_the_true_height_not_the_one_read_back(protocol: StageProtocol) -> None:
    config = load_bench(
        shipped_config("simulated.toml"), {"simulated.width_px": 64, "simulated.height_px": 48}
    )
    with SerialStage(protocol, clock=lambda: time.monotonic() * FASTER) as served:
        practice = PracticeBench(config, height_mm=lambda: served.true_height_mm)
        stage_config = load_bench(
            shipped_config(f"{protocol}_stage.toml"),
            {"stage.port": served.port, "stage.settle_s": 0.05},
        ).stage
        opened = (open_grbl_stage if protocol == "grbl" else open_zaber_stage)(stage_config)
        try:
            opened.home(60)
            read_back_mm = opened.move_to(150.0, 60)
            assert practice.pose.height_mm == pytest.approx(read_back_mm, abs=0.05)
            near = practice.truth.irradiance("coins", 0.0, practice.pose)
            served.plant.place(140.0)
            assert opened.position_mm() == read_back_mm
            assert practice.pose.height_mm == 140.0
            nearer = practice.truth.irradiance("coins", 0.0, practice.pose)
            assert np.abs(near - nearer).max() > 0.01
        finally:
            opened.close()


def served_mock(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", "from standoff.cli import main; main()", "mock", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def served_and_options(process: subprocess.Popen[str]) -> tuple[str, list[str]]:
    """What is served, and the options that open it."""
    assert process.stdout is not None
    served, opening = process.stdout.readline(), process.stdout.readline()
    options = re.fullmatch("open it with (.*); Ctrl-C ends\n", opening)
    assert options is not None, opening
    return served, shlex.split(options[1])


@pytest.mark.slow
def test_a_stand_that_a_hand_moves_is_opened_with_its_own_travel() -> None:
    process = served_mock("--address", "127.0.0.79", "--set", "stage.limits_mm=[150, 400]")
    try:
        served, bench = served_and_options(process)
    finally:
        process.kill()
        process.communicate()
    assert served == "camera at 127.0.0.79; no stage port\n"
    keys = [word for option, word in zip(bench[::2], bench[1::2], strict=True) if option == "--set"]
    opened = load_bench(Path(bench[1]), parse_overrides(keys))
    assert opened.stage.limits_mm == (150.0, 400.0)
    assert opened.camera.address == "127.0.0.79"


@pytest.mark.slow
def test_mock_serves_a_stage_on_a_port_and_says_how_to_open_it(command: Command) -> None:
    process = served_mock("--stage-protocol", "zaber", "--address", "127.0.0.78")
    try:
        served, bench = served_and_options(process)
        assert served.startswith("camera at 127.0.0.78; stage on /dev/")
        assert bench[:2] == ["--bench", str(shipped_config("zaber_stage.toml"))]
        assert "camera.address=127.0.0.78" in bench
        shown = json.loads(command("stage", "status", *bench, "--json").out)
        assert shown["info"]["vendor"] == "Zaber"
        assert not shown["is_homed"]
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=120)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0, err
