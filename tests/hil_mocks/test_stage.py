from typing import Literal

import pytest

from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceTimeoutError,
    StageAlarmError,
    StageNotHomedError,
    StageStalledError,
    StageStoppedError,
)
from hil_mocks import SimulatedClock, SimulatedStage, StageFaults
from hil_mocks.devices import RealTimeClock
from tests.hil_mocks.benches import bench_config


def homed_stage(**keys: object) -> tuple[SimulatedStage, SimulatedClock]:
    clock = SimulatedClock()
    stage = SimulatedStage(bench_config(**keys).stage, clock=clock)
    stage.home(60)
    return stage, clock


def test_a_height_between_two_steps_reads_back_as_one_of_them() -> None:
    stage, _ = homed_stage()
    assert stage.move_to(20.25, 60) == 20.248  # 5062.5 steps of 4 um


def test_a_move_takes_the_time_of_its_way_and_its_settling() -> None:
    stage, clock = homed_stage()
    before_s = clock.now_s
    stage.move_to(110.0, 60)
    assert clock.now_s - before_s == pytest.approx(100 / (1200 / 60) + 0.5)


def test_a_move_that_takes_too_long_is_stopped_on_its_way() -> None:
    stage, clock = homed_stage()
    before_s = clock.now_s
    with pytest.raises(DeviceTimeoutError) as refused:
        stage.move_to(110.0, 1.0)
    assert refused.value.timeout_s == 1.0
    assert clock.now_s - before_s == pytest.approx(1.0)
    assert stage.is_homed
    assert stage.position_mm() == pytest.approx(30.0)


@pytest.mark.parametrize("approach", ["from_below", "from_above"])
def test_heights_are_always_approached_from_one_side_so_play_does_not_show(approach: str) -> None:
    stage, _ = homed_stage(stage__approach=approach)
    stage.faults = StageFaults(backlash_mm=0.06)
    for height_mm in (200.0, 100.0, 300.0, 299.9, 299.95):
        read_back_mm = stage.move_to(height_mm, 60)
        assert stage.true_height_mm == read_back_mm


def test_play_shows_where_the_limit_leaves_no_room_for_the_approach() -> None:
    stage, _ = homed_stage()
    stage.faults = StageFaults(backlash_mm=0.06)
    stage.move_to(200.0, 60)
    read_back_mm = stage.move_to(10.0, 60)
    assert stage.true_height_mm - read_back_mm == pytest.approx(0.06)


def test_a_stage_that_never_settles_gives_up_after_two_seconds() -> None:
    stage, clock = homed_stage()
    stage.faults = StageFaults(never_settles=True)
    before_s = clock.now_s
    with pytest.raises(StageStalledError) as refused:
        stage.move_to(50.0, 30.0)
    assert refused.value.timeout_s == 2.0
    assert refused.value.height_mm == 50.0
    # 40 mm at 20 mm/s, and 2 s in which nothing gets better
    assert clock.now_s - before_s == pytest.approx(4.0)
    assert stage.is_homed
    with pytest.raises(DeviceTimeoutError) as late:
        stage.move_to(60.0, 1.0)
    assert late.value.timeout_s == 1.0


@pytest.mark.parametrize("cause", ["door", "hold"])
def test_a_door_ends_a_move_with_what_is_the_matter(cause: Literal["door", "hold"]) -> None:
    stage, clock = homed_stage()
    stage.faults = StageFaults(interrupted_by=cause)
    before_s = clock.now_s
    with pytest.raises(StageAlarmError) as refused:
        stage.move_to(50.0, 30.0)
    assert (refused.value.code, stage.state) == (cause, cause)
    assert clock.now_s - before_s == pytest.approx(1.0)  # half of 40 mm at 20 mm/s
    assert stage.true_height_mm == pytest.approx(30.0)
    with pytest.raises(StageAlarmError):
        stage.clear_alarm()
    stage.faults = StageFaults()
    stage.clear_alarm()
    with pytest.raises(StageNotHomedError):
        stage.move_to(50.0, 30.0)
    stage.home(60.0)
    assert stage.move_to(50.0, 30.0) == 50.0


def test_a_stage_that_stops_short_is_an_error_that_says_where_it_stands() -> None:
    stage, _ = homed_stage()
    stage.faults = StageFaults(stops_short_mm=1.0)
    with pytest.raises(DeviceTimeoutError):
        stage.move_to(50.0, 30.0)
    assert stage.position_mm() == 49.0


def test_lost_steps_are_seen_by_the_camera_only() -> None:
    stage, _ = homed_stage()
    stage.faults = StageFaults(lost_steps_mm=2.0)
    assert stage.move_to(60.0, 30.0) == 60.0
    assert stage.true_height_mm == 58.0


def test_an_alarm_is_named_and_blocks_until_it_is_cleared() -> None:
    stage, _ = homed_stage()
    stage.faults = StageFaults(alarm="hard limit")
    with pytest.raises(StageAlarmError) as refused:
        stage.move_to(50.0, 30.0)
    assert refused.value.code == "hard limit"
    stage.faults = StageFaults()
    assert stage.state == "alarm"
    with pytest.raises(StageAlarmError):
        stage.move_to(50.0, 30.0)
    stage.clear_alarm()
    assert stage.move_to(50.0, 30.0) == 50.0


def test_a_missing_home_switch_leaves_the_stage_unhomed() -> None:
    stage, _ = homed_stage()
    stage.faults = StageFaults(home_switch_missing=True)
    with pytest.raises(DeviceTimeoutError) as refused:
        stage.home(30.0)
    assert refused.value.timeout_s == 30.0
    with pytest.raises(StageNotHomedError):
        stage.position_mm()


def test_an_unplugged_stage_is_disconnected() -> None:
    stage, _ = homed_stage()
    stage.faults = StageFaults(unplugged=True)
    with pytest.raises(DeviceDisconnectedError):
        stage.position_mm()


def test_a_closed_stage_does_nothing_more() -> None:
    stage, _ = homed_stage()
    stage.close()
    with pytest.raises(DeviceDisconnectedError):
        stage.move_to(50.0, 30.0)


def test_time_does_not_run_backwards() -> None:
    with pytest.raises(ValueError):
        SimulatedClock().advance(-1.0)


class Waiting:
    """Real time that a test lets pass, with something that happens meanwhile."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.meanwhile: list[float] = []
        self.stage: SimulatedStage | None = None
        self.stop_after_s: float | None = None

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        if self.stage is not None and seconds > 0:
            assert self.stage.state == "moving"
            self.meanwhile.append(self.stage.travel_height_mm() or 0.0)
            if self.stop_after_s is not None and self.now_s >= self.stop_after_s:
                self.stage.stop()


def stage_in_real_time() -> tuple[SimulatedStage, Waiting]:
    waiting = Waiting()
    clock = RealTimeClock(clock=lambda: waiting.now_s, sleep=waiting.sleep)
    stage = SimulatedStage(bench_config(stage__settle_s=0.0).stage, clock=clock)
    stage.home(60)
    return stage, waiting


def test_in_real_time_a_move_is_seen_on_its_way() -> None:
    stage, waiting = stage_in_real_time()
    before_s = waiting.now_s
    waiting.stage = stage
    assert stage.move_to(50.0, 60) == 50.0
    assert waiting.now_s - before_s == pytest.approx(40 / (1200 / 60), abs=0.06)
    assert len(waiting.meanwhile) >= 39  # slices of 50 ms in 2 s
    assert sorted(waiting.meanwhile) == waiting.meanwhile


def test_in_real_time_a_move_can_be_stopped_and_the_height_is_kept() -> None:
    stage, waiting = stage_in_real_time()
    waiting.stage, waiting.stop_after_s = stage, waiting.now_s + 1.0
    with pytest.raises(StageStoppedError) as refused:
        stage.move_to(110.0, 60)
    assert refused.value.is_asked
    assert stage.state == "idle"
    assert stage.is_homed
    assert stage.position_mm() == pytest.approx(30.0, abs=1.1)  # 20 mm/s for 1 s, from 10 mm
    waiting.stage = None
    assert stage.move_to(40.0, 60) == 40.0


def test_real_time_does_not_run_backwards() -> None:
    with pytest.raises(ValueError):
        RealTimeClock(sleep=lambda _: None).advance(-1.0)
