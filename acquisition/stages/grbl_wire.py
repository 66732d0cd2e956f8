"""The Grbl 1.1 wire format, grblHAL's additions included: bytes to messages and back.

What is well formed but unknown is passed over and named, as new firmware adds fields and lines.
What the height or the state hangs on is either read or refused. Alarm and error codes stand with
what each means, and what to do about it.

References
----------
Grbl v1.1 documentation: "Grbl Interface Basics", "Jogging", "Real-time Commands"
(gnea/grbl, doc/markdown); ``doc/csv/alarm_codes_en_US.csv`` and ``error_codes_en_US.csv``.
grblHAL 1.1f.20260817: ``report.c``, ``alarms.h``, ``alarms.c``, ``errors.h`` (grblHAL/core). Alarm
10 differs: an emergency stop on grblHAL, the second switch of a dual axis on Grbl.
Grbl v0.9j, ``report.c`` (grbl/grbl).
"""

import re
from dataclasses import dataclass, field
from math import isfinite

from acquisition.errors import DeviceProtocolError

HOMING_REQUIRED = 11
"""Alarm in which grblHAL starts where ``$22`` asks for homing; nothing has gone wrong."""

NOT_IDLE = 8
BEYOND_TRAVEL = 15
LIMIT_PRESSED, UNLOCKS_BY_HOMING = 45, 46
BLOCKED_BY_ALARM = 79
"""grblHAL's answer to what is not a question, from a hard limit until the next reset."""


@dataclass(frozen=True, slots=True)
class _AlarmMeaning:
    """What happened, and what to do before the alarm is cleared, if anything."""

    meaning: str
    remedy: str = ""


_PROBE = "nothing here probes: close the program that does, and check the wiring of the probe"

ALARMS = {
    1: _AlarmMeaning(
        "a limit switch was hit and the motor stopped at once",
        "free the stage from the switch (if none is pressed, check the wiring of the switches)",
    ),
    2: _AlarmMeaning(
        "the target is beyond the travel set in the firmware",
        "compare limits_mm and home_offset_mm with the travel, $130 for X to $132 for Z",
    ),
    3: _AlarmMeaning("reset during a move"),
    4: _AlarmMeaning("the probe was already triggered", _PROBE),
    5: _AlarmMeaning("the probe was not triggered", _PROBE),
    6: _AlarmMeaning("reset while homing"),
    7: _AlarmMeaning("the door was opened while homing", "close the door"),
    8: _AlarmMeaning(
        "the home switch was not released by the pull-off",
        "check the wiring of the home switch, and set a longer pull-off distance $27",
    ),
    9: _AlarmMeaning(
        "the home switch was not found",
        "check the wiring of the home switch, the direction $23 and the travel, $130 for X to $132 "
        "for Z; if the switch was found once and not again, set a shorter pull-off distance $27",
    ),
    10: _AlarmMeaning(
        "emergency stop, or on Grbl 1.1 the second home switch of an axis with two was not found",
        "release the emergency stop; on Grbl 1.1, check the wiring of the second home switch",
    ),
    HOMING_REQUIRED: _AlarmMeaning("homing is required"),
    12: _AlarmMeaning("a limit switch is pressed", "free the stage from the switch"),
    13: _AlarmMeaning("the probe is protected and was triggered", "free the probe"),
    14: _AlarmMeaning(
        "the spindle did not reach its speed",
        "nothing here starts a spindle: close the program that does",
    ),
    15: _AlarmMeaning(
        "the second home switch of an axis with two was not found",
        "check the wiring of the second home switch, and that both motors run; a shorter pull-off "
        "distance $27 helps if it was found once",
    ),
    16: _AlarmMeaning(
        "the self-test at power-up failed",
        "read the messages in the wire log; the firmware may not be the one for this board",
    ),
    17: _AlarmMeaning(
        "motor driver fault", "check the motor's wiring, its supply and the driver's temperature"
    ),
    18: _AlarmMeaning(
        "homing failed because it is not set up correctly", "check $22, $23 and $44 to $46"
    ),
    19: _AlarmMeaning(
        "a Modbus device did not answer", "check its wiring, or switch it off in the settings"
    ),
    20: _AlarmMeaning("the I/O expander did not answer", "check the wiring of the expander"),
    21: _AlarmMeaning(
        "the settings memory failed",
        "enter the settings again; replace the board if they are lost once more",
    ),
    22: _AlarmMeaning(
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


STATUS_QUERY = b"?"
FULL_STATUS_QUERY = b"\x87"
"""grblHAL only: a report with every field, the homed one included. Grbl 1.1 drops the byte."""
JOG_CANCEL = b"\x85"
SOFT_RESET = b"\x18"
AXES = "XYZABCUVW"
GRBLHAL = "grblHAL"
"""What grblHAL calls itself in ``[FIRMWARE:...]``."""

_MAX_LINE_CHARS = 80
"""Grbl's line buffer; a longer line is answered ``error:11``."""

KNOWN_FIELDS = frozenset((
    "MPos", "WPos", "WCO", "WCS", "Bf", "Ln", "DTG", "F", "FS", "S", "SP1", "SP2", "SP3", "Pn",
    "Ov", "A", "Sc", "AR", "MPG", "H", "D", "T", "P", "TLR", "In", "FW", "SD",
))  # fmt: skip
"""Fields of a report that Grbl 1.1 and grblHAL document, whether or not they are used here."""

KNOWN_STATES: dict[str, tuple[int, ...]] = {
    "Idle": (),
    "Run": (1, 2),
    "Jog": (),
    "Home": (),
    "Hold": (0, 1),
    "Door": (0, 1, 2, 3, 4),
    "Alarm": tuple(ALARMS),
    "Check": (),
    "Sleep": (),
    "Tool": (),
}
"""States and their sub-states."""

_KNOWN_FEEDBACK = frozenset((
    "MSG", "HLP", "GC", "VER", "OPT", "AXS", "NEWOPT", "FIRMWARE", "SIGNALS", "SPINDLES",
    "NVS STORAGE", "FREE MEMORY", "DRIVER", "DRIVER VERSION", "DRIVER OPTIONS", "BOARD",
    "MAX STEP RATE", "COMPATIBILITY LEVEL", "AUX IO", "PLUGIN",
))  # fmt: skip
"""Lines in brackets that come by themselves or in answer to ``$I``."""


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
        return f"error:{self.code} ({ERRORS.get(self.code, 'see the manual of its firmware')})"


@dataclass(frozen=True, slots=True)
class Alarm:
    """``ALARM:n``, which comes unsolicited."""

    code: int

    @property
    def text(self) -> str:
        """Code and meaning."""
        known = ALARMS.get(self.code)
        meaning = "see the manual of its firmware" if known is None else known.meaning
        return f"ALARM:{self.code} ({meaning})"

    @property
    def remedy(self) -> str:
        """What to do, up to homing."""
        if self.code == HOMING_REQUIRED:
            return "home it"
        known = ALARMS.get(self.code)
        if known is None or not known.remedy:
            return "clear the alarm, then home"
        return f"{known.remedy}, then clear the alarm and home"


@dataclass(frozen=True, slots=True)
class Banner:
    """The greeting after power-up and after every reset."""

    text: str


@dataclass(frozen=True, slots=True)
class Setting:
    """One line of ``$$``, such as ``$13=0``; grblHAL's may be texts, such as ``$73=my network``."""

    number: int
    value: str


@dataclass(frozen=True, slots=True)
class _StoredLine:
    """One line of ``$N``, such as ``$N0=G54``: what the controller runs after a start."""

    number: int
    text: str


@dataclass(frozen=True, slots=True)
class Feedback:
    """``[KIND:text]``."""

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class _StartupLine:
    """``>G54:ok``: the controller ran a stored line; its ok answers nothing of ours."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusReport:
    """``<Idle|MPos:..|..>``; positions in the unit of ``$13``, in the order of `AXES`.

    Machine or work positions (``$10``), and now and then the offset; ``passed_over`` names the
    unknown.
    """

    state: str
    substate: int | None = None
    machine: tuple[float, ...] | None = None
    work: tuple[float, ...] | None = None
    offset: tuple[float, ...] | None = None
    pins: str = ""
    homed: tuple[int, ...] | None = None
    passed_over: tuple[str, ...] = field(default=(), compare=False)

    @property
    def alarm(self) -> Alarm | None:
        """The alarm that the sub-state names, as in ``Alarm:1``."""
        return Alarm(self.substate) if self.state == "Alarm" and self.substate else None

    def is_homed(self, axis: str) -> bool:
        """Whether the report says so: grblHAL's ``H:1`` or ``H:flag,mask``."""
        if self.homed is None:
            return False
        if len(self.homed) > 1:
            return bool(self.homed[1] >> AXES.index(axis) & 1)
        return self.homed[0] == 1


GrblMessage = (
    Ok
    | ErrorReply
    | Alarm
    | Banner
    | Setting
    | _StoredLine
    | Feedback
    | _StartupLine
    | StatusReport
)

_BANNER = re.compile(r"Grbl(HAL)? \d", re.IGNORECASE)
_WHOLE_BANNER = re.compile(r"Grbl(HAL)? \d+\.\d+\w* \[", re.IGNORECASE)
_ALARM = re.compile(r"ALARM:(\d{1,3})(?!\d)")
_ERROR = re.compile(r"error:(\d{1,3})")
_SETTING = re.compile(r"\$(\d{1,5})=(.*)")
_STORED_LINE = re.compile(r"\$N(\d{1,2})=(.*)")
_FEEDBACK = re.compile(r"\[([A-Za-z0-9][A-Za-z0-9 ._+-]*):(.*)\]")
_STATE = re.compile(r"([A-Z][A-Za-z]*)(?::(.*))?")
_FIELD_NAME = re.compile(r"[A-Za-z$%#&@_][A-Za-z0-9$%#&@_. -]*")
_NUMBER = re.compile(r"-?\d{1,7}(\.\d{1,9})?")
_OLD_GRBL = re.compile(
    r"Grbl v?(0\.\d+[a-z]?)(?!\w)"  # the greeting
    r"|^\[(0\.\d[a-z]?)\.\d{6,8}:.*\]$"  # the answer to $I
    r"|^<[A-Z][a-z]+,[MW]Pos:.*>$"
    r"|^(?:error|ALARM): [A-Z][A-Za-z0-9 '<>=:./]+$"
)


def encode_line(text: str) -> bytes:
    """Encode one command line."""
    if len(text) >= _MAX_LINE_CHARS or not (text.isascii() and text.isprintable()):
        raise ValueError(f"not a Grbl line: {text!r}")
    return text.encode("ascii") + b"\n"


def jog_command(axis: str, position_mm: float, feed_mm_per_min: float) -> str:
    """Return the command for an absolute jog in mm, independent of work offsets by ``G53``."""
    if not (isfinite(position_mm) and isfinite(feed_mm_per_min) and feed_mm_per_min > 0):
        raise ValueError(f"not a jog: {position_mm} mm at {feed_mm_per_min} mm/min")
    return f"$J=G90G21G53{axis}{position_mm:.3f}F{feed_mm_per_min:.1f}"


def parse_line(line: bytes) -> GrblMessage:
    """Parse a line; greetings and alarms, which invalidate the position, also after noise."""
    try:
        # Texts of grblHAL, such as the name of a network, are UTF-8; noise hardly ever is.
        text = line.decode("utf-8").strip()
        message = _urgent(text) or _answer(text) or _pushed(text)
    except UnicodeDecodeError:
        message = _urgent(line.decode("latin-1").strip())
    if message is None:
        raise DeviceProtocolError(f"not a Grbl message: {line[:80]!r}")
    return message


def old_grbl_version(line: bytes) -> str | None:
    """Return the version of a Grbl before 1.1, from a line that only such a one sends."""
    found = _OLD_GRBL.search(line.decode("latin-1").strip())
    return None if found is None else found[1] or found[2] or "0.9 or older"


def passed_over(message: GrblMessage) -> tuple[str, ...]:
    """Name what is not known of a message, each kind always by the same words."""
    match message:
        case StatusReport():
            return message.passed_over
        case Feedback(kind="VER", text=text) if not text.startswith("1.1"):
            return (f"version {text}",)
        case Feedback(kind="FIRMWARE", text=text) if text != GRBLHAL:
            return (f"firmware {text}",)
        case Feedback() if message.kind not in _KNOWN_FEEDBACK:
            return (f"line [{message.kind}:...]",)
        case Alarm() if message.code not in ALARMS:
            return (f"alarm {message.code}",)
        case _:
            return ()


def _urgent(text: str) -> GrblMessage | None:
    if text.startswith("[") and not text.startswith("[MSG"):
        return None  # a build-info line may name the firmware
    # A setting may too: the name of a network.
    banner = _WHOLE_BANNER if _SETTING.match(text) else _BANNER
    if found := banner.search(text):
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
    if not text.isprintable():
        return None
    if text.startswith(">"):
        return _StartupLine(text[1:])
    if found := _SETTING.fullmatch(text):
        return Setting(int(found[1]), found[2])
    if found := _STORED_LINE.fullmatch(text):
        return _StoredLine(int(found[1]), found[2])
    if found := _FEEDBACK.fullmatch(text):
        return Feedback(found[1], found[2])
    return None


def _status(text: str) -> StatusReport | None:
    # A second report that lost its end or its beginning stands in one of the fields.
    if not (text.isascii() and text.isprintable()) or "<" in text or ">" in text:
        return None
    first, *fields = text.split("|")
    state = _STATE.fullmatch(first)
    known, unknown = _fields(fields)
    if not state or known is None:
        return None
    positions = {name: _numbers(known[name]) for name in ("MPos", "WPos", "WCO") if name in known}
    homed = _flags(known["H"]) if "H" in known else None
    if None in positions.values() or not ("MPos" in known or "WPos" in known):
        return None
    if "H" in known and homed is None:
        return None
    substate = state[2]
    is_number = substate is not None and substate.isdecimal() and len(substate) <= 3
    return StatusReport(
        state=state[1],
        substate=int(substate) if substate is not None and is_number else None,
        machine=positions.get("MPos"),
        work=positions.get("WPos"),
        offset=positions.get("WCO"),
        pins=known.get("Pn", ""),
        homed=homed,
        passed_over=(*_unknown_state(state[1], substate), *unknown),
    )


def _fields(fields: list[str]) -> tuple[dict[str, str] | None, tuple[str, ...]]:
    """Known fields by name, and the others' names; None if one is malformed or comes twice."""
    known: dict[str, str] = {}
    unknown: list[str] = []
    for each in fields:
        name, _, value = each.partition(":")
        if not _FIELD_NAME.fullmatch(name) or name in known:
            return None, ()  # noise, or two merged reports
        if name in KNOWN_FIELDS:
            known[name] = value
        else:
            unknown.append(f"field {name}")
    return known, tuple(unknown)


def _unknown_state(state: str, substate: str | None) -> tuple[str, ...]:
    if state not in KNOWN_STATES:
        return (f"state {state}",)
    if substate is None or substate in map(str, KNOWN_STATES[state]):
        return ()
    return (f"sub-state {state}:{substate}",)


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
