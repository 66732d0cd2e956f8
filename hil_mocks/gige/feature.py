"""One feature of the simulated GigE camera: its register, its limits, its description."""

from dataclasses import dataclass
from math import log10
from typing import Literal

FeatureKind = Literal["integer", "float", "enumeration", "boolean", "command", "masked", "flag"]
Maker = Literal["allied_vision", "basler", "flir", "teledyne_dalsa", "hikrobot", "ids"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """From the number in a register to the quantity that the camera works with.

    ``factor * number + offset``; for a ratio, its decibels.
    """

    factor: float = 1.0
    offset: float = 0.0
    is_ratio: bool = False

    def quantity(self, number: float) -> float:
        """The quantity that a number stands for."""
        return 20 * log10(number) if self.is_ratio else self.factor * number + self.offset

    def number(self, quantity: float) -> float:
        """The number that stands for a quantity."""
        if self.is_ratio:
            return float(10 ** (quantity / 20))
        return (quantity - self.offset) / self.factor


UNCHANGED = Conversion()


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
    means
        Quantity of the camera that it stands for, for each entry of ``selector``; only one,
        under an empty name, without a selector of several entries.
    conversion
        From its register to that quantity.
    power_up
        Its value at power-up; None for that of the quantity.
    selector
        Name of the feature that selects what it is about; empty if none does.
    chunk_id
        Id of the chunk that holds it, for what a frame carries instead of a register.
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
    means: tuple[tuple[str, str], ...] = ()
    conversion: Conversion = UNCHANGED
    power_up: float | None = None
    selector: str = ""
    chunk_id: int | None = None

    @property
    def length(self) -> int:
        """Length of its register in bytes."""
        return 8 if self.kind == "float" or self.chunk_id is not None else 4
