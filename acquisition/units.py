"""The units that keys end in, and numbers that state one, such as ``"9 ms"``."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

_SCALES: tuple[Mapping[str, int], ...] = (
    {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9, "min": 60 * 10**9, "h": 3600 * 10**9},
    {"nm": 1, "um": 10**3, "mm": 10**6, "cm": 10**7, "m": 10**9},
    {"Hz": 1, "kHz": 10**3},
    {"dB": 1},
    {"px": 1},
    {"deg": 1},
    {"bytes": 1, "kB": 10**3, "MB": 10**6},
    {
        "bytes/s": 1,
        "kB/s": 10**3,
        "MB/s": 10**6,
        "GB/s": 10**9,
        "Mbit/s": 125 * 10**3,
        "Gbit/s": 125 * 10**6,
    },
    {"mm/min": 1, "mm/s": 60, "m/min": 10**3},
)
"""Units that are converted into each other, in multiples of the first."""

_UNIT_OF_SUFFIX = {
    "bytes_per_s": "bytes/s",
    "mm_per_min": "mm/min",
    "bytes": "bytes",
    "deg": "deg",
    "db": "dB",
    "hz": "Hz",
    "mm": "mm",
    "px": "px",
    "um": "um",
    "us": "us",
    "s": "s",
}
"""The longest suffixes come first."""

_OTHER_SPELLINGS = {
    "µs": "us",
    "μs": "us",
    "µm": "um",
    "μm": "um",
    "fps": "Hz",
    "B": "bytes",
    "B/s": "bytes/s",
    "°": "deg",
    "degrees": "deg",
}

_STATED = re.compile(r"\s*([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\s\d,.;].*)?")


class UnknownUnitError(ValueError):
    """A text states a unit that cannot be converted to that of its key.

    The message follows the name of the key in a sentence.
    """

    def __init__(self, text: str, *, unit: str, known: tuple[str, ...]) -> None:
        super().__init__(f'= "{text}": {unit!r} is not one of its units: {", ".join(known)}')
        self.unit = unit
        self.known = known


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedNumber:
    """A number that was given as text; ``unit`` is the one it states, None if it states none."""

    value: float
    unit: str | None


def unit_of(name: str) -> str | None:
    """The unit that a key ends in, such as ``us`` for ``exposure_us``; None if it has none."""
    for suffix, unit in _UNIT_OF_SUFFIX.items():
        stem = name.removesuffix(f"_{suffix}")
        if stem != name:
            return None if stem.endswith("_per") else unit
    return None


def stated_number(text: str) -> StatedNumber | None:
    """The number in a text, with its unit; None if the text is not a number."""
    found = _STATED.fullmatch(text)
    if found is None:
        return None
    return StatedNumber(value=float(found[1]), unit=found[2].strip() if found[2] else None)


def converted(value: float, given: str, wanted: str) -> float:
    """A value in unit ``given``, in unit ``wanted`` of the same kind, to 12 digits."""
    scale = _scale_of(wanted)
    return float(f"{value * scale[given] / scale[wanted]:.12g}")


def known_unit(spelt: str, wanted: str) -> str | None:
    """The unit that a text names; None if it cannot be converted to ``wanted``."""
    scale = _scale_of(wanted)
    name = _OTHER_SPELLINGS.get(spelt, spelt)
    if name in scale:
        return name
    return next((one for one in scale if one.casefold() == name.casefold()), None)


def in_unit(text: str, wanted: str) -> int | float | None:
    """The number in a text, converted to ``wanted`` if it states a unit; None if it is none.

    Raises
    ------
    UnknownUnitError
        If the stated unit cannot be converted.
    """
    stated = stated_number(text)
    if stated is None:
        return None
    value = stated.value
    if stated.unit is not None:
        given = known_unit(stated.unit, wanted)
        if given is None:
            raise UnknownUnitError(text, unit=stated.unit, known=tuple(_scale_of(wanted)))
        value = converted(value, given, wanted)
    return int(value) if value.is_integer() and abs(value) < 2**53 else value


def _scale_of(unit: str) -> Mapping[str, int]:
    return next(scale for scale in _SCALES if unit in scale)
