"""Every fault of a run: one line, exit status 1, and a session that the same command resumes."""

import errno
import os
import pty
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from acquisition.bench import BenchConfig
from acquisition.session._files import FileParts, write_new_hashed
from acquisition.session._reader import Session, verify
from hil_mocks import SimulatedBench
from hil_mocks.devices import CameraFaults, StageFaults
from standoff.library.bench._devices import OpenBench, open_bench
from tests.standoff.conftest import Command


def lose_the_camera(bench: SimulatedBench) -> None:
    bench.camera.faults = CameraFaults(disconnect_at=12)


def raise_an_alarm(bench: SimulatedBench) -> None:
    bench.stage.faults = StageFaults(alarm="hard limit")


def unplug_the_stage(bench: SimulatedBench) -> None:
    bench.stage.faults = StageFaults(unplugged=True)


def never_settle(bench: SimulatedBench) -> None:
    bench.stage.faults = StageFaults(never_settles=True)


def stop_short(bench: SimulatedBench) -> None:
    bench.stage.faults = StageFaults(stops_short_mm=0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "named"),
    [
        (lose_the_camera, "camera"),
        (raise_an_alarm, "hard limit"),
        (unplug_the_stage, "stage"),
        (never_settle, "stage"),
        (stop_short, "it is at 299.500 mm"),
    ],
)
def test_a_fault_of_a_device_is_one_line_and_the_same_command_resumes(
    command: Command,
    capture_line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: Callable[[SimulatedBench], None],
    named: str,
) -> None:
    @contextmanager
    def opened(config: BenchConfig, *, ask: Callable[[str], str]) -> Iterator[OpenBench]:
        with open_bench(config, ask=ask) as devices:
            assert devices.simulated is not None
            # The second capture is hit: the first one moves and exposes unharmed.
            moved = devices.simulated.stage.move_to
            moves: list[float] = []

            def move_to(height_mm: float, timeout_s: float) -> float:
                moves.append(height_mm)
                if len(moves) == 2 and devices.simulated is not None:
                    fault(devices.simulated)
                return moved(height_mm, timeout_s)

            monkeypatch.setattr(devices.simulated.stage, "move_to", move_to)
            yield devices

    with monkeypatch.context() as patch:
        patch.setattr("standoff.library.bench._devices.open_bench", opened)
        done = command(capture_line, "--yes")
    assert (done.status, done.out) == (1, "")
    [line] = [line for line in done.err.splitlines() if line.startswith("standoff:")]
    assert named in line
    session = Session(tmp_path / "s")
    assert 1 <= len(session.records) < 6
    assert session.events[-1].kind == "error"
    resumed = command.document(capture_line, "--yes")
    assert resumed["captured"] == 6 - len(session.records)
    assert Session(tmp_path / "s").is_complete
    assert verify(tmp_path / "s").is_ok


def test_a_disk_that_fills_up_is_one_line_and_the_same_command_resumes(
    command: Command, capture_line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writes: list[Path] = []

    def fill_up(path: Path, parts: FileParts, *seal: Callable[[str], bytes]) -> str:
        writes.append(path)
        if len(writes) > 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write_new_hashed(path, parts, *seal)

    with monkeypatch.context() as patch:
        patch.setattr("acquisition.session._writer.write_new_hashed", fill_up)
        done = command(capture_line, "--yes")
    assert done.status == 1
    assert "No space left on device; check the disk and run the same command again" in done.err
    assert len(Session(tmp_path / "s").records) == 2
    assert command.document(capture_line, "--yes")["captured"] == 4


def test_a_disk_without_room_for_the_plan_is_named_before_anything_moves(
    command: Command, capture_line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1_000_000))
    assert "has 1 MB free" in command.refused(1, capture_line, "--yes")


@pytest.mark.slow
def test_ctrl_c_in_the_first_moments_is_one_line_and_status_130() -> None:
    # The entry is light; all that takes time is imported by main.
    code = "import standoff.cli as c; print('x', end='', flush=True); c.main()"
    for delay_s in (0.15, 0.4):
        with subprocess.Popen(
            [sys.executable, "-c", code, "mock", "--address", "127.0.0.253"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.read(1) == "x"
                time.sleep(delay_s)
                process.send_signal(signal.SIGINT)
                _, err = process.communicate(timeout=300)
            finally:
                process.kill()
        assert process.returncode == 130
        assert err == "standoff: interrupted; run the same command again\n"


@pytest.mark.slow
def test_at_a_terminal_the_operator_answers_pauses_and_goes_on(
    capture_line: str, tmp_path: Path
) -> None:
    controller, terminal = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", "from standoff.cli import main; main()", *shlex.split(capture_line)],
        stdin=terminal,
        stdout=subprocess.PIPE,
        stderr=terminal,
    ) as process:
        os.close(terminal)
        seen = b""
        answered = paused = 0
        while True:
            try:
                seen += os.read(controller, 4096)
            except OSError:  # the end of a pseudo-terminal
                break
            if seen.count(b"s to skip") > answered:
                answered += 1
                time.sleep(0.05)
                os.write(controller, b"\n" if answered != 2 else b"\nstop\n")
            if seen.count(b"Enter to continue") > paused:
                paused += 1
                time.sleep(0.05)
                os.write(controller, b"\n")
        assert process.wait(300) == 0
    os.close(controller)
    assert answered == 3
    assert paused == 1
    assert Session(tmp_path / "s").is_complete
