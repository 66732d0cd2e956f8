from math import inf, nan
from typing import Any

import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

from acquisition.bench import StageConfig
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
)
from acquisition.stages._control import ManualStage
from acquisition.stages._motor import (
    _approach_heights_mm,
    home_timeout_s,
    move_timeout_s,
    refuse_beyond_limits,
)


def config(**keys: Any) -> StageConfig:
    return StageConfig.model_validate({"driver": "manual", "limits_mm": [10.0, 400.0], **keys})


def hand_stage(of: StageConfig) -> ManualStage:
    """A stage that is never moved."""
    return ManualStage(of, ask=lambda _: "")


@pytest.mark.parametrize("height_mm", [nan, inf, -inf, 9.999, 400.001])
def test_heights_outside_are_refused(height_mm: float) -> None:
    with pytest.raises(StageLimitError) as refused:
        refuse_beyond_limits(height_mm, (10.0, 400.0))
    assert refused.value.limits_mm == (10.0, 400.0)


# Worked by hand for 0.5 mm of backlash, from 100 mm.
@pytest.mark.parametrize(
    ("approach", "target_mm", "is_flank_taken", "stops_mm"),
    [
        ("from_below", 120.0, True, [120.0]),
        ("from_below", 100.0, True, [100.0]),
        ("from_below", 80.0, True, [79.5, 80.0]),
        ("from_below", 100.2, False, [99.7, 100.2]),
        ("from_below", 100.5, False, [100.5]),
        ("from_below", 10.2, True, [10.0, 10.2]),
        ("from_below", 10.0, True, [10.0]),
        ("from_above", 80.0, True, [80.0]),
        ("from_above", 120.0, True, [120.5, 120.0]),
        ("from_above", 400.0, True, [400.0]),
    ],
)
def test_the_target_is_reached_from_one_side(
    approach: str, target_mm: float, is_flank_taken: bool, stops_mm: list[float]
) -> None:
    heights = _approach_heights_mm(
        config(approach=approach),
        start_mm=100.0,
        target_mm=target_mm,
        is_flank_taken=is_flank_taken,
    )
    assert heights == pytest.approx(stops_mm)


@given(st.floats(10, 400), st.floats(10, 400), st.booleans(), st.sampled_from(["below", "above"]))
def test_every_stop_is_within_the_limits_and_the_last_is_the_target(
    start_mm: float, target_mm: float, is_flank_taken: bool, side: str
) -> None:
    heights = _approach_heights_mm(
        config(approach=f"from_{side}"),
        start_mm=start_mm,
        target_mm=target_mm,
        is_flank_taken=is_flank_taken,
    )
    assert heights[-1] == target_mm
    assert all(10 <= height_mm <= 400 for height_mm in heights)


def test_a_move_may_take_twice_the_travel_at_its_feed() -> None:
    slow = config(feed_mm_per_min=60.0, settle_s=1.0)
    assert move_timeout_s(slow) == 10 + 1 + 2 * 390
    assert home_timeout_s(slow, hand_stage(slow)) == 30 + move_timeout_s(slow)


def test_homing_may_take_what_the_controller_states_and_a_quarter_more() -> None:
    quick = config(feed_mm_per_min=6000.0)
    for stated_s in (0.0, 10.0, 1000.0):
        stage = hand_stage(quick)
        stage.homing_s = stated_s  # type: ignore[attr-defined]
        expected_s = 30 + max(move_timeout_s(quick), 1.25 * stated_s)
        assert home_timeout_s(quick, stage) == expected_s


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        ({"driver": "grbl"}, "port"),
        ({"driver": "zaber", "microstep_um": 0.5}, "port"),
        ({"driver": "zaber", "port": "/dev/ttyUSB0"}, "microstep_um"),
        ({"driver": "zaber", "port": "x", "microstep_um": 0.0}, "microstep_um"),
        ({"park_mm": 5.0}, "park_mm"),
        ({"limits_mm": [5.0, 5.0]}, "limits_mm"),
        ({"axis": "Q"}, "axis"),
        ({"device_address": 0}, "device_address"),
        ({"expected_settings": {"$20": "on"}}, "expected_settings"),
        ({"speed_mm_per_s": 5.0}, "speed_mm_per_s"),
    ],
)
def test_a_key_that_is_missing_or_wrong_is_named(keys: dict[str, Any], named: str) -> None:
    with pytest.raises(ValidationError) as refused:
        config(**keys)
    assert named in str(refused.value.errors(include_url=False))


class Operator:
    def __init__(self, *answers: str) -> None:
        self.answers = list(answers)
        self.questions: list[str] = []

    def __call__(self, question: str) -> str:
        self.questions.append(question)
        return self.answers.pop(0)


def by_hand(*answers: str, **keys: Any) -> tuple[ManualStage, Operator]:
    operator = Operator(*answers)
    return ManualStage(config(tolerance_mm=0.5, **keys), ask=operator), operator


class TestManualStage:
    def test_the_height_read_is_returned_not_the_one_asked_for(self) -> None:
        stage, operator = by_hand("150", "120.3 mm")
        stage.home(1)
        assert stage.position_mm() == 150.0
        assert stage.move_to(120.0, 1) == 120.3
        assert stage.position_mm() == 120.3
        assert "120.000 mm, coming from below" in operator.questions[1]

    def test_enter_confirms_the_height(self) -> None:
        stage, _ = by_hand("150", "")
        stage.home(1)
        assert stage.move_to(120.0, 1) == 120.0

    def test_a_decimal_comma_is_understood(self) -> None:
        stage, _ = by_hand("150,5")
        stage.home(1)
        assert stage.position_mm() == 150.5

    def test_what_is_no_height_is_asked_again(self) -> None:
        stage, operator = by_hand("high", "nan", "5", "", "20", "up", "250", "120.1")
        stage.home(1)
        assert stage.position_mm() == 20.0
        assert stage.move_to(120.0, 1) == 120.1
        assert "'up' is not a height" in operator.questions[-2]
        assert "+130.000 mm off" in operator.questions[-1]

    def test_after_five_tries_it_is_an_error_and_the_height_unknown(self) -> None:
        stage, _ = by_hand("150", *["90"] * 5, *["no"] * 5)
        stage.home(1)
        with pytest.raises(DeviceError):
            stage.move_to(120.0, 1)
        assert not stage.is_homed
        with pytest.raises(StageNotHomedError):
            stage.position_mm()
        with pytest.raises(DeviceError):
            stage.home(1)

    def test_an_operator_who_gives_up_leaves_the_height_unknown(self) -> None:
        def give_up(question: str) -> str:
            if question.startswith("Height"):
                return "150"
            raise KeyboardInterrupt

        stage = ManualStage(config(), ask=give_up)
        stage.home(1)
        with pytest.raises(KeyboardInterrupt):
            stage.move_to(120.0, 1)
        assert not stage.is_homed

    def test_nobody_is_asked_for_a_height_beyond_the_limits(self) -> None:
        stage, operator = by_hand("150")
        stage.home(1)
        with pytest.raises(StageLimitError):
            stage.move_to(500.0, 1)
        assert len(operator.questions) == 1
        assert stage.position_mm() == 150.0

    def test_after_an_emergency_nobody_is_asked_before_it_is_cleared(self) -> None:
        stage, operator = by_hand("150")
        stage.home(1)
        stage.emergency_stop()
        assert stage.state == "alarm"
        with pytest.raises(StageAlarmError):
            stage.home(1)
        assert len(operator.questions) == 1

    def test_once_closed_it_asks_nobody_and_tells_no_height(self) -> None:
        stage, operator = by_hand("150")
        stage.home(1)
        stage.close()
        for use in (stage.position_mm, lambda: stage.move_to(120.0, 1), lambda: stage.home(1)):
            with pytest.raises(DeviceDisconnectedError):
                use()
        assert len(operator.questions) == 1
