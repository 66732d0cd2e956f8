"""The dialogue with a Grbl controller: queries, answers and unsolicited messages."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import RLock
from typing import Literal

from acquisition.errors import (
    DeviceError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceResetError,
    DeviceTimeoutError,
    StageAlarmError,
)
from acquisition.stages._serial_link import SerialLink
from acquisition.stages.grbl_wire import (
    ERRORS,
    FULL_STATUS_QUERY,
    GRBLHAL,
    HOMING_REQUIRED,
    NOT_IDLE,
    SOFT_RESET,
    STATUS_QUERY,
    Alarm,
    Banner,
    ErrorReply,
    Feedback,
    GrblMessage,
    Ok,
    Setting,
    StatusReport,
    encode_line,
    old_grbl_version,
    parse_line,
    passed_over,
)

_SETS_ORIGIN = "Z"
"""Letter in ``[OPT:...]``: homing sets the position to 0 where it ends, not at the switch."""


_WAITS_FOR = {
    "Hold": "release the hold",
    "Door": "close the door",
    "Tool": "end the tool change",
    "Check": "end the check mode",
}
"""What a state in which it does not move waits for; nothing but a reset ends the others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _GrblFirmware:
    """What ``$I`` reports."""

    family: Literal["Grbl", "grblHAL"]
    version: str
    user_text: str
    board: str
    sets_origin: bool = False


@dataclass(slots=True)
class _Heard:
    """What came while synchronising: a greeting, lines not Grbl's, a version before 1.1."""

    booted: bool = False
    garbage: bytes = b""
    old_version: str | None = None


def _read_firmware(feedback: tuple[Feedback, ...]) -> _GrblFirmware:
    """Read the answer to ``$I``, of which the version is the one line that has to be there."""
    lines = {message.kind: message.text for message in feedback}
    version, _, user_text = lines["VER"].partition(":")
    return _GrblFirmware(
        family="grblHAL" if lines.get("FIRMWARE") == GRBLHAL else "Grbl",
        version=version,
        user_text=user_text,
        board=lines.get("BOARD", ""),
        sets_origin=_SETS_ORIGIN in lines.get("OPT", "").partition(",")[0],
    )


def _too_old_error(name: str, version: str) -> DeviceProtocolError:
    """Return the error for a Grbl that has no jogs and tells its alarms in words."""
    return DeviceProtocolError(
        f"{name} runs Grbl {version}; Grbl 1.1 is needed: flash Grbl 1.1 or grblHAL onto the "
        "controller"
    )


def waiting_error(name: str, state: str) -> StageAlarmError:
    """Return the error for a state that is no alarm, and in which it does not move either."""
    before = f"{_WAITS_FOR[state]}, then " if state in _WAITS_FOR else ""
    return StageAlarmError(
        f"{name} is in state {state}, in which it does not move; {before}clear the alarm and home",
        code=state,
    )


def in_alarm_error(name: str, alarm: Alarm) -> StageAlarmError:
    """Return the error that tells an alarm with its remedy."""
    return StageAlarmError(f"{name} is in alarm: {alarm.text}; {alarm.remedy}", code=alarm.code)


def _no_version_error(
    name: str, refusal: ErrorReply | None, heard: _Heard, alarm: Alarm | None
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
        f"{name} does not answer; check its power, the port and the baud rate, or unlock it, "
        "which resets it; a board that DTR keeps in reset needs stage.release_dtr = true"
    )


_ANSWER_TIMEOUT_S = 2.0
_STATUS_TIMEOUT_S = 0.7
"""Grbl reports within 20 ms; writing to the settings memory delays it."""
_STATUS_TRIES = 3

_QUIET_S = 0.2
"""Silence that counts as such: longer than any pause within an answer."""
_NOISE_TIMEOUT_S = 3.0
_BOOT_TIMEOUT_S = 5.0
"""An AVR board that opening has reset is in its boot loader for up to 2 s."""

_ALARM_IS_OVER = ("Idle", "Run", "Jog", "Home")
"""States that a controller reports only after an alarm was cleared, by whomever."""

_NOTES_MOST = 32
"""Kinds of unknown fields and lines that are noted in the log; on a noisy line there is no end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _GrblAnswer:
    """What came before the ``ok``, or the error instead of it."""

    error: ErrorReply | None
    settings: tuple[Setting, ...]
    feedback: tuple[Feedback, ...]


class GrblController:
    """One controller on an open link: asks and listens, and decides nothing.

    `is_position_known` is set by the code that homes, and reset here by a greeting or an alarm. One
    exchange at a time; a stop may come from another thread.
    """

    def __init__(self, link: SerialLink, *, clock: Callable[[], float]) -> None:
        self.is_position_known = False
        self.firmware: _GrblFirmware | None = None
        self.alarm: Alarm | None = None
        self.offset: tuple[float, ...] | None = None
        self.last_report: StatusReport | None = None
        self._link = link
        self._clock = clock
        self._lock = RLock()
        self._is_in_step = False
        self._noted: set[str] = set()

    @property
    def name(self) -> str:
        """Its name in error messages."""
        return self._link.name

    def lose_step(self) -> None:
        """Trust no further answers until `get_in_step`."""
        self._is_in_step = False

    def send_realtime(self, byte: bytes) -> None:
        """Send one byte that is acted upon at once and not answered."""
        self._link.write(byte)

    def get_in_step(self, timeout_s: float = _BOOT_TIMEOUT_S, *, may_boot: bool = False) -> None:
        """Synchronise the dialogue: silence, perhaps a greeting, ``$I``, the answer ``[VER:``."""
        with self._lock:
            self._is_in_step = False
            was_known = self.is_position_known
            deadline = self._clock() + timeout_s
            heard = _Heard()
            self._hush(heard)
            while True:
                self._link.write(encode_line("$I"))
                answer = self._listen_for_version(heard)
                refusal = None if answer is None else answer.error
                if answer is not None and refusal is None:
                    break
                if heard.old_version is not None:
                    raise _too_old_error(self.name, heard.old_version)
                if refusal is not None:
                    self._refuse_endless_state(refusal)
                if self._clock() >= deadline:
                    raise _no_version_error(self.name, refusal, heard, self.alarm)
                self._hush(heard)
            self.firmware = _read_firmware(answer.feedback)
            # An ok that came late must not answer the next line.
            self._hush(heard)
            self._is_in_step = True
            if heard.booted:
                self._void()
                if not may_boot:
                    raise self._was_reset()
            if was_known and not self.is_position_known and self.alarm and not may_boot:
                raise in_alarm_error(self.name, self.alarm)

    def command(self, text: str, timeout_s: float = _ANSWER_TIMEOUT_S) -> _GrblAnswer:
        """Send one line and wait for its answer."""
        with self._lock:
            if not self._is_in_step:
                self.get_in_step()
            self.hear_unasked()
            self._is_in_step = False
            self._link.write(encode_line(text))
            answer = self._answer(self._clock() + timeout_s)
            self._is_in_step = True
            return answer

    def status(self, *, full: bool = False) -> StatusReport:
        """Ask for its position and state; reports need no ``ok``, so the query is repeated."""
        with self._lock:
            self.hear_unasked()
            query = FULL_STATUS_QUERY if full else STATUS_QUERY
            for left in reversed(range(_STATUS_TRIES)):
                self._link.write(query)
                try:
                    return self._report(self._clock() + _STATUS_TIMEOUT_S)
                except (DeviceTimeoutError, DeviceProtocolError):
                    if not left:
                        raise
            raise AssertionError("unreachable")

    def hear_unasked(self) -> None:
        """Process unsolicited messages."""
        with self._lock:
            for line in self._link.waiting_lines():
                try:
                    message = parse_line(line)
                except DeviceProtocolError:
                    self._is_in_step = False
                    continue
                if isinstance(message, Ok | ErrorReply):
                    self._is_in_step = False
                self._take(message)

    def reset(self) -> None:
        """Reset the controller and synchronise again; the position is lost."""
        with self._lock:
            self._void()
            self._link.write(SOFT_RESET)
            self.get_in_step(may_boot=True)
            self.alarm = None

    def settings(self) -> dict[int, str]:
        """Read all settings."""
        try:
            answer = self.command("$$")
        except (DeviceTimeoutError, DeviceProtocolError):
            answer = self.command("$$")  # a question may be asked twice
        if answer.error is not None:
            raise DeviceRefusalError(
                f"{self.name} refuses to list its settings with {answer.error.text}; restore them "
                "with $RST=$ in a terminal, then enter those of this stage",
                code=answer.error.code,
            )
        return {setting.number: setting.value for setting in answer.settings}

    def close(self) -> None:
        """Close the link; closing twice is harmless."""
        self._link.close()

    def _answer(self, deadline: float) -> _GrblAnswer:
        settings: list[Setting] = []
        feedback: list[Feedback] = []
        while True:
            message = self._next(deadline)
            if isinstance(message, Ok):
                error = None
                break
            if isinstance(message, ErrorReply):
                error = message
                break
            if isinstance(message, Setting):
                settings.append(message)
            if isinstance(message, Feedback):
                feedback.append(message)
        return _GrblAnswer(error=error, settings=tuple(settings), feedback=tuple(feedback))

    def _report(self, deadline: float) -> StatusReport:
        while True:
            message = self._next(deadline)
            if isinstance(message, StatusReport):
                self.last_report = message
                return message
            if isinstance(message, Ok | ErrorReply):
                self._is_in_step = False

    def _next(self, deadline: float) -> GrblMessage:
        line = self._link.read_line(max(deadline - self._clock(), 0.0))
        try:
            message = parse_line(line)
        except DeviceProtocolError:
            version = old_grbl_version(line)
            if version is None:
                raise
            raise _too_old_error(self.name, version) from None
        self._take(message)
        return message

    def _take(self, message: GrblMessage) -> None:
        """Raise what invalidates the position; keep the offset."""
        self._note(message)
        if isinstance(message, Banner):
            self._void()
            self._is_in_step = False
            raise self._was_reset()
        if isinstance(message, Alarm):
            self._is_in_step = False
            self._hear_alarm(message)
            raise in_alarm_error(self.name, message)
        if isinstance(message, StatusReport):
            if message.state == "Alarm":
                self.is_position_known = False
                self._keep_alarm(message.alarm)
            elif message.state in _ALARM_IS_OVER:
                self.alarm = None
            if message.offset is not None:
                self.offset = message.offset

    def _note(self, message: GrblMessage) -> None:
        """Write once to the log what the driver does not know; it goes on without it."""
        for kind in passed_over(message):
            if kind not in self._noted and len(self._noted) < _NOTES_MOST:
                self._noted.add(kind)
                self._link.remark(f"not known, passed over: {kind}")

    def _hear_alarm(self, alarm: Alarm) -> None:
        self._void()
        self._keep_alarm(alarm)

    def _keep_alarm(self, alarm: Alarm | None) -> None:
        """Keep the latest; one that only asks for homing leaves nothing to clear."""
        if alarm is not None and alarm.code != HOMING_REQUIRED:
            self.alarm = alarm

    def _void(self) -> None:
        self.is_position_known = False
        self.offset = None

    def _was_reset(self) -> DeviceResetError:
        self._link.remark("unexpected greeting")
        return DeviceResetError(
            f"{self.name} was reset or lost power; its position is no longer known: home it again"
        )

    def _hush(self, heard: _Heard) -> None:
        """Wait for silence."""
        for line in self._link.drain(_QUIET_S, _NOISE_TIMEOUT_S):
            self._sift(line, heard)

    def _sift(self, line: bytes, heard: _Heard) -> GrblMessage | None:
        """Keep what a line says about the controller itself; None if it is not a message."""
        heard.old_version = old_grbl_version(line) or heard.old_version
        try:
            message = parse_line(line)
        except DeviceProtocolError:
            heard.garbage = heard.garbage or line
            return None
        self._note(message)
        heard.booted |= isinstance(message, Banner)
        if isinstance(message, Alarm):
            self._hear_alarm(message)
        return message

    def _listen_for_version(self, heard: _Heard) -> _GrblAnswer | None:
        """What came after ``[VER:`` up to the ok; stale answers before it are skipped."""
        feedback: list[Feedback] = []
        refusal: ErrorReply | None = None
        deadline = self._clock() + _ANSWER_TIMEOUT_S / 2
        while True:
            try:
                line = self._link.read_line(max(deadline - self._clock(), 0.0))
            except DeviceTimeoutError:
                stale = _GrblAnswer(error=refusal, settings=(), feedback=())
                return stale if refusal else None
            message = self._sift(line, heard)
            if isinstance(message, Feedback) and (feedback or message.kind == "VER"):
                feedback.append(message)
            elif isinstance(message, ErrorReply):
                refusal = message
            elif isinstance(message, Ok) and feedback:
                return _GrblAnswer(error=None, settings=(), feedback=tuple(feedback))

    def _refuse_endless_state(self, refusal: ErrorReply) -> None:
        """In hold, door and sleep ``$I`` is refused for ever; in motion, until that ends."""
        if refusal.code != NOT_IDLE:
            return
        report = self.status()
        if report.state not in ("Run", "Jog", "Home", "Idle"):
            raise waiting_error(self.name, report.state)
