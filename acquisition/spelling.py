"""What was probably meant by text that is not understood: decimal commas, units, names of keys."""

import re
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from itertools import pairwise

from acquisition.quantities import PLAUSIBLE
from acquisition.units import known_unit, stated_number, unit_of

_COMMA = re.compile(r"\s*([+-]?)(\d+),(\d+)(\s*[^\s\d,.;][^,;]*)?")
_ASSIGNED_NUMBER = re.compile(r"\s*([\w.-]+)\s*=\s*([+-]?\d[^#\"'\[\]{}]*)(?:#.*)?")
_LEAST_LIKENESS = 0.6


def decimal_comma_remedy(text: str, name: str = "") -> str | None:
    """Say how to write a number that has a decimal comma; None if the text is not one.

    A comma before three digits may instead separate thousands: the plausible range of the key
    ``name`` decides if it can, otherwise both ways are named.
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

    A list with a point in it is taken as it is. Signs of a decimal comma are another separator
    beside it, a leading zero (``1,05``), a number out of bounds, a second of two numbers that is
    too large, and pairs that ascend where the numbers do not (``1,5,2,5``).

    Parameters
    ----------
    text
        Numbers with commas between them.
    accepts
        Whether a number is within its bounds.
    pair_most
        Of two whole numbers, the second is probably a decimal if it is this or more.
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
        unit, stated = unit_of(name), stated_number(value)
        if unit is not None and stated is not None and stated.unit is not None:
            remedy = f'write "{value}" in quotes' if known_unit(stated.unit, unit) else None
        if remedy is not None:
            return f"line {count}: {key} = {value}: {remedy}"
    return None


def nearest_key(key: str, known: Iterable[str]) -> str | None:
    """The known dotted key that an unknown one was probably meant to be, if any resembles it.

    A similar name in the same section comes first, then the same and a similar one in another.
    """
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
