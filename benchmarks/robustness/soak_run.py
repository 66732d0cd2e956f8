"""One run of a soak's session: what the soak does itself, and what it kills as a process."""

import sys
from pathlib import Path

from acquisition.bench import BenchConfig, BenchDevices, load_bench
from acquisition.capture import RunOperator, run_plan
from acquisition.errors import DeviceError, SessionError
from acquisition.plan import CapturePlan, parse_plan
from standoff.library import open_bench
from standoff.shipped_configs import shipped_config

ADDRESS = "127.211.3.1"
ENDED_BY_FAULT = 3


def _soak_plan() -> CapturePlan:
    """Ten captures, each of five frames."""
    return parse_plan(
        {
            "schema": "standoff.plan/1",
            "name": "soak",
            "heights_mm": {"start": 300.0, "stop": 304.0, "step": 1.0},
            "frames_per_capture": 5,
            "repeats": 2,
            "targets": [{"kind": "texture", "target": "brick"}],
        },
        source="soak",
    )


def soak_config(port: str) -> BenchConfig:
    """The shipped Grbl bench on the simulated one."""
    return load_bench(
        shipped_config("grbl_stage.toml"),
        {
            "camera.address": ADDRESS,
            "stage.port": port,
            "stage.feed_mm_per_min": 2400,
            "stage.settle_s": 0.05,
            "stage.park_mm": 320,
        },
    )


def run_once(folder: Path, config: BenchConfig) -> None:
    """Begin the session, or go on with it, until it is complete or a fault ends the run."""
    with open_bench(config) as devices:
        run_plan(
            folder,
            _soak_plan(),
            BenchDevices(config=config, camera=devices.camera, stage=devices.stage),
            RunOperator(name="soak", place=lambda _: "ready"),
        )


def main() -> int:
    folder, port = Path(sys.argv[1]), sys.argv[2]
    try:
        run_once(folder, soak_config(port))
    except (DeviceError, SessionError) as error:
        print(f"{type(error).__name__}: {error}", flush=True)
        return ENDED_BY_FAULT
    return 0


if __name__ == "__main__":
    sys.exit(main())
