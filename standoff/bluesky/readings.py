"""Readings and their descriptions, as the event model has them."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Value = float | int | str


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """What one key of an event holds: its source, its unit if it has one, digits to show."""

    source: str
    is_text: bool = False
    is_whole: bool = False
    units: str | None = None
    precision: int | None = None

    @property
    def data_key(self) -> dict[str, Any]:
        """The description in an event descriptor."""
        dtype = "string" if self.is_text else "integer" if self.is_whole else "number"
        key: dict[str, Any] = {"source": self.source, "dtype": dtype, "shape": []}
        if self.units is not None:
            key["units"] = self.units
        if self.precision is not None:
            key["precision"] = self.precision
        return key


def described(signals: Mapping[str, Signal]) -> dict[str, dict[str, Any]]:
    """Descriptions by key."""
    return {key: signal.data_key for key, signal in signals.items()}


def readings(values: Mapping[str, Value], taken_s: float | None = None) -> dict[str, Any]:
    """Readings by key, all of one moment: seconds since 1970, now if None."""
    stamp_s = time.time() if taken_s is None else taken_s
    return {key: {"value": value, "timestamp": stamp_s} for key, value in values.items()}
