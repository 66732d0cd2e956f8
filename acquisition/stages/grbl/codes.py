"""Alarm and error codes of Grbl 1.1 and grblHAL: what each means, and what to do about it.

References
----------
Grbl v1.1: ``doc/csv/alarm_codes_en_US.csv`` and ``error_codes_en_US.csv`` (gnea/grbl).
grblHAL 1.1f.20260817: ``alarms.h``, ``alarms.c``, ``errors.h`` (grblHAL/core). Alarm 10 differs:
an emergency stop on grblHAL, the second switch of a dual axis on Grbl.
"""

from dataclasses import dataclass

HOMING_REQUIRED = 11
"""Alarm in which grblHAL starts where ``$22`` asks for homing; nothing has gone wrong."""

NOT_IDLE = 8
BEYOND_TRAVEL = 15
LIMIT_PRESSED, UNLOCKS_BY_HOMING = 45, 46
BLOCKED_BY_ALARM = 79
"""grblHAL's answer to what is not a question, from a hard limit until the next reset."""


@dataclass(frozen=True, slots=True)
class AlarmMeaning:
    """What happened, and what to do before the alarm is cleared, if anything."""

    meaning: str
    remedy: str = ""


_PROBE = "nothing here probes: close the program that does, and check the wiring of the probe"

ALARMS = {
    1: AlarmMeaning(
        "a limit switch was hit and the motor stopped at once",
        "free the stage from the switch (if none is pressed, check the wiring of the switches)",
    ),
    2: AlarmMeaning(
        "the target is beyond the travel set in the firmware",
        "compare limits_mm and home_offset_mm with the travel, $130 for X to $132 for Z",
    ),
    3: AlarmMeaning("reset during a move"),
    4: AlarmMeaning("the probe was already triggered", _PROBE),
    5: AlarmMeaning("the probe was not triggered", _PROBE),
    6: AlarmMeaning("reset while homing"),
    7: AlarmMeaning("the door was opened while homing", "close the door"),
    8: AlarmMeaning(
        "the home switch was not released by the pull-off",
        "check the wiring of the home switch, and set a longer pull-off distance $27",
    ),
    9: AlarmMeaning(
        "the home switch was not found",
        "check the wiring of the home switch, the direction $23 and the travel, $130 for X to $132 "
        "for Z; if the switch was found once and not again, set a shorter pull-off distance $27",
    ),
    10: AlarmMeaning(
        "emergency stop, or on Grbl 1.1 the second home switch of an axis with two was not found",
        "release the emergency stop; on Grbl 1.1, check the wiring of the second home switch",
    ),
    HOMING_REQUIRED: AlarmMeaning("homing is required"),
    12: AlarmMeaning("a limit switch is pressed", "free the stage from the switch"),
    13: AlarmMeaning("the probe is protected and was triggered", "free the probe"),
    14: AlarmMeaning(
        "the spindle did not reach its speed",
        "nothing here starts a spindle: close the program that does",
    ),
    15: AlarmMeaning(
        "the second home switch of an axis with two was not found",
        "check the wiring of the second home switch, and that both motors run; a shorter pull-off "
        "distance $27 helps if it was found once",
    ),
    16: AlarmMeaning(
        "the self-test at power-up failed",
        "read the messages in the wire log; the firmware may not be the one for this board",
    ),
    17: AlarmMeaning(
        "motor driver fault", "check the motor's wiring, its supply and the driver's temperature"
    ),
    18: AlarmMeaning(
        "homing failed because it is not set up correctly", "check $22, $23 and $44 to $46"
    ),
    19: AlarmMeaning(
        "a Modbus device did not answer", "check its wiring, or switch it off in the settings"
    ),
    20: AlarmMeaning("the I/O expander did not answer", "check the wiring of the expander"),
    21: AlarmMeaning(
        "the settings memory failed",
        "enter the settings again; replace the board if they are lost once more",
    ),
    22: AlarmMeaning(
        "the input buffer overflowed", "close the program that sends to the controller as well"
    ),
}

ERRORS = {
    1: "a letter was expected",
    2: "not a number",
    3: "unknown $ command",
    4: "the value must not be negative",
    5: "homing is not enabled ($22)",
    6: "the step pulse is too short",
    7: "the settings memory is blank or unreadable",
    NOT_IDLE: "only possible when idle",
    9: "locked by an alarm or a running jog",
    10: "soft limits need homing to be enabled ($22)",
    11: "line too long",
    12: "the step rate is too high",
    13: "the door is open",
    14: "line too long to be stored",
    BEYOND_TRAVEL: "the target is beyond the travel set in the firmware",
    16: "not a jog",
    17: "laser mode needs a PWM output",
    18: "the reset input is active",
    19: "the value must be positive",
    20: "unsupported command",
    22: "no feed rate",
    24: "two commands for the same axes",
    25: "a word is repeated",
    26: "no axis is named",
    33: "not a valid target",
    39: "a value is out of range",
    40: "a tool change is pending",
    43: "the feed rate is too high",
    LIMIT_PRESSED: "a limit switch is pressed",
    UNLOCKS_BY_HOMING: "homing is required",
    49: "the self-test at power-up failed",
    50: "emergency stop is active",
    51: "motor driver fault",
    52: "the setting's value is out of range",
    53: "the setting is not available",
    55: "homing is not set up correctly",
    77: "a password is required",
    78: "access is denied",
    BLOCKED_BY_ALARM: "not possible in this alarm: clear it first",
}


def alarm_text(code: int) -> str:
    """Return code and meaning."""
    known = ALARMS.get(code)
    return f"ALARM:{code} ({'see the manual of its firmware' if known is None else known.meaning})"


def alarm_remedy(code: int) -> str:
    """Return what to do, up to homing."""
    if code == HOMING_REQUIRED:
        return "home it"
    known = ALARMS.get(code)
    if known is None or not known.remedy:
        return "clear the alarm, then home"
    return f"{known.remedy}, then clear the alarm and home"


def error_text(code: int) -> str:
    """Return code and meaning."""
    return f"error:{code} ({ERRORS.get(code, 'see the manual of its firmware')})"
