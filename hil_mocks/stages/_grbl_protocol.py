"""What a Grbl emulator says, in each of its dialects, what it reads in lines, and how it homes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Self

from hil_mocks.stages._plant import StagePlant, StepperAxis

MM_PER_INCH = 25.4

MACHINE_POSITION, BUFFERS, FEED, PINS, OFFSET, OVERRIDES = 1, 2, 8, 16, 32, 64
ALARM_SUBSTATE = 1024
WHEN_HOMING = 4096
"""Bits of grblHAL's ``$10``."""

HOMES_SINGLE_AXES = 2
"""Bit of grblHAL's ``$22``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reported:
    """What a report is about; heights, offset and feed are those of Z."""

    state: str
    alarm: int  # code, 0 for none
    height_mm: float
    work_offset_mm: float
    feed_mm_per_min: float
    is_pressed: bool  # a switch is
    is_homed: bool
    is_blocked: bool  # nothing but a reset ends the alarm
    settings: Mapping[int, float]
    count: int  # reports since the reset
    axes: str  # letters of all
    everything: bool  # every field was asked for

    @property
    def unit(self) -> float:
        """Length that is reported for 1 mm."""
        return 1 / MM_PER_INCH if self.settings[13] else 1.0

    def positions(self, z_mm: float) -> str:
        """Position of every axis, all but Z at 0."""
        each = (z_mm * self.unit if letter == "Z" else 0.0 for letter in self.axes)
        return ",".join(f"{position:.3f}" for position in each)


def old_report(seen: Reported) -> str:
    """Return the report of Grbl 0.9."""
    return (
        f"<{seen.state.partition(':')[0]},MPos:{seen.positions(seen.height_mm)},"
        f"WPos:{seen.positions(seen.height_mm - seen.work_offset_mm)}>"
    )


def grbl_report(seen: Reported) -> str:
    """Return the report of Grbl 1.1."""
    shows_machine = int(seen.settings[10]) & MACHINE_POSITION
    fields = [
        seen.state,
        _position(seen, shows_machine=bool(shows_machine)),
        f"Bf:15,128|FS:{seen.feed_mm_per_min * seen.unit:.0f},0",
    ]
    if seen.is_pressed:
        fields.append("Pn:Z")
    if seen.count % 10 == 0:
        fields.append(_offset(seen))
    elif seen.count % 10 == 1:
        fields.append("Ov:100,100,100")
    return f"<{'|'.join(fields)}>"


def grblhal_report(seen: Reported, *, adds_homed: bool, adds: str) -> str:
    """Return the report of grblHAL, with the field of the homed axes and with others added."""
    bits, full = int(seen.settings[10]), seen.everything
    names_alarm = seen.state == "Alarm" and seen.alarm and (full or bits & ALARM_SUBSTATE)
    mask = f",{4 * seen.is_homed}" if int(seen.settings[22]) & HOMES_SINGLE_AXES else ""
    fields = (
        (True, f"Alarm:{seen.alarm}" if names_alarm else seen.state),
        (True, _position(seen, shows_machine=bool(bits & MACHINE_POSITION))),
        (bits & BUFFERS, "Bf:100,1023"),
        (bits & FEED, f"FS:{seen.feed_mm_per_min * seen.unit:.0f},0"),
        (bits & PINS and seen.is_pressed, "Pn:Z"),
        (bits & OFFSET and (full or seen.count % 10 == 1), _offset(seen)),
        (full, "WCS:G54"),
        (bits & OVERRIDES and (full or seen.count % 10 == 0), "Ov:100,100,100|A:"),
        (full, "Sc:|MPG:0"),
        (full or adds_homed, f"H:{int(seen.is_homed)}{mask}"),
        (full, "T:0|P:0|TLR:0|FW:grblHAL"),
        (full and seen.is_blocked, "$C:1"),
    )
    return f"<{'|'.join(text for is_shown, text in fields if is_shown)}{adds}>"


def _offset(seen: Reported) -> str:
    return f"WCO:{seen.positions(seen.work_offset_mm)}"


def _position(seen: Reported, *, shows_machine: bool) -> str:
    shift_mm = 0.0 if shows_machine else seen.work_offset_mm
    return f"{'MPos' if shows_machine else 'WPos'}:{seen.positions(seen.height_mm - shift_mm)}"


GrblDialect = Literal["grbl", "grblhal", "grbl 0.9"]

DEFAULT_SETTINGS: dict[int, float] = {
    0: 10, 1: 255, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.01, 12: 0.002, 13: 0,
    20: 1, 21: 0, 22: 1, 23: 4, 24: 60, 25: 1200, 26: 250, 27: 1, 30: 1000, 31: 0, 32: 0,
    100: 250, 101: 250, 102: 250, 110: 3000, 111: 3000, 112: 3000,
    120: 200, 121: 200, 122: 200, 130: 400, 131: 400, 132: 400,
}  # fmt: skip
"""As entered for the simulated stage: homing downwards, travel 400 mm, 4 um per step."""

GRBLHAL_SETTINGS: dict[int, float] = {
    10: 511, 14: 0, 39: 1, 40: 0, 43: 1, 44: 4, 45: 0, 46: 0, 62: 0, 63: 3, 64: 1, 65: 0,
    341: 0, 346: 1, 384: 0, 398: 100, 481: 0, 486: 0, 676: 15,
}  # fmt: skip
"""What grblHAL has besides; ``$64=1`` has it start in alarm, as Grbl 1.1 does."""

GRBLHAL_TEXTS = {70: "7", 73: "1", 74: "Werkstatt Süd", 75: "", 300: "Grbl 2", 302: "192.168.5.1"}
"""Settings that are texts; ``$300`` is the name in the network."""

STORED_LINES = ("G54", "")
"""Run by grblHAL after a start without alarm, and after homing."""

GREETINGS: dict[GrblDialect, str] = {
    "grbl": "Grbl 1.1h ['$' for help]",
    "grblhal": "GrblHAL 1.1f ['$' or '$HELP' for help]",
    "grbl 0.9": "Grbl 0.9j ['$' for help]",
}

FACTORY_SETTINGS = {**DEFAULT_SETTINGS, 20: 0, 22: 0, 23: 0, 102: 800}

EXPECTED_COMMAND_LETTER, BAD_NUMBER, NOT_A_JOG = 1, 2, 16
NO_FEED, WORD_REPEATED, NO_AXIS = 22, 25, 26


@dataclass(frozen=True, slots=True, kw_only=True)
class _JogWords:
    """A jog of Z in mm and mm/min."""

    z_mm: float
    feed_mm_per_min: float
    is_incremental: bool
    is_machine: bool


def setting_lines(settings: dict[int, float], dialect: GrblDialect) -> list[str]:
    """Return the lines of ``$$``, in the order of their numbers."""
    lines = {}
    for number, value in settings.items():
        is_float = number in (11, 12, 24, 25, 27) or 100 <= number <= 132
        lines[number] = f"{value:.3f}" if is_float else f"{value:g}"
    if dialect == "grblhal":
        lines |= GRBLHAL_TEXTS
    return [f"${number}={lines[number]}" for number in sorted(lines)]


def version_lines(dialect: GrblDialect, settings: dict[int, float], axes: str) -> list[str]:
    """Return the lines of ``$I``."""
    match dialect:
        case "grbl":
            return ["[VER:1.1h.20190830:stand 7]", "[OPT:V,15,128]"]
        case "grbl 0.9":
            return ["[0.9j.20160316:]"]
        case "grblhal":
            homing = int(settings[22])
            options = "VNM" + "Z" * bool(homing & 8) + "H" * bool(homing & 2)
            options += "L" * (not homing & 4)
            return [
                "[VER:1.1f.20260817:]",
                f"[OPT:{options}+,100,1024,{len(axes)},0]",
                f"[AXS:{len(axes)}:{axes}]",
                "[NEWOPT:ENUMS,RT+,HOME,TC,SED]",
                "[FIRMWARE:grblHAL]",
                "[SIGNALS:HSE]",
                "[NVS STORAGE:*FLASH 4K]",
                "[FREE MEMORY:131K]",
                "[DRIVER:simulated@150MHz]",
                "[DRIVER VERSION:260324]",
                "[BOARD:simulated]",
                "[AUX IO:2,3,0,0]",
                "[WIFI MAC:02:00:00:00:00:01]",
                "[PLUGIN:Networking v0.2]",
            ]


def read_jog(text: str) -> _JogWords | int:
    """Parse what follows ``$J=``, in capitals without spaces; an error code if not a jog."""
    values: dict[str, float] = {}
    modes: set[str] = set()
    for word in _words(text):
        letter, digits = word[0], word[1:]
        if not letter.isalpha():
            return EXPECTED_COMMAND_LETTER
        try:
            value = float(digits)
        except ValueError:
            return BAD_NUMBER
        if letter == "G":
            modes.add(digits)
        elif letter in values:
            return WORD_REPEATED
        else:
            values[letter] = value
    if modes - {"20", "21", "90", "91", "53"} or set(values) - set("XYZF"):
        return NOT_A_JOG
    if "F" not in values:
        return NO_FEED
    if "Z" not in values:
        return NO_AXIS
    unit = MM_PER_INCH if "20" in modes else 1.0
    return _JogWords(
        z_mm=values["Z"] * unit,
        feed_mm_per_min=values["F"] * unit,
        is_incremental="91" in modes,
        is_machine="53" in modes,
    )


def _words(text: str) -> list[str]:
    """Split ``G90Z1.5F100`` into ``G90``, ``Z1.5``, ``F100``."""
    words: list[str] = []
    for char in text:
        if char.isalpha() or not words:
            words.append(char)
        else:
            words[-1] += char
    return words


SWITCH_NOT_RELEASED = 8
SWITCH_NOT_FOUND = 9
SEARCH_SCALAR = 1.5
LOCATE_SCALAR = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HomingSettings:
    """The firmware's settings for homing."""

    is_downwards: bool  # the switch is at the lower end
    seek_mm_per_s: float  # of the first search
    locate_mm_per_s: float  # of the second
    pull_off_mm: float  # back from the switch
    travel_mm: float  # of the axis; the search goes half as far again

    @classmethod
    def of(cls, settings: Mapping[int, float]) -> Self:
        """Read them from ``$23`` to ``$27`` and ``$132``."""
        return cls(
            is_downwards=bool(int(settings[23]) & 4),
            seek_mm_per_s=settings[25] / 60,
            locate_mm_per_s=settings[24] / 60,
            pull_off_mm=settings[27],
            travel_mm=settings[132],
        )


class HomingCycle:
    """One homing cycle; `step` is called after every increment of motion."""

    def __init__(self, axis: StepperAxis, plant: StagePlant, settings: HomingSettings) -> None:
        self._axis = axis
        self._plant = plant
        self._settings = settings
        self._towards = -1.0 if settings.is_downwards else 1.0
        self._phases = ["seek", "pull off", "locate", "pull off"]
        self._begin()

    def step(self) -> int | None:
        """Return the alarm code, 0 when homed, None while still homing."""
        is_pull_off = self._phases[0] == "pull off"
        if not is_pull_off and self._is_pressed:
            self._axis.halt()
        elif self._axis.is_moving:
            return None
        elif not is_pull_off:
            return SWITCH_NOT_FOUND
        if is_pull_off and self._is_pressed:
            return SWITCH_NOT_RELEASED
        self._phases.pop(0)
        if not self._phases:
            return 0
        self._begin()
        return None

    @property
    def _is_pressed(self) -> bool:
        return self._plant.is_low_pressed if self._towards < 0 else self._plant.is_high_pressed

    def _begin(self) -> None:
        settings = self._settings
        way_mm, speed = {
            "seek": (SEARCH_SCALAR * settings.travel_mm, settings.seek_mm_per_s),
            "locate": (LOCATE_SCALAR * settings.pull_off_mm, settings.locate_mm_per_s),
            "pull off": (-settings.pull_off_mm, settings.seek_mm_per_s),
        }[self._phases[0]]
        self._axis.count_from(0.0)
        self._axis.go(self._towards * way_mm, speed)
