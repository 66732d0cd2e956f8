"""The features of the simulated GigE camera, for its registers and its description.

``features.csv`` beside this module is the table. Names are those of a Manta (vendor names beside
SFNC ones); the addresses are our own. A limit may be the name of the feature that holds it.

References
----------
GenICam Standard Features Naming Convention (SFNC) 2.7, EMVA, 2021.
"""

import csv
from dataclasses import replace
from functools import cache
from importlib.resources import files

from hil_mocks.gige.feature import Feature
from hil_mocks.gige.pixels import PIXEL_LAYOUTS, pixel_formats_of

DEVICE_PAGE = 0xA000
"""Start of the device's own registers (GigE Vision 2.0, section 28)."""


def features_of(bayer_order: str | None, *, has_temperature: bool) -> tuple[Feature, ...]:
    """The features of a camera, in the order of its description."""
    formats = tuple((name, PIXEL_LAYOUTS[name].code) for name in pixel_formats_of(bayer_order))
    return tuple(
        replace(feature, entries=formats) if feature.name == "PixelFormat" else feature
        for feature in _table()
        if has_temperature or feature.name != "DeviceTemperature"
    )


@cache
def _table() -> tuple[Feature, ...]:
    text = files("hil_mocks.gige").joinpath("features.csv").read_text("utf-8")
    return tuple(_feature(row) for row in csv.DictReader(text.splitlines()))


def _feature(row: dict[str, str]) -> Feature:
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
        address=int(row["address"], 16),
        description=row["description"],
        access=row["access"],  # type: ignore[arg-type]  # the table's own word
        minimum=limits[0],
        maximum=limits[1],
        increment=number(row["increment"]) if row["increment"] else None,
        unit=row["unit"],
        entries=tuple((name, int(value)) for name, value in entries),
        bits=(int(lsb), int(msb)) if msb else None,
        is_locked_while_acquiring=row["lock"] == "locked",
    )
