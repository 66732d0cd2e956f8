"""The homing cycle of Grbl: seek, pull off, locate, pull off."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from hil_mocks.stages.plant import StagePlant
from hil_mocks.stages.stepper_axis import StepperAxis

SWITCH_NOT_RELEASED = 8
SWITCH_NOT_FOUND = 9
SEARCH_SCALAR = 1.5
LOCATE_SCALAR = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HomingSettings:
    """The firmware's settings for homing.

    Parameters
    ----------
    is_downwards
        Whether the switch is at the lower end.
    seek_mm_per_s, locate_mm_per_s
        Speeds of the first and the second search.
    pull_off_mm
        Distance back from the switch.
    travel_mm
        Travel of the axis; the search goes half as far again.
    """

    is_downwards: bool
    seek_mm_per_s: float
    locate_mm_per_s: float
    pull_off_mm: float
    travel_mm: float

    @classmethod
    def of(cls, settings: Mapping[int, float]) -> Self:
        """Read them from ``$23`` to ``$27`` and ``$132``."""
        return cls(
            is_downwards=bool(int(settings[23]) & 4),
            seek_mm_per_s=settings[25] / 60,
            locate_mm_per_s=settings[24] / 60,
            pull_off_mm=settings[27],
            travel_mm=settings[132],
        )


class HomingCycle:
    """One homing cycle; `step` is called after every increment of motion.

    Parameters
    ----------
    axis, plant
        The moving axis, and the plant with its switch.
    """

    def __init__(self, axis: StepperAxis, plant: StagePlant, settings: HomingSettings) -> None:
        self._axis = axis
        self._plant = plant
        self._settings = settings
        self._towards = -1.0 if settings.is_downwards else 1.0
        self._phases = ["seek", "pull off", "locate", "pull off"]
        self._begin()

    def step(self) -> int | None:
        """Return the alarm code, 0 when homed, None while still homing."""
        is_pull_off = self._phases[0] == "pull off"
        if not is_pull_off and self._is_pressed:
            self._axis.halt()
        elif self._axis.is_moving:
            return None
        elif not is_pull_off:
            return SWITCH_NOT_FOUND
        if is_pull_off and self._is_pressed:
            return SWITCH_NOT_RELEASED
        self._phases.pop(0)
        if not self._phases:
            return 0
        self._begin()
        return None

    @property
    def _is_pressed(self) -> bool:
        return self._plant.is_low_pressed if self._towards < 0 else self._plant.is_high_pressed

    def _begin(self) -> None:
        settings = self._settings
        way_mm, speed = {
            "seek": (SEARCH_SCALAR * settings.travel_mm, settings.seek_mm_per_s),
            "locate": (LOCATE_SCALAR * settings.pull_off_mm, settings.locate_mm_per_s),
            "pull off": (-settings.pull_off_mm, settings.seek_mm_per_s),
        }[self._phases[0]]
        self._axis.count_from(0.0)
        self._axis.go(self._towards * way_mm, speed)
