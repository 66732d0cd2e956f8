"""GenICam features of an open Aravis camera, by name; every error names its feature.

``feature_names.csv`` beside this module says what makers call their features, in which units, and
what makes levels linear, in the order in which names are tried; ``docs/camera-features.md`` names
its sources. ``neutral`` is the value that leaves levels and pixels as the converter made them, one
for each type; ``if_kept`` says whether a camera that keeps another value is refused, or the value
recorded with a warning.
"""

import csv
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from math import isfinite, log10
from typing import Literal

from acquisition.aravis._device import OpenedDevice, require_bounded, text_of, translated_errors
from acquisition.errors import CameraFeatureError, DeviceError, MissingFeatureError

_IfKept = Literal["refuse", "record", ""]

_KEYS = {
    "exposure": "camera.exposure_us",
    "gain": "camera.gain_db",
    "frame rate": "camera.frame_rate_hz",
    "throughput": "camera.bandwidth_limit_bytes_per_s",
    "throughput switch": "camera.bandwidth_limit_bytes_per_s",
    "chunk exposure": "camera.chunk_data",
    "chunk gain": "camera.chunk_data",
    "chunk counter": "camera.chunk_data",
    "chunk timestamp": "camera.chunk_data",
    "PixelFormat": "camera.pixel_format",
    "Width": "camera.region_px",
    "Height": "camera.region_px",
    "OffsetX": "camera.region_px",
    "OffsetY": "camera.region_px",
    "PayloadSize": "camera.region_px",
    "GevSCPSPacketSize": "camera.packet_size_bytes",
    "TriggerMode": "camera.trigger",
    "TriggerSource": "camera.trigger",
    "TriggerSoftware": "camera.trigger",
    "TriggerActivation": "camera.trigger_edge",
}
"""Keys of the bench file by the purpose of a feature, or by its name where it has but one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureName:
    """One row of the table."""

    purpose: str
    name: str
    makers: tuple[str, ...]
    unit: str
    neutral: tuple[str, ...]
    selector: str
    if_kept: _IfKept

    def is_of(self, camera: str) -> bool:
        """Whether the row is about a camera of this vendor and model."""
        return not self.makers or any(
            re.search(rf"\b{re.escape(maker)}\b", camera, re.IGNORECASE) for maker in self.makers
        )


def names_for(purpose: str, camera: str) -> tuple[FeatureName, ...]:
    """The rows of a purpose that are about a camera (vendor, model), in the order to try them."""
    return tuple(row for row in _table() if row.purpose == purpose and row.is_of(camera))


def bench_key(feature: str) -> str | None:
    """The key of the bench file that a feature is set by; None for one that it does not tell."""
    purposes = (row.purpose for row in _table() if row.name == feature)
    keys = (_KEYS.get(word) for word in (feature, *purposes))
    return next((key for key in keys if key is not None), None)


def neutral_features(camera: str) -> tuple[FeatureName, ...]:
    """All features that have to have a neutral value in a camera, in order."""
    return tuple(row for row in _table() if row.neutral and row.is_of(camera))


@cache
def _table() -> tuple[FeatureName, ...]:
    text = files("acquisition.aravis").joinpath("feature_names.csv").read_text("utf-8")
    return tuple(
        FeatureName(
            purpose=row["purpose"],
            name=row["name"],
            makers=tuple(filter(None, row["makers"].split(";"))),
            unit=row["unit"],
            neutral=tuple(filter(None, row["neutral"].split(";"))),
            selector=row["selector"],
            if_kept=row["if_kept"],  # type: ignore[arg-type]  # the table's own word
        )
        for row in csv.DictReader(text.splitlines())
    )


FeatureValue = str | int | float | bool
_FeatureType = Literal["boolean", "enumeration", "integer", "float", "command", "string"]

_RELATIVE_ROUNDING = 1e-6
"""Relative error of a value read back from a 32-bit float register."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Smallest and largest value that a camera accepts at present."""

    low: float
    high: float


def whole(value: float, feature: str) -> int:
    """Return what a feature states as a whole number."""
    if not isfinite(value):
        raise CameraFeatureError(
            f"the camera states {feature} as {value}, which is not a valid size", feature=feature
        )
    return round(value)


class CameraFeatures:
    """Reads and writes features of one camera, whatever type they have there."""

    def __init__(self, opened: OpenedDevice) -> None:
        self._opened = opened

    def has(self, feature: str) -> bool:
        """Whether the camera has the feature and offers it in its present state."""
        with translated_errors(self._opened.library, feature):
            return bool(self._opened.camera.is_feature_available(feature))

    def is_described(self, feature: str) -> bool:
        """Whether the camera's description has the feature, be it in frames only."""
        return self._opened.device.get_feature(feature) is not None

    def first_of(self, names: Sequence[str]) -> str | None:
        """First of several names for the same feature that the camera knows."""
        return next((name for name in names if self.has(name)), None)

    def type_of(self, feature: str) -> _FeatureType:
        """The type that the camera's description gives the feature."""
        api = self._opened.library.api
        node = self._opened.device.get_feature(feature)
        # An enumeration is an integer as well.
        if isinstance(node, api.GcEnumeration):
            return "enumeration"
        if isinstance(node, api.GcBoolean):
            return "boolean"
        if isinstance(node, api.GcCommand):
            return "command"
        if isinstance(node, api.GcFloat):
            return "float"
        return "integer" if isinstance(node, api.GcInteger) else "string"

    def unit_of(self, feature: str) -> str | None:
        """The unit in the camera's description; None if there is none."""
        if self.type_of(feature) not in ("integer", "float"):
            return None
        return self._opened.device.get_feature(feature).get_unit() or None

    def entries(self, feature: str) -> tuple[str, ...]:
        """The values of an enumeration that can be set at present."""
        with translated_errors(self._opened.library, feature):
            return tuple(self._opened.camera.dup_available_enumerations_as_strings(feature) or ())

    def bounds(self, feature: str) -> Bounds:
        """Smallest and largest value of a number."""
        with translated_errors(self._opened.library, feature):
            if self.type_of(feature) == "integer":
                pair = self._opened.camera.get_integer_bounds(feature)
            else:
                pair = self._opened.camera.get_float_bounds(feature)
        return Bounds(low=float(pair.min), high=float(pair.max))

    def step(self, feature: str) -> float:
        """Increment of a number; 1 where the camera does not state it."""
        try:
            if self.type_of(feature) == "integer":
                step = float(self._opened.camera.get_integer_increment(feature))
            else:
                step = float(self._opened.camera.get_float_increment(feature))
        except self._opened.library.glib.Error:
            return 1.0
        return step if 1e-9 < step < 1e9 else 1.0

    def read(self, feature: str) -> FeatureValue:
        """Present value, in the feature's own type."""
        kind = self.type_of(feature)
        with translated_errors(self._opened.library, feature):
            if kind == "boolean":
                return bool(self._opened.camera.get_boolean(feature))
            if kind == "integer":
                return int(self._opened.camera.get_integer(feature))
            if kind == "float":
                return float(self._opened.camera.get_float(feature))
            require_bounded(self._opened, feature)
            return text_of(self._opened.camera.get_string, feature)

    def number(self, feature: str) -> float:
        """Present value of a number."""
        value = self.read(feature)
        try:
            return float(value)
        except ValueError as error:
            raise CameraFeatureError(
                f"the camera states {feature} as {value!r}, which is not a number", feature=feature
            ) from error

    def write(self, feature: str, value: FeatureValue) -> None:
        """Set a feature to exactly ``value``, unless it has it already: a read-only one may."""
        if self._is(feature, value):
            return
        self.send(feature, value)
        if not self._is(feature, value):
            raise CameraFeatureError(
                f"the camera does not keep {feature}: set to {value}, "
                f"it reads back {self.read(feature)}",
                feature=feature,
            )

    def send(self, feature: str, value: FeatureValue) -> None:
        """Set a feature; it is for the caller to read back what has become of it."""
        with translated_errors(self._opened.library, feature):
            if isinstance(value, bool):
                self._opened.camera.set_boolean(feature, value)
            elif isinstance(value, str):
                self._opened.camera.set_string(feature, value)
            elif self.type_of(feature) == "integer":
                self._opened.camera.set_integer(feature, round(value))
            else:
                self._opened.camera.set_float(feature, float(value))

    def execute(self, command: str) -> None:
        """Execute a command."""
        with translated_errors(self._opened.library, command):
            self._opened.camera.execute_command(command)

    @contextmanager
    def selected(self, selector: str, entry: str) -> Iterator[None]:
        """Point a selector at one of its entries, and back at what it was."""
        before = self.read(selector)
        self.write(selector, entry)
        try:
            yield
        finally:
            try:
                self.write(selector, before)
            except CameraFeatureError as error:
                raise DeviceError(f"{selector} cannot be set back: {error}") from error

    def _is(self, feature: str, value: FeatureValue) -> bool:
        found = self.read(feature)
        if isinstance(value, float) and isinstance(found, float):
            return abs(found - value) <= _RELATIVE_ROUNDING * abs(value)
        return found == value


US_PER_UNIT = {"ns": 1e-3, "us": 1.0, "µs": 1.0, "μs": 1.0, "ms": 1e3, "s": 1e6}
COUNTS = "counts"
_TWELVE_BITS = 4096
_MASTER_GAINS = ("All", "AnalogAll", "SensorAll", "Sensor", "SensorAnalog", "AnalogTap1", "Tap1")
"""Entry of GainSelector that is set, the first of these; the digital ones become neutral."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedValue:
    """A value as the camera states it: ``unit`` is dB, factor, %, DN of 12 bits or counts."""

    feature: str
    value: float
    unit: str

    @property
    def decibels(self) -> float | None:
        """It as a gain in dB; None for counts, whose scale the camera does not tell."""
        if self.unit == "factor":
            return 20 * log10(self.value) if self.value > 0 else None
        return self.value if self.unit == "dB" else None

    def levels_dn(self, max_level_dn: int) -> float | None:
        """It as a black level in DN of a pixel format; None for counts."""
        if self.unit == "%":
            return self.value / 100 * (max_level_dn + 1)
        if self.unit == "DN of 12 bits":
            return self.value * (max_level_dn + 1) / _TWELVE_BITS
        return None


class LevelControls:
    """What sets the level of a pixel of a camera, named by vendor and model."""

    def __init__(self, features: CameraFeatures, camera: str) -> None:
        self._features = features
        self._camera = camera

    def select_master_gain(self) -> None:
        """Let the gain be that of all pixels, and digital gains beside it be none."""
        row = self._row("gain")
        if not self._features.has(row.selector):
            return
        entries = self._features.entries(row.selector)
        master = next((name for name in _MASTER_GAINS if name in entries), None)
        unit = self._unit(row)
        for entry in entries:
            if entry != master and "Digital" in entry and unit in ("dB", "factor"):
                self._features.write(row.selector, entry)
                self._features.write(row.name, 0.0 if unit == "dB" else 1.0)
        if master is not None:
            self._features.write(row.selector, master)

    def exposure_us(self) -> float:
        """The exposure read back, in us."""
        row = self._row("exposure")
        return self._features.number(row.name) * self._us_per_unit(row)

    def set_exposure_us(self, exposure_us: float) -> float:
        """Set the exposure and return the one read back, in us."""
        row = self._row("exposure")
        scale = self._us_per_unit(row)
        return self._set(row.name, exposure_us / scale) * scale

    def exposure_bounds_us(self) -> Bounds:
        """Exposures that the camera accepts, in us."""
        row = self._row("exposure")
        bounds, scale = self._features.bounds(row.name), self._us_per_unit(row)
        return Bounds(low=bounds.low * scale, high=bounds.high * scale)

    def gain(self) -> StatedValue:
        """The gain read back."""
        row = self._row("gain")
        return StatedValue(
            feature=row.name, value=self._features.number(row.name), unit=self._unit(row)
        )

    def set_gain_db(self, gain_db: float) -> StatedValue:
        """Set the gain; 0 dB is the lowest one of a camera that counts gain without a scale."""
        row = self._row("gain")
        unit = self._unit(row)
        if unit == COUNTS and gain_db != 0:
            bounds = self._features.bounds(row.name)
            raise CameraFeatureError(
                f"camera.gain_db {gain_db:g}: this camera's {row.name} counts from "
                f"{bounds.low:g} to {bounds.high:g} without a scale in dB; set camera.gain_counts "
                "to one of these counts and camera.gain_db to 0 (camera.gain_db = 0 on its own "
                "gives the lowest gain)",
                feature=row.name,
            )
        if unit == COUNTS:
            self._set(row.name, self._features.bounds(row.name).low)
        else:
            self._set(row.name, gain_db if unit == "dB" else 10 ** (gain_db / 20))
        return self.gain()

    def set_gain_counts(self, gain_counts: float) -> StatedValue:
        """Set a gain that has no scale in dB."""
        row = self._row("gain")
        unit = self._unit(row)
        if unit != COUNTS:
            raise CameraFeatureError(
                f"camera.gain_counts {gain_counts:g}: this camera's {row.name} is in {unit}; set "
                "camera.gain_db instead",
                feature=row.name,
            )
        self._set(row.name, gain_counts)
        return self.gain()

    def gain_bounds(self) -> tuple[StatedValue, StatedValue]:
        """The lowest and the highest gain that the camera accepts."""
        row = self._row("gain")
        bounds, unit = self._features.bounds(row.name), self._unit(row)
        low, high = (
            StatedValue(feature=row.name, value=value, unit=unit)
            for value in (bounds.low, bounds.high)
        )
        return low, high

    def black_level(self) -> StatedValue | None:
        """The black level read back; None if the camera has none."""
        row = self._found("black level")
        if row is None:
            return None
        return StatedValue(
            feature=row.name, value=self._features.number(row.name), unit=self._unit(row)
        )

    def _set(self, feature: str, wanted: float) -> float:
        self._features.send(feature, wanted)
        found = self._features.number(feature)
        if not abs(found - wanted) <= max(self._features.step(feature), 0.001 * wanted):
            raise CameraFeatureError(
                f"the camera does not keep {feature}: set to {wanted:g}, it reads back {found:g}",
                feature=feature,
            )
        return found

    def _unit(self, row: FeatureName) -> str:
        """The unit in the camera's description, if it is one of those known; else the table's."""
        stated = (self._features.unit_of(row.name) or "").strip()
        known = {"db": "dB", "%": "%", "percent": "%"}
        return known.get(stated.casefold(), row.unit)

    def _us_per_unit(self, row: FeatureName) -> float:
        return US_PER_UNIT.get((self._features.unit_of(row.name) or row.unit).strip(), 1.0)

    def _found(self, purpose: str) -> FeatureName | None:
        rows = names_for(purpose, self._camera)
        return next((row for row in rows if self._features.has(row.name)), None)

    def _row(self, purpose: str) -> FeatureName:
        row = self._found(purpose)
        if row is None:
            names = tuple(dict.fromkeys(row.name for row in names_for(purpose, self._camera)))
            raise MissingFeatureError(
                f"{self._camera} has no feature {' or '.join(names)} with which to set its "
                f"{purpose}; this camera cannot be used",
                names=names,
            )
        return row
