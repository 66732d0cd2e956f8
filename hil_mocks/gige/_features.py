"""The features of the simulated GigE camera, for its registers and its description.

``features.csv`` beside this module has what all cameras share, and ``makers`` a file for each
maker with the rest: the public names, types and units of that maker's cameras, in words and at
addresses of our own (``docs/camera-features.md`` names the sources). A limit may be the name of
the feature that holds it. ``means`` is the quantity that a feature stands for, by the name that a
Manta has for it, where that is not its own name; with ``ENTRY=QUANTITY`` for each entry of its
selector.

References
----------
GenICam Standard Features Naming Convention (SFNC) 2.7, EMVA, 2021.
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from math import log10
from typing import Literal, get_args

from hil_mocks.gige._wire import PIXEL_LAYOUTS, pixel_formats_of

FeatureKind = Literal["integer", "float", "enumeration", "boolean", "command", "masked", "flag"]
Maker = Literal["allied_vision", "basler", "flir", "teledyne_dalsa", "hikrobot", "ids"]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Conversion:
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


UNCHANGED = _Conversion()


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """One feature that has a register; names, kinds and units as in the description.

    ``means`` is the quantity of the camera that it stands for, for each entry of ``selector``; only
    one, under an empty name, without a selector of several entries.
    """

    name: str
    category: str
    kind: FeatureKind
    address: int  # floats take eight bytes, everything else four, big endian
    description: str
    access: Literal["RW", "RO", "WO"] = "RW"  # ``RW``, ``RO`` or ``WO``
    minimum: float | str | None = None  # or the name of the feature that holds it
    maximum: float | str | None = None  # likewise
    increment: float | None = None  # of an integer, or the step that a float is rounded to
    unit: str = ""
    entries: tuple[tuple[str, int], ...] = ()  # of an enumeration
    bits: tuple[int, int] | None = None  # ``(lsb, msb)`` of a part of a register, 0 the highest
    is_locked_while_acquiring: bool = False  # can be written only at rest
    means: tuple[tuple[str, str], ...] = ()
    conversion: _Conversion = UNCHANGED
    power_up: float | None = None  # None: that of the quantity
    selector: str = ""  # feature that selects what it is about
    chunk_id: int | None = None  # of the chunk that holds it, for what a frame carries

    @property
    def length(self) -> int:
        """Length of its register in bytes."""
        return 8 if self.kind == "float" or self.chunk_id is not None else 4


MAKERS: tuple[Maker, ...] = get_args(Maker)

DEVICE_PAGE = 0xA000
"""Start of the device's own registers (GigE Vision 2.0, section 28)."""

MAKERS_PAGE = 0xA400
"""Features without an address of their own lie from here on."""


def features_of(
    bayer_order: str | None, *, has_temperature: bool, maker: Maker = "allied_vision"
) -> tuple[Feature, ...]:
    """The features of a camera, in the order of its description."""
    formats = tuple((name, PIXEL_LAYOUTS[name].code) for name in pixel_formats_of(bayer_order))
    return tuple(
        replace(feature, entries=formats) if feature.name == "PixelFormat" else feature
        for feature in _table(maker)
        if has_temperature or feature.name != "DeviceTemperature"
    )


@cache
def _table(maker: Maker) -> tuple[Feature, ...]:
    rows = [*_rows(f"makers/{maker}.csv"), *_rows("features.csv")]
    return tuple(_feature(row, MAKERS_PAGE + 8 * place) for place, row in enumerate(rows))


def _rows(name: str) -> Iterator[dict[str, str]]:
    text = files("hil_mocks.gige").joinpath(name).read_text("utf-8")
    return iter(csv.DictReader(text.splitlines()))


def _feature(row: dict[str, str], free_address: int) -> Feature:
    number = float if row["kind"] == "float" else int
    limits = [
        text if text[:1].isalpha() else number(text) if text else None
        for text in (row["minimum"], row["maximum"])
    ]
    entries = (entry.split("=") for entry in row["entries"].split())
    lsb, _, msb = row["bits"].partition("-")
    return Feature(
        name=row["name"],
        category=row["category"],
        kind=row["kind"],  # type: ignore[arg-type]  # the table's own word
        address=int(row["address"], 16) if row["address"] else free_address,
        description=row["description"],
        access=row["access"],  # type: ignore[arg-type]  # the table's own word
        minimum=limits[0],
        maximum=limits[1],
        increment=number(row["increment"]) if row["increment"] else None,
        unit=row["unit"],
        entries=tuple((name, int(value)) for name, value in entries),
        bits=(int(lsb), int(msb)) if msb else None,
        is_locked_while_acquiring=row["lock"] == "locked",
        means=_meanings(row),
        conversion=_conversion(row.get("conversion", "")),
        power_up=float(row["power_up"]) if row.get("power_up") else None,
        selector=row.get("selector", ""),
        chunk_id=int(row["chunk"], 16) if row.get("chunk") else None,
    )


def _meanings(row: dict[str, str]) -> tuple[tuple[str, str], ...]:
    text = row.get("means") or row["name"]
    if "=" not in text:
        return (("", text),)
    return tuple(
        (entry, quantity) for entry, _, quantity in (t.partition("=") for t in text.split())
    )


def _conversion(text: str) -> _Conversion:
    if text == "ratio":
        return _Conversion(is_ratio=True)
    if not text:
        return UNCHANGED
    factor, offset = text.split()
    return _Conversion(factor=float(factor), offset=float(offset))
