"""Numbers as people write them: units, plausible ranges, and the slip that explains one outside.

A number is in the unit that its key ends in: ``exposure_us = 9`` is 9 microseconds, and is asked
about. Text that states the unit, ``"9 us"`` or ``"9 ms"``, is taken as meant, whatever its size. Of
text that is not understood, it is said what was probably meant: decimal commas, units, names of
keys.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from typing import Literal

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
    """A text states a unit that cannot be converted to that of its key."""

    def __init__(self, text: str, *, unit: str, known: tuple[str, ...]) -> None:
        super().__init__(f'= "{text}": {unit!r} is not one of its units: {", ".join(known)}')
        self.unit = unit
        self.known = known


@dataclass(frozen=True, slots=True, kw_only=True)
class _StatedNumber:
    """A number that was given as text; ``unit`` is the one it states, None if it states none."""

    value: float
    unit: str | None


def _unit_of(name: str) -> str | None:
    """The unit that a key ends in, such as ``us`` for ``exposure_us``; None if it has none."""
    for suffix, unit in _UNIT_OF_SUFFIX.items():
        stem = name.removesuffix(f"_{suffix}")
        if stem != name:
            return None if stem.endswith("_per") else unit
    return None


def _stated_number(text: str) -> _StatedNumber | None:
    """The number in a text, with its unit; None if the text is not a number."""
    found = _STATED.fullmatch(text)
    if found is None:
        return None
    return _StatedNumber(value=float(found[1]), unit=found[2].strip() if found[2] else None)


def _converted(value: float, given: str, wanted: str) -> float:
    """A value in unit ``given``, in unit ``wanted`` of the same kind, to 12 digits."""
    scale = _scale_of(wanted)
    return float(f"{value * scale[given] / scale[wanted]:.12g}")


def _known_unit(spelt: str, wanted: str) -> str | None:
    """The unit that a text names; None if it cannot be converted to ``wanted``."""
    scale = _scale_of(wanted)
    name = _OTHER_SPELLINGS.get(spelt, spelt)
    if name in scale:
        return name
    return next((one for one in scale if one.casefold() == name.casefold()), None)


def _in_unit(text: str, wanted: str) -> int | float | None:
    """The number in a text, converted to ``wanted`` if it states a unit; None if it is none."""
    stated = _stated_number(text)
    if stated is None:
        return None
    value = stated.value
    if stated.unit is not None:
        given = _known_unit(stated.unit, wanted)
        if given is None:
            raise UnknownUnitError(text, unit=stated.unit, known=tuple(_scale_of(wanted)))
        value = _converted(value, given, wanted)
    return int(value) if value.is_integer() and abs(value) < 2**53 else value


def _scale_of(unit: str) -> Mapping[str, int]:
    return next(scale for scale in _SCALES if unit in scale)


class ImplausibleQuantityError(ValueError):
    """A number is outside the range of its key, and its unit is not stated.

    ``given`` and ``meant``, None if no slip explains it, are in the unit of the key; the message
    follows the key's name in a sentence.
    """

    def __init__(self, message: str, *, given: object, meant: object) -> None:
        super().__init__(message)
        self.given = given
        self.meant = meant


@dataclass(frozen=True, slots=True)
class _PlausibleRange:
    """From ``low`` to ``high`` in the unit of the key; ``typical`` tells possible slips apart.

    ``of`` says what must be in the range: each number, the largest magnitude, or the difference of
    the ends. Where ``low`` is not negative, the key's own bounds see to negative numbers.
    """

    low: float
    high: float
    typical: float
    of: Literal["each", "largest", "span"] = "each"
    remark: str = ""

    def holds(self, value: float) -> bool:
        """Whether a value gives no reason to ask."""
        return self.low <= value <= self.high or value < 0 <= self.low


PLAUSIBLE: Mapping[str, _PlausibleRange] = {
    # The Manta G-046 has 21 us to 60 s. Some sensors expose for 1 us, which is rarely meant.
    "exposure_us": _PlausibleRange(20, 6e7, 1e4),
    "gain_db": _PlausibleRange(0, 60, 10, remark="raw gains and percentages are not in dB"),
    "frame_rate_hz": _PlausibleRange(0.1, 2000, 60),
    "bandwidth_limit_bytes_per_s": _PlausibleRange(1e5, 2e10, 1.15e8),
    "reconnect_timeout_s": _PlausibleRange(0, 1800, 30),
    "limits_mm": _PlausibleRange(2, 1e4, 400, of="span"),
    "feed_mm_per_min": _PlausibleRange(10, 6e4, 600),
    "settle_s": _PlausibleRange(0, 60, 0.5),
    "tolerance_mm": _PlausibleRange(5e-4, 5, 0.05),
    "backlash_mm": _PlausibleRange(0, 20, 0.5),
    "home_offset_mm": _PlausibleRange(-1e4, 1e4, 300),
    "microstep_um": _PlausibleRange(5e-3, 50, 0.5),
    # Fisheyes have 1.2 mm, telescopes 3 m; the Kowa LMVZ4411 has 4.4 to 11 mm.
    "focal_length_mm": _PlausibleRange(1, 3000, 12),
    # Telephones have 0.5 um, cooled infrared sensors 50 um.
    "pixel_pitch_um": _PlausibleRange(0.4, 100, 5),
    "focus_distance_mm": _PlausibleRange(5, 1e5, 300),
    "heights_mm": _PlausibleRange(1, 1e4, 300, of="largest"),
    "focal_length_px": _PlausibleRange(
        20, 1e7, 1000, remark="it is the focal length in mm, divided by the pixel pitch in mm"
    ),
}
"""Ranges outside which a number is asked about, by the name of the key or option."""

MISTAKEN_FOR: Mapping[str, Mapping[str, str]] = {
    "us": {"ms": "milliseconds", "s": "seconds", "ns": "nanoseconds"},
    "s": {"ms": "milliseconds", "us": "microseconds"},
    "mm": {"m": "metres", "um": "micrometres", "cm": "centimetres", "nm": "nanometres"},
    "um": {"mm": "millimetres", "m": "metres", "nm": "nanometres"},
    "Hz": {"kHz": "kilohertz"},
    "bytes/s": {
        "MB/s": "megabytes per second",
        "Mbit/s": "megabits per second",
        "kB/s": "kilobytes per second",
        "Gbit/s": "gigabits per second",
    },
    "mm/min": {"mm/s": "millimetres per second", "m/min": "metres per minute"},
}
"""The units that people think in instead, for each unit of a key."""

_NAMES = {
    "us": "microseconds",
    "s": "seconds",
    "mm": "millimetres",
    "um": "micrometres",
    "Hz": "hertz",
    "dB": "decibels",
    "px": "pixels",
    "bytes/s": "bytes per second",
    "mm/min": "millimetres per minute",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Slip:
    """What a number was probably given in, as the start of a sentence, and what that makes it."""

    what: str
    meant: float


def understood(name: str, value: object) -> object:
    """Return the value of a key, with the units that it states converted to that of the key.

    The value is a number or text, or a list or table of them. What is not a number, or has a key
    without a unit, stays as it is. A number without a unit that is implausible is refused.
    """
    unit = _unit_of(name)
    if unit is None:
        return value
    read = _mapped(value, lambda one: _read(one, unit))
    plausible = PLAUSIBLE.get(name)
    if plausible is None:
        return read
    states_no_unit = [not _states_unit(one) for one in _leaves(value)]
    if plausible.of == "each":
        is_listed = isinstance(value, list | tuple | Mapping)
        for one, is_asked in zip(_leaves(read), states_no_unit, strict=True):
            number = _finite(one)
            if is_asked and number is not None and not plausible.holds(number):
                raise _question_on_one(number, unit, plausible, is_listed=is_listed)
    elif all(states_no_unit):
        _check_together(read, unit, plausible)
    return read


def _likely_slip(value: float, unit: str, plausible: _PlausibleRange) -> _Slip | None:
    """The slip nearest to the typical value that explains a number; None if none does."""
    inside = [slip for slip in _slips(value, unit) if plausible.low <= slip.meant <= plausible.high]
    if value == 0 or not inside:
        return None
    return min(inside, key=lambda slip: abs(math.log(abs(slip.meant) / plausible.typical)))


def slip_between(value: float, unit: str, low: float, high: float) -> str:
    """End of a sentence on the slip of 1000 or more that brings a value in range, or ""."""
    if not (math.isfinite(value) and low < high):
        return ""
    slip = _likely_slip(value, unit, _PlausibleRange(low, high, max(abs(low), abs(high)) / 2))
    if slip is None or 1 / 1000 < slip.meant / value < 1000:
        return ""
    return f"; {slip.what} probably meant: {number_text(slip.meant)} {unit}"


def number_text(value: float) -> str:
    """A number to six digits, as it is written in a file."""
    rounded = float(f"{value:.6g}")
    return str(int(rounded)) if rounded.is_integer() and abs(rounded) < 1e15 else f"{rounded:g}"


def _question_on_one(
    number: float, unit: str, plausible: _PlausibleRange, *, is_listed: bool
) -> ImplausibleQuantityError:
    shown = number_text(number)
    said = f"has {shown}, which is" if is_listed else f"= {shown} is"
    slip = _likely_slip(number, unit, plausible)
    return ImplausibleQuantityError(
        _question(
            f"{said} {shown} {_NAMES[unit]}",
            plausible,
            slip,
            meant=None if slip is None else number_text(slip.meant),
            confirmed=f'"{shown} {unit}"',
        ),
        given=number,
        meant=None if slip is None else slip.meant,
    )


def _check_together(value: object, unit: str, plausible: _PlausibleRange) -> None:
    """Refuse a list or table if its largest magnitude or its span is out of range."""
    numbers = [number for one in _leaves(value) if (number := _finite(one)) is not None]
    if not numbers:
        return
    is_span = plausible.of == "span"
    measure = max(numbers) - min(numbers) if is_span else max(map(abs, numbers))
    if measure == 0 or plausible.holds(measure):
        return
    slip = _likely_slip(measure, unit, plausible)
    meant = None
    if slip is not None:
        ratio = slip.meant / measure
        meant = _mapped(value, lambda one: _scaled(one, ratio))
    stated = _mapped(value, lambda one: one if (n := _finite(one)) is None else f"{n:g} {unit}")
    raise ImplausibleQuantityError(
        _question(
            f"= {_toml(value)} is in {_NAMES[unit]}",
            plausible,
            slip,
            meant=None if meant is None else _toml(meant),
            confirmed=_toml(stated),
        ),
        given=value,
        meant=meant,
    )


def _question(
    said: str, plausible: _PlausibleRange, slip: _Slip | None, *, meant: str | None, confirmed: str
) -> str:
    if slip is not None:
        return f"{said}; {slip.what} probably meant: write {meant}, or {confirmed} if it is right"
    low, high = number_text(plausible.low), number_text(plausible.high)
    what = {"each": "not", "largest": "the largest is not", "span": "the span is not"}[plausible.of]
    remark = f"; {plausible.remark}" if plausible.remark else ""
    return f"{said}, {what} between {low} and {high}{remark}; write {confirmed} if it is right"


def _slips(value: float, unit: str) -> Iterator[_Slip]:
    for other, name in MISTAKEN_FOR.get(unit, {}).items():
        yield _Slip(what=f"{name} were", meant=_converted(value, other, unit))
    if unit == "Hz" and value > 0:
        for other, name in (("s", "seconds"), *MISTAKEN_FOR["s"].items()):
            period_s = _converted(value, other, "s")
            if period_s > 0:
                yield _Slip(what=f"the period in {name} was", meant=1 / period_s)


def _read(value: object, unit: str) -> object:
    number = _in_unit(value, unit) if isinstance(value, str) else None
    return value if number is None else number


def _states_unit(value: object) -> bool:
    stated = _stated_number(value) if isinstance(value, str) else None
    return stated is not None and stated.unit is not None


def _mapped(value: object, change: Callable[[object], object]) -> object:
    if isinstance(value, Mapping):
        return {key: _mapped(one, change) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_mapped(one, change) for one in value]
    return change(value)


def _leaves(value: object) -> Iterator[object]:
    if isinstance(value, Mapping | list | tuple):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from _leaves(one)
    else:
        yield value


def _finite(value: object) -> float | None:
    """A value as a finite number; None if it is none, or an integer too large for one."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if -1e300 < value < 1e300 else None


def _scaled(value: object, ratio: float) -> object:
    number = _finite(value)
    return value if number is None else float(f"{number * ratio:.12g}")


def _toml(value: object) -> str:
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {_toml(one)}' for key, one in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    number = _finite(value)
    return f'"{value}"' if number is None else number_text(number)


_COMMA = re.compile(r"\s*([+-]?)(\d+),(\d+)(\s*[^\s\d,.;][^,;]*)?")
_ASSIGNED_NUMBER = re.compile(r"\s*([\w.-]+)\s*=\s*([+-]?\d[^#\"'\[\]{}]*)(?:#.*)?")
_LEAST_LIKENESS = 0.6


def decimal_comma_remedy(text: str, name: str = "") -> str | None:
    """Say how to write a number that has a decimal comma; None if the text is not one.

    Where the comma may separate thousands, the plausible range of the key ``name`` decides if it
    can.
    """
    found = _COMMA.fullmatch(text.rstrip())
    if found is None:
        return None
    sign, whole, fraction, unit = found[1], found[2], found[3], found[4] or ""
    ways = [f"{sign}{whole}.{fraction}"]
    if len(fraction) == 3 and not whole.startswith("0"):
        ways.append(f"{sign}{whole}{fraction}")
        plausible = PLAUSIBLE.get(name)
        if plausible is not None:
            ways = [way for way in ways if plausible.holds(float(way))] or ways
    forms = " or ".join(f'"{way}{unit}"' if unit else way for way in ways)
    return f"write {forms} with a decimal point" if "." in forms else f"write {forms}"


def decimals_meant(
    text: str, accepts: Callable[[float], bool], pair_most: float | None = None
) -> str | None:
    """Return a list of numbers with points for its decimal commas; None if nothing says it has any.

    Signs of a decimal comma are another separator beside it, a leading zero (``1,05``), a number
    that ``accepts`` does not, a second of two from ``pair_most`` on, and pairs that ascend where
    the numbers do not (``1,5,2,5``).
    """
    parts = re.split(r"[;\s]+", text.strip())
    if "," in text and len(parts) > 1 and all(re.fullmatch(r"\d+(,\d+)?", one) for one in parts):
        return ",".join(part.replace(",", ".") for part in parts)
    words = text.split(",")
    if len(words) % 2 or not all(re.fullmatch(r"\d{1,9}", word) for word in words):
        return None
    joined = [
        f"{whole}.{fraction}" for whole, fraction in zip(words[::2], words[1::2], strict=True)
    ]
    decimals = [float(one) for one in joined]
    is_meant = (
        any(len(word) > 1 and word.startswith("0") for word in words)
        or not all(accepts(float(word)) for word in words)
        or _is_odd([float(word) for word in words], decimals, pair_most)
    )
    return ",".join(joined) if is_meant and all(map(accepts, decimals)) else None


def _is_odd(numbers: list[float], decimals: list[float], pair_most: float | None) -> bool:
    """Whether whole numbers make less sense than the decimals that their pairs would be."""
    if len(numbers) == 2:
        return pair_most is not None and numbers[1] >= pair_most
    return _ascends(decimals) and not _ascends(numbers)


def _ascends(values: list[float]) -> bool:
    return all(low < high for low, high in pairwise(values))


def toml_slip(text: str) -> str | None:
    """Name the first line of a TOML text with a decimal comma or an unquoted unit, if any."""
    for count, line in enumerate(text.splitlines(), 1):
        found = _ASSIGNED_NUMBER.fullmatch(line)
        if found is None:
            continue
        key, value = found[1], found[2].strip()
        name = key.rpartition(".")[2]
        remedy = decimal_comma_remedy(value, name)
        unit, stated = _unit_of(name), _stated_number(value)
        if unit is not None and stated is not None and stated.unit is not None:
            remedy = f'write "{value}" in quotes' if _known_unit(stated.unit, unit) else None
        if remedy is not None:
            return f"line {count}: {key} = {value}: {remedy}"
    return None


def nearest_key(key: str, known: Iterable[str]) -> str | None:
    """The known dotted key that an unknown one was probably meant to be, if any resembles it."""
    section, _, name = key.rpartition(".")
    keys = list(known)
    here = [other for other in keys if other.rpartition(".")[0] == section]
    same = [other for other in keys if other.rpartition(".")[2] == name]
    for group in (here, same, keys):
        names = {other.rpartition(".")[2]: other for other in reversed(group)}
        close = get_close_matches(name, names, n=1, cutoff=_LEAST_LIKENESS)
        if close:
            return names[close[0]]
    return None
