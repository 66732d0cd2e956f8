"""Numbers with units, of astropy and pint, converted to the one that an argument's name ends in."""

from collections.abc import Mapping
from typing import Any

from simulation.arguments.errors import ArgumentError

COUNTS = frozenset(("", "dimensionless", "adu", "ct", "count", "counts", "dn"))
"""Units of levels, in lower case: the numbers of a camera are counts of its converter."""

_PLAIN = ("",)

_UNITS: Mapping[str, tuple[str, ...]] = {
    "px_per_mm": ("pix/mm", "pixel/mm", "1/mm"),
    "e_per_dn": ("electron/adu", "electron/count", "electron"),
    "px2": ("pix2", "pixel**2"),
    "px": ("pix", "pixel"),
    "um": ("um",),
    "mm": ("mm",),
    "us": ("us",),
    "s": ("s",),
    "deg": ("deg", "degree"),
    "dn": ("adu", "count", "ct"),
    "e": ("electron",),
}
"""By the end of a name, the longest first; in the spellings of both libraries."""


def unit_of_quantity(value: object) -> str | None:
    """The unit of a quantity, or of astropy's images, as text; None of anything else."""
    for name, number in (("unit", "value"), ("units", "magnitude"), ("unit", "uncertainty")):
        unit = getattr(value, name, None)
        if unit is not None and not callable(value) and hasattr(value, number):
            return str(unit)
    return None


def number_of_quantity(name: str, value: Any, unit: str) -> Any:  # noqa: ANN401 - of any library
    """Return the number of a quantity in the unit of an argument.

    Raises
    ------
    ArgumentError
        If it is of another kind.
    """
    wanted = next((units for end, units in _UNITS.items() if name.endswith(f"_{end}")), _PLAIN)
    for one in (*wanted, *(_PLAIN if "px" in wanted[0] else ())):
        try:
            found = value.to(one)
        except Exception:  # noqa: BLE001, S112 - each library has errors of its own
            continue
        return getattr(found, "magnitude", getattr(found, "value", found))
    said = f"in {wanted[0]}" if wanted[0] else "without a unit"
    raise ArgumentError(f"expected a number {said}, got one in {unit or 'no unit'}", argument=name)
