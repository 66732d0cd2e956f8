"""A whole session over the real protocols: GigE Vision and Grbl, the mock as the bench."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
import pytest

from acquisition.bench import load_bench
from acquisition.session._reader import Session
from hil_mocks.truth.bench_truth import BenchTruth
from standoff.shipped_configs import shipped_config
from tests.hil_mocks.gige_bench import free_addresses
from tests.standoff.conftest import Command

STANDOFF = [sys.executable, "-c", "from standoff.cli import main; main()"]
HEIGHTS_MM = (300.0, 305.0, 310.25, 315.0, 320.0)
ORIENTATIONS_DEG = (5.0, 50.0, 95.0, 140.0)
PLAN = f"""
schema = "standoff.plan/1"
name = "over the wire"
heights_mm = {list(HEIGHTS_MM)}
frames_per_capture = 10

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = {list(ORIENTATIONS_DEG)}
"""
TRUTH = (
    "simulated.corner_sigma_gain=0.0",
    "simulated.k1=0.0",
    "simulated.optical_sigma_x_px=0.7",
    "simulated.optical_sigma_y_px=0.6",
    "simulated.width_px=480",
    "simulated.height_px=360",
)
ENDS_WITHIN_S = 300


@contextmanager
def process(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [*STANDOFF, *(str(argument) for argument in arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    ) as started:
        try:
            yield started
        finally:
            if started.poll() is None:
                started.kill()


def pipe(stream: IO[str] | None) -> IO[str]:
    assert stream is not None
    return stream


def write_line(started: subprocess.Popen[str], line: str) -> None:
    pipe(started.stdin).write(line + "\n")
    pipe(started.stdin).flush()


def be_the_operator(capture: subprocess.Popen[str], mock: subprocess.Popen[str]) -> list[float]:
    """Place what is asked for at the mock, then say so; the orientations in turn."""
    placed: list[float] = []
    for line in pipe(capture.stderr):
        if line.startswith("Place edge 'edge' at "):
            placed.append(float(line.split()[-2]))
            write_line(mock, f"place edge {placed[-1]:g}")
            assert f"target edge at {placed[-1]:g} degrees" in pipe(mock.stderr).readline()
        elif line.startswith("Enter to capture"):
            write_line(capture, "")
        else:
            assert not line.startswith("standoff:"), line
    return placed


@pytest.mark.waits
@pytest.mark.slow(minutes=0.6)
def test_a_session_of_five_heights_and_four_orientations_over_the_real_protocols(
    command: Command, tmp_path: Path
) -> None:
    pytest.importorskip("gi")
    plan, out, psf = tmp_path / "plan.toml", tmp_path / "session", tmp_path / "psf.json"
    plan.write_text(PLAN)
    truth_settings = [word for key in TRUTH for word in ("--set", key)]
    address = next(free_addresses())
    with process(
        "mock", "--stage-protocol", "grbl", "--address", address, "--json", *truth_settings
    ) as mock:
        ready = json.loads(pipe(mock.stdout).readline())
        with process(
            "capture", "--bench", shipped_config("grbl_stage.toml"), "--plan", plan, "--out", out,
            "--set", f"camera.address={ready['camera_address']}",
            "--set", f"stage.port={ready['stage_port']}",
            "--set", "stage.feed_mm_per_min=2400",
            "--set", "stage.settle_s=0.1",
            "--set", "stage.park_mm=320",
            "--answers", "-", "--json",
        ) as capture:  # fmt: skip
            placed = be_the_operator(capture, mock)
            summary = json.loads(pipe(capture.stdout).read())
            assert capture.wait(ENDS_WITHIN_S) == 0
        mock.send_signal(signal.SIGINT)
        mock.communicate(timeout=ENDS_WITHIN_S)
    assert summary["captured"] == 20
    assert tuple(placed) == ORIENTATIONS_DEG
    command.done("verify", out)
    session = Session(out)
    assert session.is_complete
    assert session.devices["camera"]["driver"] == "aravis"
    assert session.devices["stage"]["driver"] == "grbl"
    # 310.25 mm lies between two steps of the controller: what it read back was recorded.
    assert {round(r.height_mm - r.height_asked_mm, 3) for r in session.records} != {0.0}
    assert all(abs(r.height_mm - r.height_asked_mm) <= 0.01 for r in session.records)

    command.done("calibrate", "--session", out, "--out", psf)
    found = json.loads(psf.read_text())
    truth = BenchTruth(
        load_bench(
            shipped_config("simulated.toml"),
            {key.partition("=")[0]: float(key.partition("=")[2]) for key in TRUTH[:4]},
        )
    )
    (xx, _), (_, yy) = truth.optical_covariance_px2(HEIGHTS_MM[2]).tolist()
    assert found["optical_sigma_x_px"] == pytest.approx(np.sqrt(xx), rel=0.01)
    assert found["optical_sigma_y_px"] == pytest.approx(np.sqrt(yy), rel=0.01)
