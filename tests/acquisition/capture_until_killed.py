"""Capture a plan with the fakes, real disk and real journal; a test kills this process."""

import sys
from pathlib import Path

from acquisition.devices import Frame
from acquisition.runner import CaptureProgress, run_plan
from tests.acquisition.fakes import SETTINGS, ScriptedCamera, ScriptedStage, frame
from tests.acquisition.session_fixtures import bench_of, plan_of

HEIGHTS = 40


def report(progress: CaptureProgress) -> None:
    sys.stdout.write(f"{progress.captured}\n")
    sys.stdout.flush()


def main(path: Path) -> None:
    """Run or resume the session at ``path``; write one line for each capture stored."""
    plan = plan_of(heights_mm={"start": 1.0, "stop": float(HEIGHTS), "step": 1.0}, keep_frames=True)
    frames: list[Frame] = [frame(1000 + i % 7, i) for i in range(1, 3 * HEIGHTS * 4 + 1)]
    camera = ScriptedCamera(frames, settings=SETTINGS)
    run_plan(
        path,
        plan=plan,
        bench=bench_of(),
        camera=camera,
        stage=ScriptedStage(),
        operator="Zoë",
        place=lambda _: "ready",
        progress=report,
        clock=camera.clock,
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
