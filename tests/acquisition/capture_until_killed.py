"""Captures a plan with the fakes, on the real disk, in processes that a test kills.

For each line on its standard input it forks a child that runs or resumes the session of that
path, and writes the child's id; the child writes a line for each capture stored, and ``end``.
Forking spares the test the seconds of the imports.
"""

import os
import sys
from pathlib import Path

from acquisition.averaging import average_frames
from acquisition.bench import BenchDevices
from acquisition.capture._runner import CaptureProgress, RunOperator, run_plan
from acquisition.devices import Frame
from tests.acquisition.fakes import SETTINGS, ScriptedCamera, ScriptedStage, frame
from tests.acquisition.session_fixtures import bench_of, plan_of

HEIGHTS = 40


def report(progress: CaptureProgress) -> None:
    write(str(progress.captured))


def write(line: str) -> None:
    os.write(sys.stdout.fileno(), f"{line}\n".encode())


def capture(path: Path) -> None:
    """Run or resume the session at ``path``."""
    plan = plan_of(heights_mm={"start": 1.0, "stop": float(HEIGHTS), "step": 1.0}, keep_frames=True)
    frames: list[Frame] = [frame(1000 + i % 7, i) for i in range(1, 3 * HEIGHTS * 4 + 1)]
    camera = ScriptedCamera(frames, settings=SETTINGS)
    devices = BenchDevices(
        config=bench_of(), camera=camera, stage=ScriptedStage(), clock=camera.clock
    )
    operator = RunOperator(name="Zoë", place=lambda _: "ready", progress=report)
    run_plan(path, plan, devices, operator)


def serve() -> None:
    """Fork a child for each path; the next one once it has ended or was killed."""
    average_frames(ScriptedCamera(), 2)  # compiled once, not in every child
    for line in sys.stdin:
        ready, go = os.pipe()
        child = os.fork()
        if child == 0:
            os.read(ready, 1)  # the id comes first
            capture(Path(line.rstrip("\n")))
            write("end")
            os._exit(0)
        write(f"child {child}")
        os.write(go, b".")
        os.close(go)
        os.close(ready)
        os.waitpid(child, 0)
        write("ended")


if __name__ == "__main__":
    serve()
