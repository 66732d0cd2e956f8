"""What every stage does, through the `Stage` contract alone."""

from collections.abc import Callable, Iterator
from functools import partial
from math import inf, nan

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from acquisition.devices import Stage
from acquisition.errors import StageLimitError, StageNotHomedError
from hil_mocks import SimulatedClock, SimulatedStage
from hil_mocks.stages._plant import PlantFaults
from tests.hil_mocks.benches import bench_config
from tests.hil_mocks.stage_rigs import GrblRig, ZaberRig, grbl_rig, manual_stage, zaber_rig

TOLERANCE_MM = 0.01


def _simulated() -> Stage:
    return SimulatedStage(bench_config().stage, clock=SimulatedClock())


def _on_mechanics(make_rig: Callable[[], GrblRig | ZaberRig], faults: PlantFaults) -> Stage:
    rig = make_rig()
    rig.plant.faults = faults
    return rig.stage


STAGES: dict[str, Callable[[], Stage]] = {
    "simulated": _simulated,
    "grbl": lambda: grbl_rig("grbl").stage,
    "grblhal": lambda: grbl_rig("grblhal").stage,
    "grbl homing upwards": lambda: (
        grbl_rig(settings={23: 0}, high_switch_mm=400.5, approach="from_above").stage
    ),
    "zaber": lambda: zaber_rig().stage,
    "manual": lambda: manual_stage()[0],
}
MECHANICS = {
    "lost steps": PlantFaults(slip=2e-5),
    "backlash": PlantFaults(backlash_mm=0.3),
    "compliance": PlantFaults(windup_mm=0.2, relaxation_s=0.3),
    # While a stage settles it sinks by less than a microstep: more would be a move, and an error.
    "creep": PlantFaults(creep_mm_per_s=1e-4),
    "unseen creep": PlantFaults(creep_mm_per_s=0.05, creep_is_seen=False),
}
"""None of them shows in what a driver reads back; `test_stage_mechanics` is about true heights."""

STAGES |= {
    f"{name}, {fault}": partial(_on_mechanics, make_rig, faults)
    for name, make_rig in (("grbl", grbl_rig), ("zaber", zaber_rig))
    for fault, faults in MECHANICS.items()
}


@pytest.fixture(params=STAGES)
def stage(request: pytest.FixtureRequest) -> Iterator[Stage]:
    opened = STAGES[request.param]()
    yield opened
    opened.close()


@pytest.fixture
def homed(stage: Stage) -> Stage:
    stage.home(90)
    return stage


def test_it_is_a_stage(stage: Stage) -> None:
    assert isinstance(stage, Stage)
    assert stage.info.driver
    assert stage.limits_mm[0] < stage.limits_mm[1]


def test_it_does_not_move_before_it_is_homed(stage: Stage) -> None:
    assert not stage.is_homed
    with pytest.raises(StageNotHomedError):
        stage.move_to(100.0, 60)


def test_it_knows_its_position_after_homing(homed: Stage) -> None:
    assert homed.is_homed
    assert homed.state == "idle"
    assert homed.limits_mm[0] <= homed.position_mm() <= homed.limits_mm[1]


def test_a_move_returns_the_height_that_it_reads_back(homed: Stage) -> None:
    for height_mm in (100.0, 250.5, 20.25):
        read_back_mm = homed.move_to(height_mm, 60)
        assert read_back_mm == pytest.approx(height_mm, abs=TOLERANCE_MM)
        assert homed.position_mm() == read_back_mm
        assert homed.state == "idle"


def test_a_height_outside_the_travel_is_refused_and_nothing_moves(homed: Stage) -> None:
    before_mm = homed.position_mm()
    for height_mm in (-inf, -1.0, 9.99, 400.01, 1e9, inf, nan):
        with pytest.raises(StageLimitError):
            homed.move_to(height_mm, 60)
        assert homed.position_mm() == before_mm


def test_both_limits_can_be_reached(homed: Stage) -> None:
    for limit_mm in homed.limits_mm:
        assert homed.move_to(limit_mm, 60) == pytest.approx(limit_mm, abs=TOLERANCE_MM)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=20)
@given(heights_mm=st.lists(st.floats(-50, 500), max_size=4))
def test_it_never_stands_outside_its_limits(homed: Stage, heights_mm: list[float]) -> None:
    low, high = homed.limits_mm
    for height_mm in heights_mm:
        if low <= height_mm <= high:
            homed.move_to(height_mm, 60)
        else:
            with pytest.raises(StageLimitError):
                homed.move_to(height_mm, 60)
        assert low <= homed.position_mm() <= high


def test_a_controlled_stop_keeps_the_position(homed: Stage) -> None:
    homed.move_to(123.0, 60)
    homed.stop()
    assert homed.is_homed
    assert homed.position_mm() == pytest.approx(123.0, abs=TOLERANCE_MM)


def test_an_emergency_stop_voids_the_position_until_homed_again(homed: Stage) -> None:
    homed.emergency_stop()
    assert not homed.is_homed
    homed.clear_alarm()
    with pytest.raises(StageNotHomedError):
        homed.move_to(100.0, 60)
    homed.home(90)
    assert homed.move_to(100.0, 60) == pytest.approx(100.0, abs=TOLERANCE_MM)


def test_closing_twice_is_harmless(stage: Stage) -> None:
    stage.close()
    stage.close()
