"""Exposure, gain and black level of any camera, in units of ours beside the camera's own."""

from dataclasses import dataclass
from math import log10

from acquisition.aravis.feature_names import FeatureName, names_for
from acquisition.aravis.features import Bounds, CameraFeatures
from acquisition.errors import CameraFeatureError, MissingFeatureError

US_PER_UNIT = {"ns": 1e-3, "us": 1.0, "µs": 1.0, "μs": 1.0, "ms": 1e3, "s": 1e6}
COUNTS = "counts"
TWELVE_BITS = 4096
MASTER_GAINS = ("All", "AnalogAll", "SensorAll", "Sensor", "SensorAnalog", "AnalogTap1", "Tap1")
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
            return self.value * (max_level_dn + 1) / TWELVE_BITS
        return None


class LevelControls:
    """What sets the level of a pixel.

    Parameters
    ----------
    features
        The camera's features.
    camera
        Vendor and model, as the camera names them.
    """

    def __init__(self, features: CameraFeatures, camera: str) -> None:
        self._features = features
        self._camera = camera

    def select_master_gain(self) -> None:
        """Let the gain be that of all pixels, and digital gains beside it be none."""
        row = self._row("gain")
        if not self._features.has(row.selector):
            return
        entries = self._features.entries(row.selector)
        master = next((name for name in MASTER_GAINS if name in entries), None)
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
        """Set the gain; 0 dB is the lowest one of a camera that counts gain without a scale.

        Raises
        ------
        CameraFeatureError
            If the camera refuses it, or cannot tell it in dB.
        """
        row = self._row("gain")
        unit = self._unit(row)
        if unit == COUNTS and gain_db != 0:
            bounds = self._features.bounds(row.name)
            raise CameraFeatureError(
                f"camera.gain_db {gain_db:g}: this camera's {row.name} counts from "
                f"{bounds.low:g} to {bounds.high:g} without a scale in dB; set camera.gain_counts "
                "to one of these counts and camera.gain_db to 0, which alone is the lowest gain",
                feature=row.name,
            )
        if unit == COUNTS:
            self._set(row.name, self._features.bounds(row.name).low)
        else:
            self._set(row.name, gain_db if unit == "dB" else 10 ** (gain_db / 20))
        return self.gain()

    def set_gain_counts(self, gain_counts: float) -> StatedValue:
        """Set a gain that has no scale in dB.

        Raises
        ------
        CameraFeatureError
            If the camera refuses it, or states its gain in dB.
        """
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
                f"the camera does not keep {feature}: set to {wanted:g}, it reads {found:g}",
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
                f"{self._camera} has no feature {' or '.join(names)}, by which its {purpose} is "
                "set; it cannot be used",
                names=names,
            )
        return row
