"""No capture is stored with a height that the stage did not read back: the real drivers in a run.

Each run is broken off by a fault in its second move; the same call resumes it.
"""

from collections.abc import Callable
from pathlib import Path

import pytest

from acquisition.bench import BenchDevices
from acquisition.capture._runner import RunOperator, run_plan
from acquisition.devices import Stage
from acquisition.errors import DeviceError
from acquisition.plan import CapturePlan
from acquisition.session._reader import Session
from hil_mocks import SimulatedBench
from hil_mocks.stages._plant import PlantFaults
from hil_mocks.stages._serial_stage import LineFaults
from tests.hil_mocks.benches import bench_config
from tests.hil_mocks.stage_rigs import GrblRig, StageRig, ZaberRig, grbl_rig, zaber_rig

HEIGHTS_MM = (180.0, 230.25, 290.0)
PLAN = CapturePlan.model_validate(
    {
        "schema": "standoff.plan/1",
        "name": "three heights",
        "heights_mm": HEIGHTS_MM,
        "frames_per_capture": 2,
        "targets": [{"kind": "edge", "target": "edge"}],
    }
)


def run(path: Path, stage: Stage) -> None:
    bench = SimulatedBench(bench_config())
    devices = BenchDevices(
        config=bench_config(), camera=bench.camera, stage=stage, clock=lambda: bench.clock.now_s
    )
    run_plan(path, PLAN, devices, RunOperator(name="test", place=lambda _: "ready"))


GRBL_FAULTS: dict[str, Callable[[GrblRig], object]] = {
    "mute": lambda rig: setattr(rig.line, "faults", LineFaults(mute=True)),
    "unplugged": lambda rig: setattr(rig.line, "faults", LineFaults(unplugged=True)),
    "reset": lambda rig: rig.firmware.press_reset(),
    "brown-out": lambda rig: rig.firmware.power_cycle(),
    "hang": lambda rig: rig.fail(hangs=True),
    "short": lambda rig: rig.fail(stops_short_mm=0.4),
    "creep": lambda rig: setattr(rig.plant, "faults", PlantFaults(creep_mm_per_s=0.1)),
    "hold": lambda rig: rig.fail(shows_state="Hold:0"),
    "alarm": lambda rig: rig.firmware.raise_alarm(1),
}
ZABER_FAULTS: dict[str, Callable[[ZaberRig], object]] = {
    "bad checksums": lambda rig: setattr(rig.line, "faults", LineFaults(swap=b"07")),
    "unplugged": lambda rig: setattr(rig.line, "faults", LineFaults(unplugged=True)),
    "brown-out": lambda rig: rig.firmware.power_cycle(),
    "stall": lambda rig: setattr(rig.plant, "faults", PlantFaults(stalls_above_mm=0.0)),
    "short": lambda rig: rig.fail(stops_short_mm=0.4),
}


def break_off(rig: StageRig, fault: Callable[[], object], path: Path) -> None:
    """A run that a fault ends, after which the faults are healed."""
    rig.stage.home(120)
    rig.stage.move_to(HEIGHTS_MM[0], 120)
    rig.in_mid_move(fault, 1.5)
    with pytest.raises(DeviceError):
        run(path, rig.stage)
    # A move that was under way when the fault came may have ended well.
    assert len(Session(path).records) in (1, 2)
    rig.fail()
    rig.line.faults, rig.plant.faults = LineFaults(), PlantFaults()
    rig.wait(5.0)


@pytest.mark.slow
@pytest.mark.parametrize("fault", GRBL_FAULTS.values(), ids=GRBL_FAULTS)
def test_a_fault_of_a_grbl_stage_stores_nothing_of_its_capture(
    fault: Callable[[GrblRig], object], tmp_path: Path
) -> None:
    rig = grbl_rig()
    break_off(rig, lambda: fault(rig), tmp_path / "session")
    rig.reopen(reset=True)
    run(tmp_path / "session", rig.stage)
    assert_recorded_as_read(tmp_path / "session", 0.004)  # a step
    assert rig.plant.true_height_mm == pytest.approx(HEIGHTS_MM[-1], abs=0.005)


@pytest.mark.parametrize("fault", ZABER_FAULTS.values(), ids=ZABER_FAULTS)
def test_a_fault_of_a_zaber_stage_stores_nothing_of_its_capture(
    fault: Callable[[ZaberRig], object], tmp_path: Path
) -> None:
    rig = zaber_rig()
    break_off(rig, lambda: fault(rig), tmp_path / "session")
    rig.reopen().clear_alarm()
    run(tmp_path / "session", rig.stage)
    assert_recorded_as_read(tmp_path / "session", 0.0005)  # a microstep


def assert_recorded_as_read(path: Path, step_mm: float) -> None:
    recorded_mm = sorted(record.height_mm for record in Session(path).records)
    assert recorded_mm == pytest.approx(HEIGHTS_MM, abs=step_mm)
    # 230.25 mm is between two steps: what was read back was recorded, not what was asked for.
    assert recorded_mm[1] != HEIGHTS_MM[1]
