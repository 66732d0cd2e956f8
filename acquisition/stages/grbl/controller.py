"""The dialogue with a Grbl controller: queries, answers and unsolicited messages."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import RLock
from typing import Literal

from acquisition.errors import (
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceResetError,
    DeviceTimeoutError,
    StageAlarmError,
)
from acquisition.stages.grbl.wire import (
    ERROR_TEXTS,
    FULL_STATUS_QUERY,
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
    parse_line,
)
from acquisition.stages.serial_link import SerialLink

ANSWER_TIMEOUT_S = 2.0
STATUS_TIMEOUT_S = 0.7
"""Grbl reports within 20 ms; writing to the settings memory delays it."""
STATUS_TRIES = 3

QUIET_S = 0.2
"""Silence that counts as such: longer than any pause within an answer."""
NOISE_TIMEOUT_S = 3.0
BOOT_TIMEOUT_S = 5.0
"""An AVR board that opening has reset is in its boot loader for up to 2 s."""

NOT_IDLE = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblFirmware:
    """What ``$I`` reports."""

    family: Literal["Grbl", "grblHAL"]
    version: str
    user_text: str
    board: str


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblAnswer:
    """What came before the ``ok``, or the error instead of it."""

    error: ErrorReply | None
    settings: tuple[Setting, ...]
    feedback: tuple[Feedback, ...]


class GrblController:
    """One controller on an open link: asks and listens, and decides nothing.

    `is_position_known` is set by the code that homes, and reset here by a greeting or an alarm.
    One exchange at a time; a stop may come from another thread.
    """

    def __init__(self, link: SerialLink, *, clock: Callable[[], float]) -> None:
        self.is_position_known = False
        self.firmware: GrblFirmware | None = None
        self.alarm: Alarm | None = None
        self.offset: tuple[float, ...] | None = None
        self.last_report: StatusReport | None = None
        self._link = link
        self._clock = clock
        self._lock = RLock()
        self._is_in_step = False

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

    def get_in_step(self, timeout_s: float = BOOT_TIMEOUT_S, *, may_boot: bool = False) -> None:
        """Synchronise the dialogue: silence, ``$I``, an answer with ``[VER:``.

        Parameters
        ----------
        timeout_s
            For the whole procedure.
        may_boot
            Whether a greeting is expected: after opening and after our own reset.

        Raises
        ------
        DeviceTimeoutError
            If nothing answers.
        DeviceProtocolError
            If what answers is not a Grbl controller.
        StageAlarmError
            If it is in a state in which it answers no queries.
        DeviceResetError
            If it greeted unexpectedly.
        """
        with self._lock:
            self._is_in_step = False
            was_known = self.is_position_known
            deadline = self._clock() + timeout_s
            booted, garbage = self._hush()
            while True:
                self._link.write(encode_line("$I"))
                answer, seen, heard = self._listen_for_version()
                booted |= seen
                garbage = garbage or heard
                if answer is not None and answer.error is None:
                    break
                if answer is not None and answer.error is not None:
                    self._refuse_endless_state(answer.error)
                if self._clock() >= deadline:
                    raise self._no_version(answer, garbage)
                seen, heard = self._hush()
                booted |= seen
                garbage = garbage or heard
            self.firmware = _firmware(answer.feedback)
            # An ok that came late must not answer the next line.
            seen, _ = self._hush()
            self._is_in_step = True
            if booted or seen:
                self._void()
                if not may_boot:
                    raise self._was_reset()
            if was_known and not self.is_position_known and self.alarm and not may_boot:
                raise self._in_alarm(self.alarm)

    def command(self, text: str, timeout_s: float = ANSWER_TIMEOUT_S) -> GrblAnswer:
        """Send one line and wait for its answer.

        Raises
        ------
        DeviceTimeoutError, DeviceProtocolError
            If the answer was lost or garbled; what was sent may have been obeyed.
        StageAlarmError, DeviceResetError
            If an alarm or a greeting came.
        """
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
        """Ask for its position and state; reports need no ``ok``, so the query is repeated.

        Raises
        ------
        DeviceTimeoutError, DeviceProtocolError
            If no readable report came.
        StageAlarmError, DeviceResetError
            If an alarm or a greeting came.
        """
        with self._lock:
            self.hear_unasked()
            query = FULL_STATUS_QUERY if full else STATUS_QUERY
            for left in reversed(range(STATUS_TRIES)):
                self._link.write(query)
                try:
                    return self._report(self._clock() + STATUS_TIMEOUT_S)
                except (DeviceTimeoutError, DeviceProtocolError):
                    if not left:
                        raise
            raise AssertionError("unreachable")

    def hear_unasked(self) -> None:
        """Process unsolicited messages.

        Raises
        ------
        StageAlarmError, DeviceResetError
            If an alarm or a greeting came.
        """
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
        """Reset the controller and synchronise again; the position is lost.

        Raises
        ------
        DeviceTimeoutError, DeviceProtocolError
            If it does not come back.
        """
        with self._lock:
            self._void()
            self._link.write(SOFT_RESET)
            self.get_in_step(may_boot=True)
            self.alarm = None

    def settings(self) -> dict[int, str]:
        """Read all settings.

        Raises
        ------
        DeviceRefusalError
            If the controller cannot read them itself.
        """
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

    def _answer(self, deadline: float) -> GrblAnswer:
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
        return GrblAnswer(error=error, settings=tuple(settings), feedback=tuple(feedback))

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
        message = parse_line(line)
        self._take(message)
        return message

    def _take(self, message: GrblMessage) -> None:
        """Raise what invalidates the position; keep the offset."""
        if isinstance(message, Banner):
            self._void()
            self._is_in_step = False
            raise self._was_reset()
        if isinstance(message, Alarm):
            self._void()
            self._is_in_step = False
            self.alarm = message
            raise self._in_alarm(message)
        if isinstance(message, StatusReport) and message.offset is not None:
            self.offset = message.offset

    def _void(self) -> None:
        self.is_position_known = False
        self.offset = None

    def _in_alarm(self, alarm: Alarm) -> StageAlarmError:
        return StageAlarmError(
            f"{self.name} is in alarm: {alarm.text}; clear the alarm, then home", code=alarm.code
        )

    def _was_reset(self) -> DeviceResetError:
        self._link.remark("unexpected greeting")
        return DeviceResetError(
            f"{self.name} was reset or lost power; its position is no longer known: home it again"
        )

    def _hush(self) -> tuple[bool, bytes]:
        """Wait for silence; return whether a greeting came, and a line that is not Grbl's."""
        return self._sift(self._link.drain(QUIET_S, NOISE_TIMEOUT_S))

    def _sift(self, lines: list[bytes]) -> tuple[bool, bytes]:
        booted, garbage = False, b""
        for line in lines:
            try:
                message = parse_line(line)
            except DeviceProtocolError:
                garbage = line
                continue
            booted |= isinstance(message, Banner)
            if isinstance(message, Alarm):
                self.alarm = message
                self._void()
        return booted, garbage

    def _listen_for_version(self) -> tuple[GrblAnswer | None, bool, bytes]:
        """What came after ``[VER:`` up to the ok; stale answers before it are skipped."""
        booted, garbage = False, b""
        feedback: list[Feedback] = []
        refusal: ErrorReply | None = None
        deadline = self._clock() + ANSWER_TIMEOUT_S / 2
        while True:
            try:
                line = self._link.read_line(max(deadline - self._clock(), 0.0))
            except DeviceTimeoutError:
                stale = GrblAnswer(error=refusal, settings=(), feedback=())
                return (stale if refusal else None), booted, garbage
            seen, heard = self._sift([line])
            booted |= seen
            garbage = garbage or heard
            message = None if heard else parse_line(line)
            if isinstance(message, Feedback) and (feedback or message.kind == "VER"):
                feedback.append(message)
            elif isinstance(message, ErrorReply):
                refusal = message
            elif isinstance(message, Ok) and feedback:
                answer = GrblAnswer(error=None, settings=(), feedback=tuple(feedback))
                return answer, booted, garbage

    def _refuse_endless_state(self, refusal: ErrorReply) -> None:
        """In hold, door and sleep ``$I`` is refused for ever; in motion, until that ends."""
        if refusal.code != NOT_IDLE:
            return
        report = self.status()
        if report.state not in ("Run", "Jog", "Home", "Idle"):
            raise StageAlarmError(
                f"{self.name} is in state {report.state}; close the door or release the hold, "
                "then clear the alarm and home",
                code=report.state,
            )

    def _no_version(self, answer: GrblAnswer | None, garbage: bytes) -> Exception:
        if answer is not None and answer.error is not None and answer.error.code == NOT_IDLE:
            return DeviceTimeoutError(
                f"{self.name} is still moving; stop it, or wait until it has stopped"
            )
        if answer is not None and answer.error is not None:
            return DeviceProtocolError(
                f"{self.name} refuses to report its version: {answer.error.text}"
                + ("" if answer.error.code in ERROR_TEXTS else "; is it a Grbl controller?")
            )
        if garbage:
            return DeviceProtocolError(
                f"{self.name} answers {garbage[:40]!r}, which is not Grbl; "
                "is this the right port and baud rate?"
            )
        if self.alarm is not None:
            return StageAlarmError(
                f"{self.name} has not answered since {self.alarm.text}; clear the alarm, then home",
                code=self.alarm.code,
            )
        return DeviceTimeoutError(
            f"{self.name} does not answer; check its power, the port and the baud rate, "
            "or unlock it, which resets it"
        )


def _firmware(feedback: tuple[Feedback, ...]) -> GrblFirmware:
    lines = {message.kind: message.text for message in feedback}
    version, _, user_text = lines["VER"].partition(":")
    is_hal = lines.get("FIRMWARE", "") == "grblHAL"
    return GrblFirmware(
        family="grblHAL" if is_hal else "Grbl",
        version=version,
        user_text=user_text,
        board=lines.get("BOARD", ""),
    )
