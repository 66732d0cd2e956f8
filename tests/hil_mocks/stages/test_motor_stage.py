"""What a motorised stage does whatever its controller: limits, stops, settling, faults.

A controller more costs an entry in `RIGS`.
"""

import contextlib
from collections.abc import Callable
from typing import Any

import pytest

from acquisition.devices import TravellingStage
from acquisition.errors import (
    DeviceError,
    DeviceResetError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
    StageNotStoppedError,
    StageStalledError,
    StageStoppedError,
)
from hil_mocks.stages._plant import PlantFaults
from hil_mocks.stages._serial_stage import LineFaults
from tests.hil_mocks.stage_checks import (
    TARGET_MM,
    assert_nothing_moves,
    assert_stands,
    assert_works_again,
    clear_home_and_work,
)
from tests.hil_mocks.stage_rigs import GrblRig, ZaberRig, grbl_rig, homed_grbl, zaber_rig

Rig = GrblRig | ZaberRig
RIGS: dict[str, Callable[..., Rig]] = {
    "grbl": grbl_rig,
    "grblhal": lambda **keys: grbl_rig("grblhal", **keys),
    "zaber": zaber_rig,
}
BACKLASH_MM = 0.3


@pytest.fixture(params=RIGS)
def controller(request: pytest.FixtureRequest) -> str:
    chosen: str = request.param
    return chosen


@pytest.fixture
def fresh(controller: str) -> Rig:
    """A stage that is connected and has not been homed."""
    return RIGS[controller]()


@pytest.fixture
def rig(fresh: Rig) -> Rig:
    """A stage that has been homed."""
    fresh.stage.home(120)
    return fresh


def interrupt() -> None:
    raise KeyboardInterrupt


def plan_fault(rig: Rig, in_s: float = 2.0, **faults: Any) -> None:
    rig.in_mid_move(lambda: rig.fail(**faults), in_s)


def test_it_shows_its_height_on_the_way(rig: Rig) -> None:
    assert isinstance(rig.stage, TravellingStage)
    assert rig.stage.travel_height_mm() == rig.stage.position_mm()


def test_a_grbl_stage_tells_its_height_to_another_thread_without_sending_anything() -> None:
    rig = homed_grbl("grblhal")
    seen: list[tuple[float | None, float]] = []
    rig.in_mid_move(
        lambda: seen.append((rig.stage.travel_height_mm(), rig.plant.true_height_mm)), 3.0
    )
    before_mm = rig.stage.position_mm()
    rig.stage.move_to(300.0, 120)
    ((told_mm, true_mm),) = seen
    assert told_mm is not None
    assert before_mm < told_mm < 300.0
    # The last report is at most 50 ms old, at 20 mm/s; a line takes some milliseconds.
    assert told_mm == pytest.approx(true_mm, abs=20 * 0.08)


class TestRefusals:
    def test_a_height_that_is_none_is_refused_before_anything_is_sent(self, rig: Rig) -> None:
        sent = len(rig.sent)
        for height_mm in (float("nan"), float("inf"), -1.0, 9.99, 400.01):
            with pytest.raises(StageLimitError) as refused:
                rig.stage.move_to(height_mm, 120)
            assert refused.value.limits_mm == (10.0, 400.0)
            assert refused.value.height_mm == pytest.approx(height_mm, nan_ok=True)
        assert len(rig.sent) == sent

    def test_a_second_move_while_one_runs_is_refused_and_nothing_sent(self, rig: Rig) -> None:
        sent: list[int] = []

        def move_too() -> None:
            before = len(rig.sent)
            with pytest.raises(DeviceError):
                rig.stage.move_to(20.0, 120)
            sent.append(len(rig.sent) - before)

        rig.in_mid_move(move_too)
        assert rig.stage.move_to(TARGET_MM, 120) == pytest.approx(TARGET_MM, abs=0.01)
        assert sent == [0]

    def test_a_stage_that_was_not_homed_tells_no_height_and_does_not_move(self, fresh: Rig) -> None:
        for call in (fresh.stage.position_mm, lambda: fresh.stage.move_to(TARGET_MM, 120)):
            with pytest.raises(StageNotHomedError):
                call()
        assert fresh.stage.travel_height_mm() is None


class TestStops:
    def test_a_stop_in_mid_move_keeps_the_position(self, rig: Rig) -> None:
        rig.in_mid_move(rig.stage.stop, 3.0)
        with pytest.raises(StageStoppedError) as stopped:
            rig.stage.move_to(TARGET_MM, 120)
        assert stopped.value.is_asked
        assert rig.stage.is_homed
        assert 10.5 < rig.stage.position_mm() < TARGET_MM
        assert rig.stage.position_mm() == stopped.value.height_mm
        assert rig.stage.position_mm() == pytest.approx(rig.plant.true_height_mm, abs=rig.round_mm)
        assert_works_again(rig)

    @pytest.mark.slow
    def test_after_a_stop_the_stage_only_ramps_down_whenever_it_comes(self, rig: Rig) -> None:
        at_stop_mm: list[float] = []

        def stop() -> None:
            at_stop_mm.append(rig.plant.true_height_mm)
            rig.stage.stop()

        for in_s in (0.1 * k for k in range(32)):
            rig.stage.move_to(60.0, 120)
            # Downwards to 20.5 mm past the target, then up to it: two moves, 2.9 s in all.
            rig.in_mid_move(stop, in_s)
            with contextlib.suppress(DeviceError):
                rig.stage.move_to(21.0, 120)
            rig.wait(20.0)
            # 1 mm of ramp at 20 mm/s, and what it moves until the stop is heard
            assert abs(rig.plant.true_height_mm - at_stop_mm[-1]) < 1.3, in_s
            assert rig.stage.is_homed, in_s
        assert len(at_stop_mm) == 32

    @pytest.mark.parametrize("is_running", [True, False])
    def test_a_stop_before_all_else_ends_a_move_of_a_program_that_died(
        self, rig: Rig, is_running: bool
    ) -> None:
        if is_running:
            rig.in_mid_move(interrupt)
            with pytest.raises(KeyboardInterrupt):
                rig.stage.move_to(TARGET_MM, 120)
        start_s = rig.clock.now_s
        rig.reopened().stop_first()
        assert rig.clock.now_s - start_s < 0.5
        assert assert_stands(rig) < TARGET_MM - 10.0

    def test_a_controller_that_starts_up_has_ended_its_motion(self, rig: Rig) -> None:
        rig.firmware.power_cycle()
        rig.reopened().stop_first()
        assert_stands(rig)

    def test_a_stop_that_nobody_confirms_is_an_error(self, rig: Rig) -> None:
        rig.in_mid_move(interrupt)
        with pytest.raises(KeyboardInterrupt):
            rig.stage.move_to(TARGET_MM, 120)
        rig.line.faults = LineFaults(mute=True)
        start_s = rig.clock.now_s
        with pytest.raises(StageNotStoppedError):
            rig.reopened().stop_first()
        assert rig.clock.now_s - start_s < 10.0

    def test_a_keyboard_interrupt_in_mid_move_leaves_a_stage_that_can_be_stopped(
        self, rig: Rig
    ) -> None:
        rig.in_mid_move(interrupt)
        with pytest.raises(KeyboardInterrupt):
            rig.stage.move_to(TARGET_MM, 120)
        rig.stage.stop()
        assert assert_stands(rig) < TARGET_MM
        assert rig.stage.is_homed
        assert_works_again(rig)

    def test_a_keyboard_interrupt_while_homing_leaves_a_stage_that_can_be_stopped(
        self, fresh: Rig
    ) -> None:
        fresh.in_mid_move(interrupt)
        with pytest.raises(KeyboardInterrupt):
            fresh.stage.home(120)
        fresh.stage.stop()
        assert assert_stands(fresh) < 150.0
        assert not fresh.stage.is_homed
        fresh.stage.home(120)
        assert_works_again(fresh)

    @pytest.mark.parametrize("in_s", [0.5, 1.5, 2.5])
    def test_a_stop_while_homing_anew_ends_it_whatever_it_does_then(
        self, rig: Rig, in_s: float
    ) -> None:
        # A Grbl stage first creeps to its switch, to find lost steps, and homes then.
        rig.stage.move_to(60.0, 120)
        rig.in_mid_move(rig.stage.stop, in_s)
        with pytest.raises(StageStoppedError) as stopped:
            rig.stage.home(120)
        assert stopped.value.is_asked
        assert assert_stands(rig) > 10.0
        rig.stage.home(120)
        assert_works_again(rig)

    def test_an_emergency_stop_in_mid_move_halts_at_once(self, rig: Rig) -> None:
        rig.in_mid_move(rig.stage.emergency_stop)
        with pytest.raises(DeviceError):
            rig.stage.move_to(TARGET_MM, 120)
        assert rig.plant.true_height_mm < TARGET_MM
        assert rig.stage.state == "alarm"
        for call in (lambda: rig.stage.home(120), lambda: rig.stage.move_to(TARGET_MM, 120)):
            with pytest.raises(StageAlarmError) as refused:
                call()
            assert refused.value.code == "emergency"
        with pytest.raises(StageNotHomedError):
            rig.stage.position_mm()
        assert_stands(rig)
        clear_home_and_work(rig)


class TestTimeLimits:
    def test_a_move_that_takes_too_long_is_stopped_with_its_position_kept(self, rig: Rig) -> None:
        with pytest.raises(DeviceTimeoutError) as late:
            rig.stage.move_to(TARGET_MM, 2.0)
        assert late.value.timeout_s == 2.0
        stopped_mm = assert_stands(rig)
        assert stopped_mm < TARGET_MM
        assert rig.stage.is_homed
        assert rig.stage.position_mm() == pytest.approx(stopped_mm, abs=rig.round_mm)
        assert_works_again(rig)

    def test_homing_that_takes_too_long_is_ended(self, fresh: Rig) -> None:
        with pytest.raises(DeviceTimeoutError) as late:
            fresh.stage.home(3.0)
        assert late.value.timeout_s == 3.0
        assert_stands(fresh)
        assert not fresh.stage.is_homed
        fresh.stage.home(120)
        assert_works_again(fresh)

    def test_a_stage_that_never_stands_is_aborted_and_its_position_void(self, rig: Rig) -> None:
        plan_fault(rig, never_idle=True)
        with pytest.raises(DeviceTimeoutError):
            rig.stage.move_to(TARGET_MM, 30)
        assert not rig.stage.is_homed
        if isinstance(rig, ZaberRig):
            assert "estop" in rig.sent
        rig.fail()
        clear_home_and_work(rig)

    def test_a_stage_that_creeps_after_a_move_is_not_settled(self, rig: Rig) -> None:
        creep = PlantFaults(creep_mm_per_s=0.02 if isinstance(rig, GrblRig) else 0.1)
        rig.in_mid_move(lambda: setattr(rig.plant, "faults", creep), 5.0)
        start_s = rig.clock.now_s
        with pytest.raises(StageStalledError):
            rig.stage.move_to(TARGET_MM, 120)
        # 5.6 s of travel, 2 s in which settling gets no better, and that once more where the
        # readings' last digit made it look better
        assert rig.clock.now_s - start_s < 12.0
        rig.plant.faults = PlantFaults()
        assert_works_again(rig)


class TestProgress:
    def test_a_move_without_progress_ends_after_two_seconds_with_what_is_reported(
        self, rig: Rig
    ) -> None:
        def jam() -> None:
            rig.firmware.axis.halt()
            rig.fail(never_idle=True)

        rig.in_mid_move(jam, 2.0)
        start_s = rig.clock.now_s
        with pytest.raises(StageStalledError) as stalled:
            rig.stage.move_to(TARGET_MM, 120)
        # 2 s of travel, 2 s without progress, 5 s in which it ignores the stop, and the reset
        assert 4.0 < rig.clock.now_s - start_s < 12.0
        assert stalled.value.state == ("Jog" if isinstance(rig, GrblRig) else "BUSY --")
        assert stalled.value.height_mm == pytest.approx(rig.plant.true_height_mm, abs=0.3)
        assert stalled.value.timeout_s == 2.0
        rig.fail()
        clear_home_and_work(rig)

    def test_a_slow_feed_is_progress(self, controller: str) -> None:
        rig = RIGS[controller](feed_mm_per_min=1.0)
        rig.stage.home(300)
        start_mm, start_s = rig.stage.position_mm(), rig.clock.now_s
        assert rig.stage.move_to(start_mm + 0.1, 60) == pytest.approx(start_mm + 0.1, abs=0.01)
        assert rig.clock.now_s - start_s > 6.0

    @pytest.mark.parametrize("shown", ["Door:1", "Hold:0", "Sleep"])
    def test_a_door_that_opens_while_it_settles_ends_the_move_at_once(self, shown: str) -> None:
        rig = grbl_rig(settle_s=5.0)
        rig.stage.home(120)
        rig.stage.move_to(20.0, 120)
        rig.in_mid_move(lambda: rig.fail(shows_state=shown), 3.0)
        start_s = rig.clock.now_s
        with pytest.raises(StageAlarmError) as caught:
            rig.stage.move_to(21.0, 120)  # it arrives within half a second
        assert caught.value.code == shown.partition(":")[0]
        assert rig.clock.now_s - start_s < 6.5

    def test_a_door_that_opens_while_the_home_switch_is_checked_ends_the_homing(self) -> None:
        rig = grbl_rig()
        rig.stage.home(120)
        rig.stage.move_to(60.0, 120)

        def open_door() -> None:
            rig.firmware.axis.brake()
            rig.fail(shows_state="Door:1")

        rig.in_mid_move(open_door, 1.5)
        start_s = rig.clock.now_s
        with pytest.raises(StageAlarmError) as caught:
            rig.stage.home(120)
        assert caught.value.code == "Door"
        assert rig.clock.now_s - start_s < 2.5
        rig.fail()
        clear_home_and_work(rig)


class TestMechanics:
    def test_a_move_that_ends_short_is_an_error(self, rig: Rig) -> None:
        rig.fail(stops_short_mm=0.4)
        with pytest.raises(StageStoppedError) as stopped:
            rig.stage.move_to(TARGET_MM, 120)
        assert not stopped.value.is_asked
        # By hand: 120 mm less 0.4 mm, to half a microstep.
        assert stopped.value.height_mm == pytest.approx(119.6, abs=0.0005)
        assert rig.stage.is_homed
        rig.fail()
        assert_works_again(rig)

    def test_backlash_does_not_show_when_heights_are_approached_from_one_side(
        self, fresh: Rig
    ) -> None:
        fresh.plant.faults = PlantFaults(backlash_mm=BACKLASH_MM)
        fresh.stage.home(120)
        offsets_mm = []
        for height_mm in (200.0, 100.0, 99.9, 100.0, 250.0, 40.0):
            read_back_mm = fresh.stage.move_to(height_mm, 120)
            offsets_mm.append(fresh.plant.true_height_mm - read_back_mm)
        # Homing came from the other flank: the play is in the home offset, and stays there.
        assert offsets_mm == pytest.approx([-BACKLASH_MM] * 6, abs=0.01)
        assert max(offsets_mm) - min(offsets_mm) < 0.0005  # a microstep of the Zaber

    def test_the_flank_is_taken_up_anew_after_a_stop(self, fresh: Rig) -> None:
        fresh.plant.faults = PlantFaults(backlash_mm=BACKLASH_MM)
        fresh.stage.home(120)
        fresh.stage.move_to(300.0, 120)
        fresh.in_mid_move(fresh.stage.stop, 1.0)
        with pytest.raises(StageStoppedError):
            fresh.stage.move_to(100.0, 120)
        near_mm = fresh.stage.position_mm() + 0.1
        assert fresh.stage.move_to(near_mm, 120) == pytest.approx(near_mm, abs=0.01)
        assert fresh.plant.true_height_mm == pytest.approx(near_mm - BACKLASH_MM, abs=0.01)

    def test_vibration_has_died_down_when_a_move_returns(self, controller: str) -> None:
        rig = RIGS[controller](settle_s=2.0)
        rig.stage.home(120)
        rig.plant.faults = PlantFaults(vibration_mm=0.2)
        read_back_mm = rig.stage.move_to(TARGET_MM, 120)
        assert rig.plant.true_height_mm == pytest.approx(read_back_mm, abs=0.01)

    def test_a_home_switch_that_is_not_found_is_an_alarm(self, fresh: Rig) -> None:
        fresh.plant.faults = PlantFaults(home_switch_dead=True)
        with pytest.raises(StageAlarmError) as caught:
            fresh.stage.home(120)
        assert caught.value.code == (9 if isinstance(fresh, GrblRig) else "FS")
        assert not fresh.stage.is_homed
        assert_nothing_moves(fresh, DeviceError)
        fresh.plant.faults = PlantFaults()
        fresh.plant.place(30.0)  # off its end stop, by hand
        clear_home_and_work(fresh)


class TestController:
    @pytest.mark.parametrize("in_s", [0.0, 2.0], ids=["idle", "mid-move"])
    def test_one_that_loses_power_voids_the_position(self, rig: Rig, in_s: float) -> None:
        rig.in_mid_move(rig.firmware.power_cycle, in_s)
        # A Grbl board boots for a while and answers nothing.
        boots = () if isinstance(rig, ZaberRig) else (DeviceTimeoutError,)
        with pytest.raises((DeviceResetError, *boots)):
            rig.stage.move_to(TARGET_MM, 120)
        assert not rig.stage.is_homed
        rig.wait(2.0)
        assert rig.plant.true_height_mm < TARGET_MM
        assert_nothing_moves(rig)
        rig.stage.home(120)
        assert_works_again(rig)

    @pytest.mark.parametrize("in_s", [0.0, 2.0], ids=["idle", "mid-move"])
    def test_one_that_hangs_is_a_timeout(self, rig: Rig, in_s: float) -> None:
        plan_fault(rig, in_s, hangs=True)
        with pytest.raises(DeviceTimeoutError):
            rig.stage.move_to(TARGET_MM, 120)
        rig.fail()
        rig.firmware.power_cycle()
        rig.wait(5.0)
        assert_nothing_moves(rig, DeviceError)
        rig.reopen().home(120)
        assert_works_again(rig)
