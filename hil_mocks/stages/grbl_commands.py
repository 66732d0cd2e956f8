"""What a Grbl emulator does with each line."""

from dataclasses import dataclass

from hil_mocks.stages.grbl_lines import (
    DEFAULT_SETTINGS,
    GRBLHAL_SETTINGS,
    STORED_LINES,
    GrblDialect,
    read_jog,
    setting_lines,
    version_lines,
)
from hil_mocks.stages.plant import StagePlant
from hil_mocks.stages.stepper_axis import StepperAxis

LINE_CHARS = 80
NOT_IDLE, LOCKED, LINE_TOO_LONG, BEYOND_TRAVEL = 8, 9, 11, 15
LIMIT_PRESSED, UNLOCKS_BY_HOMING, BLOCKED = 45, 46, 79
HOMING_REQUIRED, LIMIT_AT_START = 11, 12

SINGLE_AXIS, HOMING_LOCK, SETS_ORIGIN = 2, 4, 8
"""Bits of grblHAL's ``$22``."""

QUESTIONS = ("$", "$$", "$I", "$G", "$#", "$N")


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblFaults:
    """Faults of the controller from now on.

    Parameters
    ----------
    hangs
        It neither obeys nor answers; a running move continues.
    shows_state
        It is in this state and reports it, such as ``Hold:0``, ``Door:1`` or ``Sleep``.
    stops_short_mm
        Moves end before their target.
    never_idle
        Its reports never show the end of a move, and the move cannot be cancelled.
    memory_is_blank
        ``$$`` is answered ``error:7``.
    adds_fields
        Fields that newer firmware adds to every report, such as ``|$Q:1|New:a,b``; grblHAL only.
    """

    hangs: bool = False
    shows_state: str | None = None
    stops_short_mm: float = 0.0
    never_idle: bool = False
    memory_is_blank: bool = False
    adds_fields: str = ""


class GrblCommands:
    """The half of a controller that reads lines.

    Parameters
    ----------
    plant
        The mechanics.
    dialect
        ``grbl`` for Grbl 1.1h on an AVR board, ``grblhal`` for grblHAL, ``grbl 0.9``.
    settings
        Replacements for individual `DEFAULT_SETTINGS`.
    work_offset_mm
        A work offset of Z left by another program.
    axes
        Letters of all axes, of which Z moves.
    """

    def __init__(
        self,
        plant: StagePlant,
        *,
        dialect: GrblDialect,
        settings: dict[int, float] | None,
        work_offset_mm: float,
        axes: str,
    ) -> None:
        self.plant = plant
        own = GRBLHAL_SETTINGS if dialect == "grblhal" else {}
        self.settings = {**DEFAULT_SETTINGS, **own, **(settings or {})}
        self.is_homed = False
        self.lines_received: list[str] = []
        self._faults = GrblFaults()
        self._dialect = dialect
        self._work_offset_mm = work_offset_mm
        self._axes = axes
        self._state, self._alarm = "Idle", 0
        self._is_locked = False
        self._output: list[bytes] = []
        self.axis = StepperAxis(
            plant,
            steps_per_mm=self.settings[102],
            acceleration_mm_per_s2=self.settings[122],
        )
        self.axis.count_from(0.0)

    @property
    def state(self) -> str:
        """Its present state."""
        return self._faults.shows_state or self._state

    def take_lines(self) -> list[bytes]:
        """See `Firmware.take_lines`."""
        lines, self._output = self._output, []
        return lines

    @property
    def _is_hal(self) -> bool:
        return self._dialect == "grblhal"

    @property
    def _is_pressed(self) -> bool:
        return self.plant.is_low_pressed or self.plant.is_high_pressed

    def _homing_has(self, bit: int) -> bool:
        return bool(int(self.settings[22]) & bit)

    @property
    def _sets_origin(self) -> bool:
        return self._is_hal and self._homing_has(SETS_ORIGIN)

    @property
    def _homes_down(self) -> bool:
        return bool(int(self.settings[23]) & 4)

    @property
    def _home_mm(self) -> float:
        """Position where homing ends."""
        if self._sets_origin:
            return 0.0
        pull_off, travel = self.settings[27], self.settings[132]
        return -travel + pull_off if self._homes_down else -pull_off

    def _is_beyond_travel(self, target_mm: float) -> bool:
        """Whether a jog is refused; grblHAL's keep off switches that would raise an alarm."""
        if not self.settings[20] or (self._is_hal and not self.is_homed):
            return False
        travel = self.settings[132]
        keep_off = self.settings[27] if self._is_hal and int(self.settings[21]) & 1 else 0.0
        if not self._sets_origin:
            return not -travel + keep_off <= target_mm <= -keep_off
        return not 0.0 <= (target_mm if self._homes_down else -target_mm) <= travel - keep_off

    def _say(self, text: str) -> None:
        if not self._faults.hangs:
            self._output.append(text.encode() + b"\r\n")

    def _run_stored_lines(self) -> None:
        for line in STORED_LINES:
            if line:
                self._say(f">{line}:ok")

    def _take_line(self, line: str) -> None:
        text = "".join(line.split()).upper()
        self.lines_received.append(text)
        error = LINE_TOO_LONG if len(line) >= LINE_CHARS else self._execute(text)
        if error is None:
            return
        if self._dialect == "grbl 0.9" and error:
            self._say("error: Invalid statement")
        else:
            self._say(f"error:{error}" if error else "ok")

    def _execute(self, text: str) -> int | None:
        """Return the error code, 0 for ok, None if the answer comes later."""
        at_rest = self.state in ("Idle", "Alarm")
        if not text:
            return 0
        if text.startswith("$J="):
            return self._jog(text[3:])
        if text.startswith("$H"):
            return self._home(text[2:]) if at_rest else NOT_IDLE
        if text == "$X":
            return self._unlock()
        if text == "$$":
            return self._print_settings()
        if text in QUESTIONS:
            return self._answer_question(text) if at_rest else NOT_IDLE
        if text.startswith("$") and "=" in text:
            return self._enter_setting(text) if at_rest else NOT_IDLE
        if text.startswith("$"):
            return BLOCKED if self._is_locked else 3
        return LOCKED if self.state in ("Alarm", "Jog") else 20

    def _answer_question(self, text: str) -> int:
        lines: list[str] = []
        if text == "$I":
            lines = version_lines(self._dialect, self.settings, self._axes)
        elif text == "$N":
            lines = [f"$N{number}={line}" for number, line in enumerate(STORED_LINES)]
        for line in lines:
            self._say(line)
        return 0

    def _jog(self, text: str) -> int:
        if self._is_locked:
            return BLOCKED
        if self.state not in ("Idle", "Jog"):
            return NOT_IDLE
        words = read_jog(text)
        if isinstance(words, int):
            return words
        target_mm = words.z_mm
        if words.is_incremental:
            target_mm += self.axis.counted_mm
        elif not words.is_machine:
            target_mm += self._work_offset_mm
        if self._is_beyond_travel(target_mm):
            return BEYOND_TRAVEL
        self.axis.go(target_mm, min(words.feed_mm_per_min, self.settings[112]) / 60)
        self._state = "Jog"
        return 0

    def _home(self, letters: str) -> int | None:
        if self._is_locked:
            return BLOCKED
        if not self._homing_has(1) or letters not in ("", "Z"):
            return 5
        if letters and not self._homing_has(SINGLE_AXIS):
            return 5
        self._start_homing()
        return None

    def _start_homing(self) -> None:
        raise NotImplementedError

    def _unlock(self) -> int:
        if self._is_locked:
            return BLOCKED
        if self._state != "Alarm":
            return 0
        if self._is_hal and self._alarm == LIMIT_AT_START and self._is_pressed:
            self._say("[MSG:Check Limits]")
            return LIMIT_PRESSED
        if self._is_hal and self._homing_has(HOMING_LOCK) and not self.is_homed:
            return UNLOCKS_BY_HOMING
        self._say("[MSG:Caution: Unlocked]")
        self._state, self._alarm = "Idle", 0
        return 0

    def _print_settings(self) -> int:
        if self._faults.memory_is_blank:
            return 7
        for line in setting_lines(self.settings, self._dialect):
            self._say(line)
        return 0

    def _enter_setting(self, text: str) -> int:
        name, _, value = text[1:].partition("=")
        try:
            number, entered = int(name), float(value)
        except ValueError:
            return 2
        if number not in self.settings:
            return 3
        if number == 20 and entered and not self._homing_has(1):
            return 10
        self.settings[number] = entered
        return 0
