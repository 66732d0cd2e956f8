"""The Zaber ASCII wire format with checksums and message ids: bytes to messages and back.

References
----------
Zaber ASCII Protocol Manual, firmware 7: "Message Format", "Checksumming", "Warning Flags".
"""

import re
from dataclasses import dataclass

from acquisition.errors import DeviceProtocolError

MESSAGE_IDS = 100
"""Ids run from 0 to 99."""

MAX_COMMAND_CHARS = 80

REJECTIONS = {
    "AGAIN": "try again later",
    "BADAXIS": "there is no such axis",
    "BADCOMMAND": "the firmware does not know the command",
    "BADDATA": "the value is out of range",
    "BADMESSAGEID": "bad message id",
    "DEVICEONLY": "for the device, not for an axis",
    "DRIVERDISABLED": "the motor driver is off",
    "FULL": "the command queue is full",
    "INACTIVE": "no motor is connected",
    "LOCKSTEP": "the axis runs in lockstep",
    "NOACCESS": "not allowed",
    "PARKED": "the axis is parked",
    "STATUSBUSY": "the axis is busy",
}
WARNING_TEXTS = {
    "FF": "critical system error",
    "FN": "motor not supported",
    "FZ": "no motor connected",
    "FH": "hardware emergency stop",
    "FV": "supply voltage out of range",
    "FO": "motor driver off",
    "FC": "inrush current too high",
    "FM": "motor too hot",
    "FD": "motor driver off after a fault",
    "FQ": "encoder error",
    "FI": "index error",
    "FA": "encoder synchronisation error",
    "FR": "overdrive limit exceeded",
    "FS": "stalled and stopped",
    "FB": "stream bounds error",
    "FP": "left the interpolated path",
    "FE": "limit error: a limit switch was not where it should be",
    "FT": "excessive twist",
    "WL": "a limit switch was hit unexpectedly",
    "WV": "supply voltage low or high",
    "WT": "controller hot",
    "WS": "stalled and recovered",
    "WM": "displaced while stationary",
    "WP": "invalid calibration",
    "WR": "no reference position",
    "WH": "not homed",
    "NC": "moved with the knob",
    "NI": "movement interrupted",
    "ND": "stream discontinuity",
    "NR": "value rounded",
    "NT": "value truncated",
    "NU": "setting update pending",
    "NJ": "joystick calibrating",
    "NB": "firmware update mode",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ZaberReply:
    """``@01 1 07 OK IDLE -- 0``; rejected: ``is_ok`` False and the reason in ``data``."""

    device: int
    axis: int
    message_id: int | None
    is_ok: bool
    is_busy: bool
    warning: str | None
    data: str
    has_checksum: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ZaberAlert:
    """``!01 1 IDLE --``: an unsolicited message that the device's state changed."""

    device: int
    axis: int
    is_busy: bool
    warning: str | None
    data: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ZaberInfo:
    """``#01 1 07 text``: further lines of a reply."""

    device: int
    axis: int
    message_id: int | None
    text: str


ZaberMessage = ZaberReply | ZaberAlert | ZaberInfo

_REPLY = re.compile(r"@(\d{2}) (\d)(?: (\d{2}))? (OK|RJ) (IDLE|BUSY) (--|[A-Z]{2}) (.+)")
_ALERT = re.compile(r"!(\d{2}) (\d) (IDLE|BUSY) (--|[A-Z]{2})(?: (.*))?")
_INFO = re.compile(r"#(\d{2}) (\d)(?: (\d{2}))?(?: (.*))?")
_CHECKSUM = re.compile(r"(.+):([0-9A-Fa-f]{2})", re.DOTALL)


def checksum(text: str) -> int:
    """Longitudinal redundancy check of the text between the first character and the colon.

    ``1 1 07 move abs 40000`` gives 0xB6.
    """
    return -sum(text.encode("ascii")) & 0xFF


def encode_command(device: int, axis: int, message_id: int, command: str) -> bytes:
    """Encode a command with its id and checksum; an empty one queries the state.

    Raises
    ------
    ValueError
        If the device would not accept it as one command.
    """
    body = f"{device} {axis} {message_id:02d}" + (f" {command}" if command else "")
    is_clean = command.isascii() and command.isprintable() and not set(command) & set("/:\\@!#")
    in_range = 0 <= device <= 99 and 0 <= axis <= 9 and 0 <= message_id < MESSAGE_IDS
    if not (is_clean and in_range and len(body) + 4 < MAX_COMMAND_CHARS):
        raise ValueError(f"not a Zaber command: {body!r}")
    return f"/{body}:{checksum(body):02X}\n".encode("ascii")


def parse_message(line: bytes) -> ZaberMessage:
    """Parse one line without its end; a checksum, if present, must be correct.

    Raises
    ------
    DeviceProtocolError
        If it is not a message of the protocol, or its checksum is wrong.
    """
    try:
        text = line.decode("ascii").strip()
    except UnicodeDecodeError as error:
        raise DeviceProtocolError(f"not a Zaber message: {line[:80]!r}") from error
    if not text.isprintable():
        raise DeviceProtocolError(f"not a Zaber message: {line[:80]!r}")
    found = _CHECKSUM.fullmatch(text)
    if found:
        if checksum(found[1][1:]) != int(found[2], 16):
            raise DeviceProtocolError(f"wrong checksum: {line[:80]!r}")
        text = found[1]
    if reply := _REPLY.fullmatch(text):
        return ZaberReply(
            device=int(reply[1]),
            axis=int(reply[2]),
            message_id=_optional(reply[3]),
            is_ok=reply[4] == "OK",
            is_busy=reply[5] == "BUSY",
            warning=_warning(reply[6]),
            data=reply[7],
            has_checksum=found is not None,
        )
    if alert := _ALERT.fullmatch(text):
        return ZaberAlert(
            device=int(alert[1]),
            axis=int(alert[2]),
            is_busy=alert[3] == "BUSY",
            warning=_warning(alert[4]),
            data=alert[5] or "",
        )
    if info := _INFO.fullmatch(text):
        return ZaberInfo(
            device=int(info[1]),
            axis=int(info[2]),
            message_id=_optional(info[3]),
            text=info[4] or "",
        )
    raise DeviceProtocolError(f"not a Zaber message: {line[:80]!r}")


def _optional(digits: str | None) -> int | None:
    return None if digits is None else int(digits)


def _warning(flag: str) -> str | None:
    return None if flag == "--" else flag
