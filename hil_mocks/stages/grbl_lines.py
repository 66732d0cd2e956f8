"""Settings of a Grbl emulator, what it lists and says in lines, and the parsing of jogs."""

from dataclasses import dataclass
from typing import Literal

from hil_mocks.stages.grbl_reports import MM_PER_INCH

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
class JogWords:
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


def read_jog(text: str) -> JogWords | int:
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
    return JogWords(
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
