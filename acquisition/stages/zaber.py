"""A Zaber stage, in its ASCII protocol with checksums and message ids.

References
----------
Zaber ASCII Protocol Manual, firmware 7: "Message Format", "Checksumming", "Warning Flags".
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from threading import Event, RLock
from time import monotonic, sleep
from typing import Literal, Self

from acquisition.bench import StageConfig
from acquisition.devices import DeviceInfo, StageState
from acquisition.errors import (
    BenchConfigError,
    DeviceError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceResetError,
    DeviceSettingsError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
)
from acquisition.stages._motor import (
    POLL_S,
    AxisReading,
    AxisTraits,
    MotorStage,
    ProgressWatch,
    smallest_progress_mm,
)
from acquisition.stages._serial_link import SerialLink, open_stage_link

_MESSAGE_IDS = 100
"""Ids run from 0 to 99."""

_MAX_COMMAND_CHARS = 80

_REJECTIONS = {
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
_WARNING_TEXTS = {
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
class _ZaberReply:
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
class _ZaberAlert:
    """``!01 1 IDLE --``: an unsolicited message that the device's state changed."""

    device: int
    axis: int
    is_busy: bool
    warning: str | None
    data: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _ZaberInfo:
    """``#01 1 07 text``: further lines of a reply."""

    device: int
    axis: int
    message_id: int | None
    text: str


_ZaberMessage = _ZaberReply | _ZaberAlert | _ZaberInfo

_REPLY = re.compile(r"@(\d{2}) (\d)(?: (\d{2}))? (OK|RJ) (IDLE|BUSY) (--|[A-Z]{2}) (.+)")
_ALERT = re.compile(r"!(\d{2}) (\d) (IDLE|BUSY) (--|[A-Z]{2})(?: (.*))?")
_INFO = re.compile(r"#(\d{2}) (\d)(?: (\d{2}))?(?: (.*))?")
_CHECKSUM = re.compile(r"(.+):([0-9A-Fa-f]{2})", re.DOTALL)


def checksum(text: str) -> int:
    """Longitudinal redundancy check of a text: ``1 1 07 move abs 40000`` gives 0xB6."""
    return -sum(text.encode("ascii")) & 0xFF


def encode_command(device: int, axis: int, message_id: int, command: str) -> bytes:
    """Encode a command with its id and checksum; an empty one queries the state."""
    body = f"{device} {axis} {message_id:02d}" + (f" {command}" if command else "")
    is_clean = command.isascii() and command.isprintable() and not set(command) & set("/:\\@!#")
    in_range = 0 <= device <= 99 and 0 <= axis <= 9 and 0 <= message_id < _MESSAGE_IDS
    if not (is_clean and in_range and len(body) + 4 < _MAX_COMMAND_CHARS):
        raise ValueError(f"not a Zaber command: {body!r}")
    return f"/{body}:{checksum(body):02X}\n".encode("ascii")


def parse_message(line: bytes) -> _ZaberMessage:
    """Parse one line without its end; a checksum, if present, must be correct."""
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
        return _ZaberReply(
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
        return _ZaberAlert(
            device=int(alert[1]),
            axis=int(alert[2]),
            is_busy=alert[3] == "BUSY",
            warning=_warning(alert[4]),
            data=alert[5] or "",
        )
    if info := _INFO.fullmatch(text):
        return _ZaberInfo(
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


_MAXSPEED_PER_MICROSTEP_PER_S = 1.6384
"""Unit of ``maxspeed``; Zaber ASCII Protocol Manual, "Data conversion"."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _ZaberScale:
    """Conversion between heights and microsteps; ``mm_per_step`` is negative downwards."""

    mm_per_step: float
    offset_mm: float
    limits_mm: tuple[float, float]

    @classmethod
    def of(cls, config: StageConfig) -> Self:
        """Return the scale for a bench file."""
        if config.microstep_um is None:
            raise BenchConfigError(
                "stage.microstep_um is missing; driver 'zaber' requires it",
                keys=("stage.microstep_um",),
            )
        sign = 1 if config.direction == "up" else -1
        return cls(
            mm_per_step=sign * config.microstep_um / 1000,
            offset_mm=config.home_offset_mm,
            limits_mm=config.limits_mm,
        )

    def height_mm(self, steps: float) -> float:
        """Height at a position, without binary rounding noise."""
        return round(steps * self.mm_per_step + self.offset_mm, 6)

    def steps(self, height_mm: float) -> int:
        """Nearest position within the limits."""
        steps = round((height_mm - self.offset_mm) / self.mm_per_step)
        low_mm, high_mm = self.limits_mm
        upwards = 1 if self.mm_per_step > 0 else -1
        if self.height_mm(steps) < low_mm:
            return steps + upwards
        return steps - upwards if self.height_mm(steps) > high_mm else steps

    def maxspeed(self, feed_mm_per_min: float) -> int:
        """Value of ``maxspeed`` for a feed."""
        steps_per_s = feed_mm_per_min / 60 / abs(self.mm_per_step)
        return round(steps_per_s * _MAXSPEED_PER_MICROSTEP_PER_S)


_ANSWER_TIMEOUT_S = 1.0
"""A device answers within a few ms; a chain of many, within a tenth of a second."""

READ_TRIES = 3
_QUIET_S = 0.1
_NOISE_TIMEOUT_S = 3.0


class _ZaberDevice:
    """An axis of a device on an open link; commands have ids, so stale replies are ignored."""

    def __init__(
        self, link: SerialLink, *, device: int, axis: int, clock: Callable[[], float]
    ) -> None:
        self._link = link
        self._device = device
        self._axis = axis
        self._clock = clock
        self._lock = RLock()
        self._next_id = 0
        self._needs_checksum = False

    @property
    def name(self) -> str:
        """Its name in error messages."""
        return self._link.name

    def connect(self) -> None:
        """Wait for silence, then have every reply carry its checksum."""
        with self._lock:
            heard = self._link.drain(_QUIET_S, _NOISE_TIMEOUT_S)
            try:
                reply = self._read_tries("set comm.checksum 1", axis=0)
            except DeviceProtocolError as error:
                raise DeviceProtocolError(
                    f"{error}; is this the right port and baud rate, and does it speak the ASCII "
                    "protocol?"
                ) from error
            except DeviceTimeoutError as error:
                hint = f"; it said {heard[0][:40]!r} before" if heard else ""
                raise DeviceTimeoutError(
                    f"{error}; check its power, the port, baud_rate and device_address, and "
                    f"that it is set to the ASCII protocol, not to the binary one{hint}"
                ) from error
            # Firmware before 6.14 has no such setting and sends no checksums.
            self._needs_checksum = reply.is_ok

    def command(self, text: str, *, axis: int | None = None) -> _ZaberReply:
        """Send a command and return its reply, which may be a rejection."""
        with self._lock:
            message_id = self._next_id
            self._next_id = (self._next_id + 1) % _MESSAGE_IDS
            axis = self._axis if axis is None else axis
            self._link.write(encode_command(self._device, axis, message_id, text))
            deadline = self._clock() + _ANSWER_TIMEOUT_S
            while True:
                line = self._link.read_line(max(deadline - self._clock(), 0.0))
                message = parse_message(line)
                if not isinstance(message, _ZaberReply):
                    continue  # alerts and info lines repeat what replies say
                if message.device != self._device or message.message_id != message_id:
                    continue
                if self._needs_checksum and not message.has_checksum:
                    raise DeviceProtocolError(f"{self.name}: reply without checksum: {line!r}")
                return message

    def ask(self, text: str, *, axis: int | None = None) -> _ZaberReply:
        """Send a command that changes nothing, and repeat it if its reply was lost."""
        reply = self._read_tries(text, axis=axis)
        if not reply.is_ok:
            raise self.rejected(text, reply)
        return reply

    def number(self, setting: str, *, axis: int | None = None) -> float:
        """Value of a setting."""
        data = self.ask(f"get {setting}", axis=axis).data
        try:
            value = float(data.split()[0])
        except (ValueError, IndexError) as error:
            raise DeviceProtocolError(
                f"{self.name}: {setting} is {data!r}, not a number"
            ) from error
        if not isfinite(value):
            raise DeviceProtocolError(f"{self.name}: {setting} is {data!r}, not a number")
        return value

    def check_settings(self, expected: Mapping[str, float]) -> None:
        """Compare settings of the device with those of the bench file."""
        faults = {
            setting: f"{setting} is {found:g}, expected {value:g}"
            for setting, value in expected.items()
            if (found := self.number(setting)) != value
        }
        if faults:
            raise DeviceSettingsError(
                f"{self.name} does not have the settings of the bench file: "
                f"{'; '.join(faults.values())}. Correct the device or expected_settings",
                settings=tuple(faults),
            )

    def warnings(self) -> tuple[str, ...]:
        """All warning flags, the most serious first."""
        count, *flags = self.ask("warnings").data.split()
        if count != f"{len(flags):02d}":
            raise DeviceProtocolError(f"{self.name}: {count} warnings announced, {flags} sent")
        return tuple(flags)

    def rejected(self, text: str, reply: _ZaberReply) -> DeviceRefusalError:
        """Return the error that says why a command was rejected."""
        reason = _REJECTIONS.get(reply.data, "see the protocol manual")
        return DeviceRefusalError(
            f"{self.name} rejects {text!r}: {reply.data} ({reason}); nothing moved",
            code=reply.data,
        )

    def close(self) -> None:
        """Close the link; closing twice is harmless."""
        self._link.close()

    def _read_tries(self, text: str, *, axis: int | None = None) -> _ZaberReply:
        for left in reversed(range(READ_TRIES)):
            try:
                return self.command(text, axis=axis)
            except (DeviceTimeoutError, DeviceProtocolError):
                if not left:
                    raise
        raise AssertionError("unreachable")


_NO_REFERENCE = ("WR", "WH")
_DRIVER_OFF = ("FD", "FO", "FH")


class _ZaberAxis:
    """A `MotorAxis` that moves to absolute positions in microsteps; `connect` begins the dialogue.

    A height is the position times ``microstep_um``, counted upwards, plus ``home_offset_mm``.
    """

    def __init__(
        self,
        config: StageConfig,
        device: _ZaberDevice,
        *,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self.is_position_known = False
        self.warnings: tuple[str, ...] = ()
        self.traits = AxisTraits(
            # An encoder jitters by a few counts.
            repeat_mm=config.tolerance_mm / 2,
            is_homing_cancellable=True,
            # After a reset the device accepts moves from a meaningless position.
            may_move_after=(DeviceTimeoutError, DeviceProtocolError, DeviceResetError),
        )
        self._config = config
        self._device = device
        self._clock = clock
        self._sleep = sleep
        self._scale = _ZaberScale.of(config)
        self._info = DeviceInfo(vendor="", model="", serial_number="", firmware="", driver="zaber")

    def connect(self) -> None:
        """Read its identity, compare its settings and set its speed; moves nothing.

        Without the warnings ``WR`` and ``WH`` its claim to know its position is trusted.
        """
        self._device.connect()
        model = self._device.number("device.id", axis=0)
        self._info = DeviceInfo(
            vendor="Zaber",
            model=f"device {model:.0f}",
            serial_number=self._device.ask("get system.serial", axis=0).data,
            firmware=self._device.ask("get version", axis=0).data,
            driver="zaber",
        )
        self._device.check_settings(self._config.expected_settings)
        speed = self._scale.maxspeed(self._config.feed_mm_per_min)
        if self._device.number("maxspeed") != speed:
            self._device.ask(f"set maxspeed {speed}")
        self.is_position_known = self._has_reference()

    @property
    def name(self) -> str:
        """Its name in error messages."""
        return self._device.name

    @property
    def info(self) -> DeviceInfo:
        """See `Stage.info`."""
        return self._info

    @property
    def homing_s(self) -> float:
        """See `HomingStage`; not asked for."""
        return 0.0

    def state(self) -> StageState:
        """See `MotorAxis.state`."""
        reply = self._device.ask("")
        if (reply.warning or "").startswith("F"):
            return "alarm"
        return "moving" if reply.is_busy else "idle"

    def known_height_mm(self) -> float | None:
        """See `MotorAxis.known_height_mm`."""
        self._is_busy()
        return self.height_mm() if self.is_position_known else None

    def travel_height_mm(self) -> float | None:
        """See `TravellingStage`; messages have ids, so that a query disturbs no move."""
        return self.height_mm()

    def ready_height_mm(self) -> float:
        """See `MotorAxis.ready_height_mm`."""
        self._refuse_faults()
        if not self.is_position_known:
            raise StageNotHomedError(f"{self.name} must be homed before it moves")
        if self._is_busy():
            raise DeviceError(f"{self.name} is moving; stop it or wait")
        return self.height_mm()

    def start_move(self, height_mm: float) -> None:
        """See `MotorAxis.start_move`."""
        steps = self._scale.steps(height_mm)
        reply = self._device.command(f"move abs {steps}")
        if reply.is_ok:
            self._watch(reply.warning)
        elif reply.data == "BADDATA":
            raise StageLimitError(
                f"{self.name} refuses {steps} microsteps as out of range; nothing moved. "
                "limits_mm, microstep_um or home_offset_mm in the bench file does not match the "
                "device",
                height_mm=height_mm,
                limits_mm=None,
            )
        else:
            raise DeviceRefusalError(
                f"{self.name} refuses to move: {reply.data}; nothing moved", code=reply.data
            )

    def wait_until_still(self, height_mm: float, deadline: float) -> float:
        """See `MotorAxis.wait_until_still`; a stalled move is reported with its warning flags."""
        progress = ProgressWatch(
            clock=self._clock, least_mm=smallest_progress_mm(self._config, self.traits)
        )
        while (reply := self._checked()).is_busy:
            at_mm = self.height_mm()
            state = f"BUSY {reply.warning or '--'}"
            progress.see(abs(at_mm - height_mm), state=state, height_mm=at_mm)
            self._pause(at_mm, deadline)
        return self.height_mm()

    def height_mm(self) -> float:
        """See `MotorAxis.height_mm`."""
        return self._scale.height_mm(self._device.number("pos"))

    def reading(self) -> AxisReading:
        """See `MotorAxis.reading`."""
        height_mm, is_moving = self.height_mm(), self._is_busy()
        return AxisReading(
            height_mm=height_mm, is_moving=is_moving, state="BUSY" if is_moving else "IDLE"
        )

    def is_moving(self) -> bool:
        """See `MotorAxis.is_moving`."""
        return self._device.ask("").is_busy

    def cancel(self) -> None:
        """See `MotorAxis.cancel`."""
        self._device.ask("stop")

    def interrupt(self) -> None:
        """See `MotorAxis.interrupt`."""
        self.is_position_known = False
        self._device.ask("estop")

    def abort(self) -> None:
        """See `MotorAxis.abort`."""
        self.interrupt()

    def prepare_homing(self) -> None:
        """See `MotorAxis.prepare_homing`."""
        self._refuse_faults()
        self._device.check_settings(self._config.expected_settings)

    def check_reference(self, deadline: float, stop: Event) -> None:
        """See `MotorAxis.check_reference`; the device detects a stall by itself."""

    def find_reference(self, deadline: float) -> None:
        """See `MotorAxis.find_reference`."""
        reply = self._device.command("home")
        if not reply.is_ok:
            raise self._device.rejected("home", reply)
        self._wait_until_idle(deadline)
        if not self._has_reference():
            raise DeviceError(f"{self.name} found no reference; home it again")

    def refresh_warnings(self) -> None:
        """See `MotorAxis.refresh_warnings`."""
        self._has_reference()

    def clear_alarm(self) -> None:
        """See `MotorAxis.clear_alarm`. After a fault the position is lost: home next."""
        flags = self._device.warnings()
        if any(flag.startswith("F") for flag in flags):
            self.is_position_known = False
        if any(flag in _DRIVER_OFF for flag in flags):
            self._device.ask("driver enable")
        self._device.ask("warnings clear")

    def close(self) -> None:
        """See `MotorAxis.close`."""
        self._device.close()

    def _wait_until_idle(self, deadline: float) -> None:
        while self._is_busy():
            self._pause(self.height_mm(), deadline)

    def _pause(self, at_mm: float, deadline: float) -> None:
        if self._clock() >= deadline:
            raise DeviceTimeoutError(f"it is moving, now at {at_mm:.3f} mm")
        self._sleep(POLL_S)

    def _is_busy(self) -> bool:
        """As `is_moving`, but faults and resets are checked."""
        return self._checked().is_busy

    def _checked(self) -> _ZaberReply:
        """Ask what it is doing; a fault or a reset is an error."""
        reply = self._device.ask("")
        self._watch(reply.warning)
        return reply

    def _has_reference(self) -> bool:
        """Whether no flag denies it; the other flags become `warnings`."""
        flags = self._device.warnings()
        self.warnings = tuple(
            f"{flag}: {_WARNING_TEXTS.get(flag, 'see the protocol manual')}"
            for flag in flags
            if flag not in _NO_REFERENCE
        )
        return not any(flag in _NO_REFERENCE for flag in flags)

    def _watch(self, flag: str | None) -> None:
        """Raise the error that a reply's flag implies."""
        if flag is None:
            return
        if flag.startswith("F"):
            self.is_position_known = False
            text = _WARNING_TEXTS.get(flag, "see the protocol manual")
            raise StageAlarmError(
                f"{self.name} is in alarm: {flag} ({text}); clear the alarm, then home", code=flag
            )
        if flag in _NO_REFERENCE and self.is_position_known:
            self.is_position_known = False
            raise DeviceResetError(
                f"{self.name} was reset or lost power; its position is no longer known: "
                "home it again"
            )

    def _refuse_faults(self) -> None:
        for flag in self._device.warnings():
            self._watch(flag)


def open_zaber_stage(
    config: StageConfig,
    *,
    first: Literal["nothing", "stop"] = "nothing",
    stopped: Callable[[], None] = lambda: None,
) -> MotorStage:
    """Open the port of a bench file and begin the dialogue; moves nothing.

    ``stop`` as ``first`` ends a move that another program left; ``stopped`` is called once the
    stage stands.
    """
    link = open_stage_link(config, name="the Zaber stage")
    device = _ZaberDevice(
        link, device=config.device_address, axis=config.axis_number, clock=monotonic
    )
    axis = _ZaberAxis(config, device, clock=monotonic, sleep=sleep)
    stage = MotorStage(config, axis, clock=monotonic, sleep=sleep)
    try:
        if first == "stop":
            stage.stop_first()
            stopped()
        axis.connect()
    except BaseException:
        stage.close()
        raise
    return stage
