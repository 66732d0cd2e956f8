import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hil_mocks.gige import FrameRequest, GigeFaults
from hil_mocks.gige._wire import GvcpStatus
from hil_mocks.practice_bench import (
    HandStage,
    PracticeCommandError,
    PracticeConsole,
    faults_from_words,
)
from hil_mocks.stages._serial_stage import SerialStage
from tests.hil_mocks.gige_bench import free_addresses, gige_bench
from tests.hil_mocks.gige_client import RawClient
from tests.standoff.conftest import Command

MOCK = [sys.executable, "-c", "from standoff.cli import main; main()", "mock"]
ENDS_WITHIN_S = 120
FRAME = FrameRequest(acquisition=1, index=0, exposure_us=8000.0, gain_db=0.0, black_level_dn=64.0)


@contextmanager
def mock_process(bench_file: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """``standoff mock --json``, ready, on a free address."""
    address = next(free_addresses())
    command = [*MOCK, "--json", "--bench", str(bench_file), "--address", address, *arguments]
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    ) as process:
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        assert ready == {"camera_address": address, "stage_port": None}
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()


def typed(process: subprocess.Popen[str], line: str) -> str:
    """What the mock says to a line."""
    assert process.stdin is not None
    assert process.stderr is not None
    process.stdin.write(line + "\n")
    process.stdin.flush()
    return process.stderr.readline().rstrip()


@pytest.mark.slow
def test_a_served_bench_is_changed_by_lines_and_ends_cleanly(bench_file: Path) -> None:
    with mock_process(bench_file, "--target", "flat") as process:
        arguments = process.args
        assert isinstance(arguments, list)
        with RawClient(arguments[arguments.index("--address") + 1]) as client:
            client.start(AcquisitionFrameRateAbs=50)
            assert client.block().image_mono8.mean() > 100  # white paper, 12000 e-
            assert typed(process, "place dark") == (
                "target dark at 0 degrees, height 370.000 mm, faults: none"
            )
            while client.block().image_mono8.mean() > 10:
                pass
            assert "is_stalled=True" in typed(process, "fault is_stalled=true")
            list(client.packets(0.2))
            assert not client.is_streamed_to()
            assert typed(process, "restart") == "the camera was restarted"
            assert client.set("Gain", 1) == GvcpStatus.ACCESS_DENIED
        assert "standoff: unknown command jump" in typed(process, "jump")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=ENDS_WITHIN_S)
    assert process.returncode == 0
    assert (out, err) == ("", "")


@pytest.mark.slow
def test_the_end_of_its_input_does_not_end_it_but_sigterm_does(bench_file: Path) -> None:
    with mock_process(bench_file) as process:
        assert process.stdin is not None
        process.stdin.close()
        process.stdin = None
        arguments = process.args
        assert isinstance(arguments, list)
        with RawClient(arguments[arguments.index("--address") + 1]) as client:
            assert client.is_answered()
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=ENDS_WITHIN_S)
    assert process.returncode == 0
    assert err == ""


def test_an_address_in_use_and_a_bench_without_truth_are_named(
    command: Command, bench_file: Path, tmp_path: Path
) -> None:
    with gige_bench() as bench:
        outcome = command("mock", "--bench", bench_file, "--address", bench.camera.address)
    assert outcome.status == 1
    assert bench.camera.address in outcome.err
    other = tmp_path / "other.toml"
    other.write_text(bench_file.read_text().partition("[simulated]")[0])
    assert "[simulated]" in command.refused(1, "mock", "--bench", other)


@pytest.mark.slow
def test_a_line_places_a_target_and_moves_the_stand() -> None:
    stage = HandStage((120.0, 620.0))
    with gige_bench(height_mm=lambda: stage.true_height_mm) as bench:
        console = PracticeConsole(bench, stage)
        console.execute("place brick 30")
        before = bench.source.levels_dn(FRAME)
        assert console.execute("height 200.5").startswith(
            "target brick at 30 degrees, height 200.500 mm"
        )
        after = bench.source.levels_dn(FRAME)
    assert np.abs(after.astype(float) - before).mean() > 10


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("jump", "jump"),
        ("place", "place"),
        ("place moon", "moon"),
        ("place edge north", "north"),
        ("place edge nan", "nan"),
        ("height", "height"),
        ("height 700", "700"),
        ("height nan", "nan"),
        ("fault", "fault"),
        ("fault loss=1", "loss=1"),
        ("fault packet_loss_rate=2", "packet_loss_rate=2"),
        ("fault packet_loss_rate=nan", "packet_loss_rate=nan"),
        ("fault is_dead=maybe", "is_dead=maybe"),
        ("fault missing_rows=1.5", "missing_rows=1.5"),
        ("fault missing_rows=inf", "missing_rows=inf"),
        ("fault missing_rows=many", "many"),
    ],
)
def test_a_line_that_is_not_understood_changes_nothing(line: str, word: str) -> None:
    stage = HandStage((120.0, 620.0))
    with gige_bench() as bench:
        console = PracticeConsole(bench, stage)
        with pytest.raises(PracticeCommandError) as refused:
            console.execute(line)
        assert refused.value.word == word
        assert bench.camera.faults == GigeFaults()
        assert (bench.target, stage.true_height_mm) == ("edge", 370.0)


def test_faults_are_set_by_their_names_and_kept_until_taken_away() -> None:
    faults = faults_from_words(
        GigeFaults(seed=3), ["packet_loss_rate=0.25", "refused_registers=Gain,Width"]
    )
    assert faults == GigeFaults(
        seed=3, packet_loss_rate=0.25, refused_registers=frozenset({"Gain", "Width"})
    )
    assert faults_from_words(faults, ["refused_registers="]).refused_registers == frozenset()
    with gige_bench() as bench:
        bench.camera.faults = faults
        assert PracticeConsole(bench, HandStage((1.0, 2.0))).execute("fault none").endswith("none")
        assert bench.camera.faults == GigeFaults()


def test_whole_numbered_faults_and_a_lost_controller_are_set_by_lines() -> None:
    with gige_bench() as bench, RawClient(bench.camera.address) as client:
        console = PracticeConsole(bench, HandStage((120.0, 620.0)))
        assert "missing_rows=3" in console.execute("fault missing_rows=3")
        assert bench.camera.faults == GigeFaults(missing_rows=3)
        client.start()
        assert bench.camera.controller is not None
        assert console.execute("drop-control") == "the camera is not under anyone's control"
        assert bench.camera.controller is None
        assert client.set("Gain", 2) == GvcpStatus.ACCESS_DENIED
        assert console.execute("status").startswith("target edge at 0 degrees")


def test_a_stage_on_a_port_is_not_moved_by_hand() -> None:
    with SerialStage("grbl") as stage, gige_bench() as bench:
        console = PracticeConsole(bench, stage)
        with pytest.raises(PracticeCommandError) as refused:
            console.execute("height 200")
        assert refused.value.word == "height"
