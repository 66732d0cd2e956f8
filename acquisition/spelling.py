"""What was probably meant by text that is not understood: decimal commas, units, names of keys."""

import re
from collections.abc import Iterable
from difflib import get_close_matches

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
