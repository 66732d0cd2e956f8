"""What is wanted of a study, as it is written: ``sigma=0.5%``."""

import re
from collections.abc import Iterable
from math import isfinite

from analysis.study import UNITS, Want, WantName
from standoff.errors import ArgumentError

_WRITTEN = re.compile(r"\s*([a-z]+)\s*=\s*([0-9.eE+-]+)\s*(%|[a-z]*)\s*")


def parsed_wants(texts: Iterable[str]) -> tuple[Want, ...]:
    """Return the wants; each is half the width of a 95 % interval.

    Raises
    ------
    ArgumentError
        If one is not understood.
    """
    listed = [texts] if isinstance(texts, str) else list(texts)
    return tuple(_parsed(text) for text in listed)


def _parsed(text: str) -> Want:
    found = _WRITTEN.fullmatch(text)
    names: dict[str, WantName] = {name: name for name in UNITS}
    if found is None or found[1] not in names:
        forms = ", ".join(f"{name}=N{unit}" for name, unit in UNITS.items())
        raise ArgumentError(f"expected one of {forms}, got {text!r}", argument="want")
    name = names[found[1]]
    unit = UNITS[name]
    if found[3] != unit:
        raise ArgumentError(f"{text!r}: {name} is wanted in {unit}", argument="want")
    try:
        number = float(found[2])
    except ValueError as error:
        raise ArgumentError(f"{text!r}: {found[2]} is not a number", argument="want") from error
    if not (isfinite(number) and number > 0):
        raise ArgumentError(f"{text!r}: expected a number above 0", argument="want")
    return Want(name=name, half_width=number / 100 if unit == "%" else number)
