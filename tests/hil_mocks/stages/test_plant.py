from math import e

import pytest
from hypothesis import given, strategies as st

from hil_mocks.stages._grbl import GrblFirmware
from hil_mocks.stages._plant import PlantFaults, StagePlant, StepperAxis

STEP_S = 0.004


def axis_on(plant: StagePlant) -> StepperAxis:
    return StepperAxis(plant, steps_per_mm=250.0, acceleration_mm_per_s2=200.0)


def run(axis: StepperAxis, seconds: float) -> None:
    for _ in range(round(seconds / STEP_S)):
        axis.advance(STEP_S)


def test_a_move_takes_the_time_of_its_trapezium() -> None:
    # 40 mm at 20 mm/s with ramps of 200 mm/s^2: 40/20 + 20/200 = 2.1 s.
    plant = StagePlant(start_mm=100.0)
    axis = axis_on(plant)
    axis.go(40.0, 20.0)
    run(axis, 2.0)
    assert axis.is_moving
    run(axis, 0.2)
    assert not axis.is_moving
    assert (axis.counted_mm, plant.true_height_mm) == pytest.approx((40.0, 140.0))


def test_a_brake_needs_its_ramp_and_keeps_the_count() -> None:
    plant = StagePlant(start_mm=100.0)
    axis = axis_on(plant)
    axis.go(40.0, 20.0)
    run(axis, 1.0)
    before_mm = axis.counted_mm
    axis.brake()
    run(axis, 0.5)
    # v^2 / 2a = 400 / 400 = 1 mm, less half a step of the integration
    assert axis.counted_mm - before_mm == pytest.approx(1.0, abs=0.05)
    assert plant.true_height_mm == pytest.approx(100 + axis.counted_mm, abs=0.001)


@given(st.lists(st.floats(-30, 30), max_size=20))
def test_play_is_never_more_than_the_backlash(moves_mm: list[float]) -> None:
    plant = StagePlant(start_mm=200.0)
    plant.faults = PlantFaults(backlash_mm=0.4)
    motor_mm = 200.0
    for move_mm in moves_mm:
        if 10 < motor_mm + move_mm < 400:
            plant.turn(move_mm)
            motor_mm += move_mm
        assert -1e-9 <= plant.true_height_mm - motor_mm <= 0.4 + 1e-9


def test_a_stall_loses_the_steps_beyond_it() -> None:
    plant = StagePlant(start_mm=50.0)
    plant.faults = PlantFaults(stalls_above_mm=58.0)
    plant.turn(10.0)
    assert (plant.true_height_mm, plant.slipped_mm) == pytest.approx((58.0, 2.0))
    plant.turn(-10.0)
    assert plant.true_height_mm == pytest.approx(48.0)


def test_the_carriage_runs_against_its_end_behind_the_switch() -> None:
    plant = StagePlant(start_mm=50.0)
    plant.turn(-100.0)
    assert plant.is_low_pressed
    assert not plant.is_high_pressed
    assert plant.true_height_mm == pytest.approx(plant.low_switch_mm - 3.0)


def test_vibration_dies_down() -> None:
    plant = StagePlant(start_mm=50.0)
    plant.faults = PlantFaults(vibration_mm=0.1)
    plant.turn(1.0)
    assert plant.true_height_mm == pytest.approx(51.1)
    plant.now_s = 2.0  # ten times its decay
    assert plant.true_height_mm == pytest.approx(51.0, abs=1e-4)


def test_steps_are_lost_upwards_and_add_up() -> None:
    plant = StagePlant(start_mm=50.0)
    plant.faults = PlantFaults(slip=0.01)
    for _ in range(3):
        plant.turn(100.0)
        plant.turn(-100.0)
    assert plant.true_height_mm == pytest.approx(47.0)
    assert plant.slipped_mm == 0.0  # no motor stalled


def test_a_compliant_carriage_lags_and_follows() -> None:
    plant = StagePlant(start_mm=50.0)
    plant.faults = PlantFaults(windup_mm=0.2, relaxation_s=0.3)
    for _ in range(100):
        plant.turn(0.1)
    assert plant.true_height_mm == pytest.approx(59.8)
    plant.now_s = 0.3
    assert plant.true_height_mm == pytest.approx(60.0 - 0.2 / e)
    plant.turn(-0.1)  # part of the spring is still wound up
    assert plant.true_height_mm == pytest.approx(59.9 - 0.2 / e + 0.1)


@pytest.mark.parametrize(("is_seen", "counted_mm"), [(True, -0.5), (False, 0.0)])
def test_creep_is_counted_where_there_is_an_encoder(is_seen: bool, counted_mm: float) -> None:
    firmware = GrblFirmware(StagePlant(start_mm=50.0))
    firmware.plant.faults = PlantFaults(creep_mm_per_s=0.05, creep_is_seen=is_seen)
    firmware.advance(10.0)
    assert firmware.plant.true_height_mm == pytest.approx(49.5)
    assert firmware.axis.counted_mm == pytest.approx(counted_mm)


@given(st.binary(max_size=100))
def test_arbitrary_bytes_never_crash_the_controller_or_move_the_plant(data: bytes) -> None:
    firmware = GrblFirmware(StagePlant(start_mm=150.0))
    firmware.receive(data)
    firmware.advance(1.0)
    firmware.take_lines()
    # It starts in alarm; nothing but $H or $X and a jog moves it.
    if b"$" not in data:
        assert firmware.plant.true_height_mm == 150.0
