"""Alarms and errors in words, against the tables of Grbl 1.1 and grblHAL."""

import pytest

from acquisition.stages.grbl_wire import (
    ALARMS,
    BLOCKED_BY_ALARM,
    ERRORS,
    HOMING_REQUIRED,
    Alarm,
    ErrorReply,
)

OBVIOUS = (3, 6)
"""Somebody reset it: there is nothing to look for."""


def test_every_alarm_of_grbl_and_grblhal_has_a_meaning_of_its_own() -> None:
    # Grbl 1.1 has 1 to 10, grblHAL 1.1f.20260817 has 1 to 22.
    assert sorted(ALARMS) == list(range(1, 23))
    assert len({alarm.meaning for alarm in ALARMS.values()}) == len(ALARMS)


@pytest.mark.parametrize("code", ALARMS)
def test_every_alarm_says_what_to_look_for_and_ends_in_homing(code: int) -> None:
    alarm = Alarm(code)
    assert alarm.text == f"ALARM:{code} ({ALARMS[code].meaning})"
    assert "\n" not in alarm.remedy
    assert ("clear the alarm" in alarm.remedy) == (code != HOMING_REQUIRED)
    assert "home" in alarm.remedy
    assert bool(ALARMS[code].remedy) == (code not in (*OBVIOUS, HOMING_REQUIRED))


@pytest.mark.parametrize("code", [8, 9, 15])
def test_a_home_switch_that_is_not_found_or_released_sends_to_wiring_and_pull_off(
    code: int,
) -> None:
    assert "wiring" in Alarm(code).remedy
    assert "$27" in Alarm(code).remedy


def test_the_pull_off_is_to_be_longer_if_it_did_not_release_and_shorter_if_it_lost_the_switch() -> (
    None
):
    # Grbl 1.1: "Try increasing pull-off setting", and "decreasing pull-off distance".
    assert "longer pull-off" in Alarm(8).remedy
    assert "shorter pull-off" in Alarm(9).remedy


def test_alarm_10_is_an_emergency_stop_or_the_second_switch_of_grbl() -> None:
    assert "emergency stop" in Alarm(10).text
    assert "second home switch" in Alarm(10).text


@pytest.mark.parametrize("code", [0, 23, 42, 255])
def test_a_code_that_is_not_known_keeps_its_number_and_the_way_back(code: int) -> None:
    assert f"ALARM:{code} (see the manual" in Alarm(code).text
    assert Alarm(code).remedy == "clear the alarm, then home"
    if code not in ERRORS:
        assert f"error:{code} (see the manual" in ErrorReply(code).text


def test_errors_of_grblhal_beyond_those_of_grbl_have_a_meaning() -> None:
    for code in (45, 46, 50, 52, BLOCKED_BY_ALARM):
        assert "manual" not in ErrorReply(code).text
