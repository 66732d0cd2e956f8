"""GenICam features of an open Aravis camera, by name; every error names its feature."""

from collections.abc import Sequence

from acquisition.aravis.device import OpenedDevice
from acquisition.aravis.errors import translated_errors
from acquisition.errors import CameraFeatureError

FeatureValue = str | int | float | bool

RELATIVE_ROUNDING = 1e-6
"""Relative error of a value read back from a 32-bit float register."""


class CameraFeatures:
    """Reads and writes features of one camera.

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

    def first_of(self, names: Sequence[str]) -> str | None:
        """First of several names for the same feature that the camera knows."""
        return next((name for name in names if self.has(name)), None)

    def read(self, feature: str, kind: type[FeatureValue]) -> FeatureValue:
        """Present value, as a ``bool``, ``int``, ``float`` or ``str``."""
        with translated_errors(self._opened.library, feature):
            if kind is bool:
                return bool(self._opened.camera.get_boolean(feature))
            if kind is int:
                return int(self._opened.camera.get_integer(feature))
            if kind is float:
                return float(self._opened.camera.get_float(feature))
            return str(self._opened.camera.get_string(feature))

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
        with translated_errors(self._opened.library, feature):
            if isinstance(value, bool):
                self._opened.camera.set_boolean(feature, value)
            elif isinstance(value, int):
                self._opened.camera.set_integer(feature, value)
            elif isinstance(value, float):
                self._opened.camera.set_float(feature, value)
            else:
                self._opened.camera.set_string(feature, value)
        if not self._is(feature, value):
            found = self.read(feature, type(value))
            raise CameraFeatureError(
                f"the camera does not keep {feature}: set to {value}, it reads {found}",
                feature=feature,
            )

    def step(self, feature: str) -> float:
        """Increment of a numeric feature; 1 where the camera does not state it."""
        with translated_errors(self._opened.library, feature):
            try:
                step = float(self._opened.camera.get_float_increment(feature))
            except self._opened.library.glib.Error:
                return 1.0
        return step if 1e-9 < step < 1e9 else 1.0

    def _is(self, feature: str, value: FeatureValue) -> bool:
        found = self.read(feature, type(value))
        if isinstance(value, float) and isinstance(found, float):
            return abs(found - value) <= RELATIVE_ROUNDING * abs(value)
        return found == value
