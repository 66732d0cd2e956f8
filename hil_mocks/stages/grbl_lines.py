"""Settings of a Grbl emulator, their listing, and the parsing of jogs."""

from dataclasses import dataclass
from typing import Literal

GrblDialect = Literal["grbl", "grblhal"]

MM_PER_INCH = 25.4

DEFAULT_SETTINGS: dict[int, float] = {
    0: 10, 1: 255, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.01, 12: 0.002, 13: 0,
    20: 1, 21: 0, 22: 1, 23: 4, 24: 60, 25: 1200, 26: 250, 27: 1, 30: 1000, 31: 0, 32: 0,
    100: 250, 101: 250, 102: 250, 110: 3000, 111: 3000, 112: 3000,
    120: 200, 121: 200, 122: 200, 130: 400, 131: 400, 132: 400,
}  # fmt: skip
"""As entered for the simulated stage: homing downwards, travel 400 mm, 4 um per step."""

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
    """Return the lines of ``$$``."""
    lines = []
    for number, value in settings.items():
        is_float = number in (11, 12, 24, 25, 27) or number >= 100
        lines.append(f"${number}={value:.3f}" if is_float else f"${number}={value:g}")
    if dialect == "grblhal":
        lines += ["$341=0", "$384=bench stand"]
    return lines


def version_lines(dialect: GrblDialect) -> list[str]:
    """Return the lines of ``$I``."""
    if dialect == "grbl":
        return ["[VER:1.1h.20190830:stand 7]", "[OPT:V,15,128]"]
    return [
        "[VER:1.1f.20250101:]",
        "[OPT:VNMZ,35,1024,3,0]",
        "[AXS:3:XYZ]",
        "[NEWOPT:ENUMS,RT+,HOME,SED]",
        "[FIRMWARE:grblHAL]",
        "[BOARD:simulated]",
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
