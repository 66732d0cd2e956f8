"""A camera that is killed between two frames of one average: it comes back, or the run ends.

The cameras are processes that are killed with SIGKILL: the simulated one, and Aravis' own fake
camera, which shares no code with ours.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from acquisition.session._reader import Session, verify
from tests.acquisition.aravis_bench import needs_aravis
from tests.hil_mocks.gige_bench import free_addresses
from tests.hil_mocks.loopback_camera_port import loopback_camera_port
from tests.standoff.commands.test_hostile_camera import aravis_bench_file
from tests.standoff.console.processes import pipe

pytestmark = [needs_aravis, pytest.mark.slow(minutes=0.4), pytest.mark.waits]

ROOT = Path(__file__).parents[3]
FRAMES = 12
FRAME_RATE_HZ = 8.0
PLAN = f"""
schema = "standoff.plan/1"
name = "a camera that is killed"
heights_mm = [100.0]
frames_per_capture = {FRAMES}

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0, 50.0, 95.0]
"""
CAPTURES = 3

KILLED_AFTER = 1 + FRAMES + 1 + 4
"""Frames: the first capture with its skipped one, and four good ones of the second."""

ENDS_WITHIN_S = 240.0

COMMAND = """
import os, sys
from acquisition.aravis._camera import AravisCamera
deliver, told = AravisCamera.next_frame, int(sys.argv.pop(1))
def next_frame(camera, timeout_s):
    frame = deliver(camera, timeout_s)
    os.write(told, b".")
    return frame
AravisCamera.next_frame = next_frame
from standoff.cli import main
main()
"""
"""``standoff`` with a word for every frame that arrives."""

FAKE = """
import sys
from acquisition.aravis._device import load_aravis
fake = load_aravis().api.GvFakeCamera.new(sys.argv[1], "GV01")
assert fake.is_running()
print("ready", flush=True)
sys.stdin.read()
"""

Camera = Callable[[], AbstractContextManager["subprocess.Popen[str]"]]


@dataclass(frozen=True, kw_only=True)
class KillableCamera:
    """A camera at an address, which is started as often as it is asked for."""

    address: str
    words: tuple[str, ...]

    @contextmanager
    def running(self) -> Iterator["subprocess.Popen[str]"]:
        with subprocess.Popen(
            [sys.executable, *self.words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=ROOT,
        ) as process:
            try:
                assert pipe(process.stdout).readline()
                yield process
            finally:
                process.kill()


@pytest.fixture(params=["simulated", "aravis"])
def camera(request: pytest.FixtureRequest) -> Iterator[KillableCamera]:
    if request.param == "simulated":
        address = next(free_addresses())
        small = ("--set", "simulated.width_px=128", "--set", "simulated.height_px=64")
        words = ("-m", "standoff", "mock", "--address", address, "--json", *small)
        yield KillableCamera(address=address, words=words)
        return
    with loopback_camera_port():
        yield KillableCamera(address="127.0.0.1", words=("-c", FAKE, "127.0.0.1"))


@dataclass(frozen=True, kw_only=True)
class Run:
    """A capture as a command, its session and its bench."""

    folder: Path
    words: tuple[str, ...]

    @property
    def session(self) -> Path:
        return self.folder / "session"

    @contextmanager
    def started(self) -> Iterator[tuple["subprocess.Popen[str]", int]]:
        """The process, and where it writes a byte for every frame that arrived."""
        told, tells = os.pipe()
        try:
            with subprocess.Popen(
                [sys.executable, "-c", COMMAND, str(tells), *self.words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                pass_fds=(tells,),
                cwd=ROOT,
            ) as process:
                os.close(tells)
                try:
                    yield process, told
                finally:
                    process.kill()
        finally:
            os.close(told)


@pytest.fixture
def run(camera: KillableCamera, tmp_path: Path) -> Run:
    bench = aravis_bench_file(
        tmp_path,
        camera.address,
        f"frame_rate_hz = {FRAME_RATE_HZ}",
        "region_px = [0, 0, 128, 64]",
        "packet_size_bytes = 1500",
    )
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "answers").write_text("\n100" + "\n" * 12)
    words = (
        *("capture", "--bench", bench, "--plan", tmp_path / "plan.toml", "--json"),
        *("--out", tmp_path / "session", "--answers", tmp_path / "answers"),
        *("--set", "camera.pixel_format=Mono8", "--set", "camera.reconnect_timeout_s=30"),
    )
    return Run(folder=tmp_path, words=tuple(map(str, words)))


def kill_between_frames(
    process: "subprocess.Popen[str]", capture: "subprocess.Popen[str]", told: int, run: Run
) -> None:
    """Kill a camera when the second capture has some of its frames."""
    for _ in range(KILLED_AFTER):
        assert os.read(told, 1) == b".", pipe(capture.stderr).read()
    process.kill()
    process.wait()
    # So many frames take a second: the second capture cannot have ended.
    assert len(Session(run.session).records) == 1


def test_a_camera_that_is_killed_in_an_average_and_comes_back_completes_the_session(
    camera: KillableCamera, run: Run
) -> None:
    with camera.running() as first, run.started() as (capture, told):
        kill_between_frames(first, capture, told, run)
        with camera.running():
            out, err = capture.communicate(timeout=ENDS_WITHIN_S)
    assert capture.returncode == 0, err
    assert json.loads(out)["captured"] == CAPTURES
    session = Session(run.session)
    assert session.is_complete
    assert verify(run.session).is_ok
    assert [record.frames_used for record in session.records] == [FRAMES] * CAPTURES
    [error] = [event for event in session.events if event.kind == "error"]
    assert error.facts["error"] == "StreamInterruptedError"
    assert error.facts["index"] == 1
    assert "restarted" in error.facts["message"]


def test_a_camera_that_stays_away_ends_the_run_in_one_line_and_the_command_resumes_later(
    camera: KillableCamera, run: Run
) -> None:
    quick = Run(folder=run.folder, words=(*run.words[:-1], "camera.reconnect_timeout_s=1"))
    with camera.running() as first, quick.started() as (capture, told):
        kill_between_frames(first, capture, told, run)
        out, err = capture.communicate(timeout=ENDS_WITHIN_S)
    assert (capture.returncode, out) == (1, "")
    [line] = [line for line in err.splitlines() if line.startswith("standoff:")]
    assert err.rstrip().endswith(line)
    assert "did not come back within 1 s" in line
    assert verify(run.session).is_ok
    assert len(Session(run.session).records) == 1
    with camera.running(), quick.started() as (again, _):
        out, err = again.communicate(timeout=ENDS_WITHIN_S)
    assert again.returncode == 0, err
    assert json.loads(out)["captured"] == CAPTURES - 1
    assert Session(run.session).is_complete
    assert verify(run.session).is_ok
