"""GenICam features of an open Aravis camera, by name; every error names its feature."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from typing import Literal

from acquisition.aravis.device import OpenedDevice, require_bounded
from acquisition.aravis.errors import translated_errors
from acquisition.aravis.library import text_of
from acquisition.errors import CameraFeatureError, DeviceError

FeatureValue = str | int | float | bool
FeatureType = Literal["boolean", "enumeration", "integer", "float", "command", "string"]

RELATIVE_ROUNDING = 1e-6
"""Relative error of a value read back from a 32-bit float register."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Smallest and largest value that a camera accepts at present."""

    low: float
    high: float


def whole(value: float, feature: str) -> int:
    """Return what a feature states as a whole number.

    Raises
    ------
    CameraFeatureError
        If it is infinite or no number.
    """
    if not isfinite(value):
        raise CameraFeatureError(
            f"the camera states {feature} as {value}, which is no size", feature=feature
        )
    return round(value)


class CameraFeatures:
    """Reads and writes features of one camera, whatever type they have there.

    Parameters
    ----------
    opened
        The camera.
    """

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

    def type_of(self, feature: str) -> FeatureType:
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
        """Present value of a number.

        Raises
        ------
        CameraFeatureError
            If the feature is no number in this camera.
        """
        value = self.read(feature)
        try:
            return float(value)
        except ValueError as error:
            raise CameraFeatureError(
                f"the camera states {feature} as {value!r}, which is no number", feature=feature
            ) from error

    def write(self, feature: str, value: FeatureValue) -> None:
        """Set a feature to exactly ``value``, unless it already has that value.

        A read-only feature that already has the wanted value is therefore no error.

        Raises
        ------
        CameraFeatureError
            If the camera refuses it, or another value is read back.
        """
        if self._is(feature, value):
            return
        self.send(feature, value)
        if not self._is(feature, value):
            raise CameraFeatureError(
                f"the camera does not keep {feature}: set to {value}, "
                f"it reads {self.read(feature)}",
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
            return abs(found - value) <= RELATIVE_ROUNDING * abs(value)
        return found == value
