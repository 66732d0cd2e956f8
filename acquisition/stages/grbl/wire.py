"""The Grbl 1.1 wire format, grblHAL's additions included: bytes to messages and back.

References
----------
Grbl v1.1 documentation: "Grbl Interface Basics", "Jogging", "Real-time Commands"
(gnea/grbl, doc/markdown). grblHAL additions: banner, ``H:``, alarm sub-states, ``$I`` lines.
"""

import re
from dataclasses import dataclass
from math import isfinite

from acquisition.errors import DeviceProtocolError

STATUS_QUERY = b"?"
FULL_STATUS_QUERY = b"\x87"
"""grblHAL only: a report with every field, the homed one included. Grbl 1.1 drops the byte."""
JOG_CANCEL = b"\x85"
SOFT_RESET = b"\x18"
AXES = "XYZABCUVW"

MAX_LINE_CHARS = 80
"""Grbl's line buffer; a longer line is answered ``error:11``."""

ALARM_TEXTS = {
    1: "a limit switch was hit and the motor stopped at once",
    2: "the target is beyond the travel set in the firmware",
    3: "reset during a move",
    4: "the probe was already triggered",
    5: "the probe was not triggered",
    6: "reset while homing",
    7: "the door was opened while homing",
    8: "the home switch was not released on pull-off",
    9: "the home switch was not found",
    10: "emergency stop",
    11: "homing is required",
    12: "a limit switch is pressed",
    17: "motor driver fault",
}
ERROR_TEXTS = {
    1: "a letter was expected",
    2: "not a number",
    3: "unknown $ command",
    5: "homing is not enabled ($22)",
    7: "the settings memory is blank or unreadable",
    8: "only possible when idle",
    9: "locked by an alarm or a running jog",
    11: "line too long",
    13: "the door is open",
    15: "the target is beyond the travel set in the firmware",
    16: "not a jog",
    18: "the reset input is active",
    45: "a limit switch is pressed",
    46: "homing is required",
    50: "emergency stop is active",
}


@dataclass(frozen=True, slots=True)
class Ok:
    """``ok``: the line was accepted and queued, not yet done."""


@dataclass(frozen=True, slots=True)
class ErrorReply:
    """``error:n``: the line was refused."""

    code: int

    @property
    def text(self) -> str:
        """Code and meaning."""
        return f"error:{self.code} ({ERROR_TEXTS.get(self.code, 'see the manual')})"


@dataclass(frozen=True, slots=True)
class Alarm:
    """``ALARM:n``, which comes unsolicited."""

    code: int

    @property
    def text(self) -> str:
        """Code and meaning."""
        return f"ALARM:{self.code} ({ALARM_TEXTS.get(self.code, 'see the manual')})"


@dataclass(frozen=True, slots=True)
class Banner:
    """The greeting after power-up and after every reset."""

    text: str


@dataclass(frozen=True, slots=True)
class Setting:
    """One line of ``$$``, such as ``$13=0``."""

    number: int
    value: str


@dataclass(frozen=True, slots=True)
class Feedback:
    """``[KIND:text]``."""

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class StartupLine:
    """``>G54:ok``: the controller ran a stored line; its ok answers nothing of ours."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusReport:
    """``<Idle|MPos:..|..>``; positions in the unit of ``$13``, in the order of `AXES`.

    Grbl sends machine or work positions (``$10``), and occasionally the offset between them.
    """

    state: str
    substate: int | None = None
    machine: tuple[float, ...] | None = None
    work: tuple[float, ...] | None = None
    offset: tuple[float, ...] | None = None
    pins: str = ""
    homed: tuple[int, ...] | None = None

    def is_homed(self, axis: str) -> bool:
        """Whether the report says so: grblHAL's ``H:1`` or ``H:flag,mask``."""
        if self.homed is None:
            return False
        if len(self.homed) > 1:
            return bool(self.homed[1] >> AXES.index(axis) & 1)
        return self.homed[0] == 1


GrblMessage = Ok | ErrorReply | Alarm | Banner | Setting | Feedback | StartupLine | StatusReport

_BANNER = re.compile(r"Grbl(HAL)? \d", re.IGNORECASE)
_ALARM = re.compile(r"ALARM:(\d{1,3})(?!\d)")
_ERROR = re.compile(r"error:(\d{1,3})")
_SETTING = re.compile(r"\$(\d{1,4})=(.*)")
_FEEDBACK = re.compile(r"\[([A-Za-z0-9 ]+):(.*)\]")
_STATE = re.compile(r"([A-Z][A-Za-z]*)(?::(\d{1,3}))?")
_FIELD = re.compile(r"[A-Za-z][A-Za-z0-9]*(?::.*)?")
_NUMBER = re.compile(r"-?\d{1,7}(\.\d{1,6})?")


def encode_line(text: str) -> bytes:
    """Encode one command line.

    Raises
    ------
    ValueError
        If Grbl would not accept it as one line.
    """
    if len(text) >= MAX_LINE_CHARS or not (text.isascii() and text.isprintable()):
        raise ValueError(f"not a Grbl line: {text!r}")
    return text.encode("ascii") + b"\n"


def jog_command(axis: str, position_mm: float, feed_mm_per_min: float) -> str:
    """Return the command for an absolute jog in mm and machine coordinates.

    ``G53`` makes it independent of work offsets that another program may have left.

    Raises
    ------
    ValueError
        If a number is not finite or the feed not positive.
    """
    if not (isfinite(position_mm) and isfinite(feed_mm_per_min) and feed_mm_per_min > 0):
        raise ValueError(f"not a jog: {position_mm} mm at {feed_mm_per_min} mm/min")
    return f"$J=G90G21G53{axis}{position_mm:.3f}F{feed_mm_per_min:.1f}"


def parse_line(line: bytes) -> GrblMessage:
    """Parse one line without its end.

    A greeting or an alarm is recognised even after noise: both invalidate the position.

    Raises
    ------
    DeviceProtocolError
        If it is not a Grbl message.
    """
    try:
        text = line.decode("ascii").strip()
    except UnicodeDecodeError:
        text = line.decode("latin-1").strip()
    message = _urgent(text) or _answer(text) or _pushed(text)
    if message is None:
        raise DeviceProtocolError(f"not a Grbl message: {line[:80]!r}")
    return message


def _urgent(text: str) -> GrblMessage | None:
    if text.startswith("[") and not text.startswith("[MSG"):
        return None  # a build-info line may name the firmware
    if found := _BANNER.search(text):
        return Banner(text[found.start() :])
    if found := _ALARM.search(text):
        return Alarm(int(found[1]))
    return None


def _answer(text: str) -> GrblMessage | None:
    if text == "ok":
        return Ok()
    if found := _ERROR.fullmatch(text):
        return ErrorReply(int(found[1]))
    return None


def _pushed(text: str) -> GrblMessage | None:
    if text.startswith("<") and text.endswith(">"):
        return _status(text[1:-1])
    if text.startswith(">") and text.isascii():
        return StartupLine(text[1:])
    if not (text.isascii() and text.isprintable()):
        return None
    if found := _SETTING.fullmatch(text):
        return Setting(int(found[1]), found[2])
    if found := _FEEDBACK.fullmatch(text):
        return Feedback(found[1], found[2])
    return None


def _status(text: str) -> StatusReport | None:
    if not text.isascii():
        return None
    first, *fields = text.split("|")
    state = _STATE.fullmatch(first)
    if not state or not all(_FIELD.fullmatch(field) for field in fields):
        return None
    known: dict[str, str] = {}
    for field in fields:
        name, _, value = field.partition(":")
        if name in known:
            return None  # two merged reports
        known[name] = value
    positions = {name: _numbers(known[name]) for name in ("MPos", "WPos", "WCO") if name in known}
    homed = _flags(known["H"]) if "H" in known else None
    if None in positions.values() or not ("MPos" in known or "WPos" in known):
        return None
    if "H" in known and homed is None:
        return None
    return StatusReport(
        state=state[1],
        substate=int(state[2]) if state[2] else None,
        machine=positions.get("MPos"),
        work=positions.get("WPos"),
        offset=positions.get("WCO"),
        pins=known.get("Pn", ""),
        homed=homed,
    )


def _numbers(text: str) -> tuple[float, ...] | None:
    parts = text.split(",")
    if len(parts) > len(AXES) or not all(_NUMBER.fullmatch(part) for part in parts):
        return None
    return tuple(float(part) for part in parts)


def _flags(text: str) -> tuple[int, ...] | None:
    parts = text.split(",")
    if not all(part.isdecimal() and len(part) <= 4 for part in parts):
        return None
    return tuple(int(part) for part in parts)
