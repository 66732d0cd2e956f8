"""Heights and microsteps of a Zaber stage."""

from dataclasses import dataclass
from typing import Self

from acquisition.bench import StageConfig
from acquisition.errors import BenchConfigError

__all__ = ["ZaberScale"]

MAXSPEED_PER_MICROSTEP_PER_S = 1.6384
"""Unit of ``maxspeed``; Zaber ASCII Protocol Manual, "Data conversion"."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ZaberScale:
    """How heights and microsteps belong together; ``mm_per_step`` is negative downwards."""

    mm_per_step: float
    offset_mm: float
    limits_mm: tuple[float, float]

    @classmethod
    def of(cls, config: StageConfig) -> Self:
        """Return the scale of a bench file.

        Raises
        ------
        BenchConfigError
            If it gives no ``microstep_um``.
        """
        if config.microstep_um is None:
            raise BenchConfigError("stage.microstep_um: the zaber driver needs it")
        sign = 1 if config.direction == "up" else -1
        return cls(
            mm_per_step=sign * config.microstep_um / 1000,
            offset_mm=config.home_offset_mm,
            limits_mm=config.limits_mm,
        )

    def height_mm(self, steps: float) -> float:
        """Height at a position, without the noise of binary fractions."""
        return round(steps * self.mm_per_step + self.offset_mm, 6)

    def steps(self, height_mm: float) -> int:
        """Nearest position within the limits."""
        steps = round((height_mm - self.offset_mm) / self.mm_per_step)
        low_mm, high_mm = self.limits_mm
        upwards = 1 if self.mm_per_step > 0 else -1
        if self.height_mm(steps) < low_mm:
            return steps + upwards
        return steps - upwards if self.height_mm(steps) > high_mm else steps

    def maxspeed(self, feed_mm_per_min: float) -> int:
        """Value of ``maxspeed`` for a feed."""
        steps_per_s = feed_mm_per_min / 60 / abs(self.mm_per_step)
        return round(steps_per_s * MAXSPEED_PER_MICROSTEP_PER_S)
