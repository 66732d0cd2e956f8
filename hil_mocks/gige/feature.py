"""One feature of the simulated GigE camera: its register, its limits, its description."""

from dataclasses import dataclass
from typing import Literal

FeatureKind = Literal["integer", "float", "enumeration", "boolean", "command", "masked", "flag"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """One feature that has a register.

    Parameters
    ----------
    name, category, kind, description
        As in the description.
    address
        Address of its register; floats take eight bytes, everything else four, big endian.
    access
        ``RW``, ``RO`` or ``WO``.
    minimum, maximum
        Limits, or the name of the feature that holds the limit.
    increment
        Increment of an integer, or the step that a float is rounded to.
    unit
        As in the description.
    entries
        Names and values of an enumeration.
    bits
        ``(lsb, msb)`` of a part of a register (kinds masked and flag), bit 0 the highest.
    is_locked_while_acquiring
        Whether it can be written only while no acquisition is running.
    """

    name: str
    category: str
    kind: FeatureKind
    address: int
    description: str
    access: Literal["RW", "RO", "WO"] = "RW"
    minimum: float | str | None = None
    maximum: float | str | None = None
    increment: float | None = None
    unit: str = ""
    entries: tuple[tuple[str, int], ...] = ()
    bits: tuple[int, int] | None = None
    is_locked_while_acquiring: bool = False

    @property
    def length(self) -> int:
        """Length of its register in bytes."""
        return 8 if self.kind == "float" else 4
