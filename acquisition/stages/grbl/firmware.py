"""Which firmware is at the other end, and what to say if it is none that can be driven."""

from dataclasses import dataclass
from typing import Literal

from acquisition.errors import (
    DeviceError,
    DeviceProtocolError,
    DeviceTimeoutError,
    StageAlarmError,
)
from acquisition.stages.grbl.codes import ERRORS, NOT_IDLE
from acquisition.stages.grbl.wire import GRBLHAL, Alarm, ErrorReply, Feedback

SETS_ORIGIN = "Z"
"""Letter in ``[OPT:...]``: homing sets the position to 0 where it ends, not at the switch."""


WAITS_FOR = {
    "Hold": "release the hold",
    "Door": "close the door",
    "Tool": "end the tool change",
    "Check": "end the check mode",
}
"""What a state in which it does not move waits for; nothing but a reset ends the others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblFirmware:
    """What ``$I`` reports."""

    family: Literal["Grbl", "grblHAL"]
    version: str
    user_text: str
    board: str
    sets_origin: bool = False


@dataclass(slots=True)
class Heard:
    """What came besides answers while the dialogue was being synchronised.

    Attributes
    ----------
    booted
        Whether a greeting came.
    garbage
        A line that is not Grbl's.
    old_version
        Version of a Grbl before 1.1, if what came is its.
    """

    booted: bool = False
    garbage: bytes = b""
    old_version: str | None = None


def read_firmware(feedback: tuple[Feedback, ...]) -> GrblFirmware:
    """Read the answer to ``$I``, of which the version is the one line that has to be there."""
    lines = {message.kind: message.text for message in feedback}
    version, _, user_text = lines["VER"].partition(":")
    return GrblFirmware(
        family="grblHAL" if lines.get("FIRMWARE") == GRBLHAL else "Grbl",
        version=version,
        user_text=user_text,
        board=lines.get("BOARD", ""),
        sets_origin=SETS_ORIGIN in lines.get("OPT", "").partition(",")[0],
    )


def too_old_error(name: str, version: str) -> DeviceProtocolError:
    """Return the error for a Grbl that has no jogs and tells its alarms in words."""
    return DeviceProtocolError(
        f"{name} runs Grbl {version}; Grbl 1.1 is needed: flash Grbl 1.1 or grblHAL onto the "
        "controller"
    )


def waiting_error(name: str, state: str) -> StageAlarmError:
    """Return the error for a state that is no alarm, and in which it does not move either."""
    before = f"{WAITS_FOR[state]}, then " if state in WAITS_FOR else ""
    return StageAlarmError(
        f"{name} is in state {state}, in which it does not move; {before}clear the alarm and home",
        code=state,
    )


def in_alarm_error(name: str, alarm: Alarm) -> StageAlarmError:
    """Return the error that tells an alarm with its remedy."""
    return StageAlarmError(f"{name} is in alarm: {alarm.text}; {alarm.remedy}", code=alarm.code)


def no_version_error(
    name: str, refusal: ErrorReply | None, heard: Heard, alarm: Alarm | None
) -> DeviceError:
    """Return the error for a controller that does not report its version."""
    if refusal is not None and refusal.code == NOT_IDLE:
        return DeviceTimeoutError(f"{name} is still moving; stop it, or wait until it has stopped")
    if refusal is not None:
        return DeviceProtocolError(
            f"{name} refuses to report its version: {refusal.text}"
            + ("" if refusal.code in ERRORS else "; is it a Grbl controller?")
        )
    if heard.garbage:
        return DeviceProtocolError(
            f"{name} answers {heard.garbage[:40]!r}, which is not Grbl; "
            "is this the right port and baud rate?"
        )
    if alarm is not None:
        return StageAlarmError(
            f"{name} has not answered since {alarm.text}; {alarm.remedy}", code=alarm.code
        )
    return DeviceTimeoutError(
        f"{name} does not answer; check its power, the port and the baud rate, "
        "or unlock it, which resets it"
    )
