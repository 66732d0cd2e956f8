"""What a Grbl controller's settings mean for the stage, and whether they are as expected."""

from dataclasses import dataclass
from math import isfinite

from acquisition.bench import StageConfig
from acquisition.errors import DeviceProtocolError, DeviceSettingsError
from acquisition.stages.grbl.wire import AXES

REPORT_INCHES, HARD_LIMITS, HOMING, HOMING_INVERTED, LOCATE_FEED, PULL_OFF = 13, 21, 22, 23, 24, 27
SEEK_RATE, DEBOUNCE_MS, FIRST_TRAVEL = 25, 26, 130
SEARCHED, LOCATED = 1.5, 5.0
"""Grbl looks for a switch over so many times the travel, then over so many times the pull-off."""

KEEP_HOMED_ON_RESET = 7
"""Bit of grblHAL's ``$22``."""

ABSENT = {REPORT_INCHES: 0.0, HOMING_INVERTED: 0.0, LOCATE_FEED: 25.0, PULL_OFF: 1.0}
"""Grbl's defaults, where a grblHAL with settings per axis does not list a value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightAxis:
    """Conversion between heights and machine positions of one axis."""

    letter: str
    sign: float
    offset_mm: float

    @property
    def index(self) -> int:
        """Index of the axis in a report."""
        return AXES.index(self.letter)

    def height_mm(self, machine_mm: float) -> float:
        """Height at a machine position, without binary rounding noise."""
        return round(self.sign * machine_mm + self.offset_mm, 6)

    def machine_mm(self, height_mm: float) -> float:
        """Machine position for a height."""
        return self.sign * (height_mm - self.offset_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblSetup:
    """The settings that homing depends on.

    ``towards_switch`` is the sign of the machine direction towards the home switch; ``homing_s``
    is the longest homing by travel and rates, 0 where they are not stated.
    """

    is_homing_enabled: bool
    keeps_homed_on_reset: bool
    towards_switch: float
    pull_off_mm: float
    locate_feed_mm_per_min: float
    homing_s: float = 0.0


def height_axis(config: StageConfig) -> HeightAxis:
    """Return the axis given in the bench file."""
    return HeightAxis(
        letter=config.axis,
        sign=1.0 if config.direction == "up" else -1.0,
        offset_mm=config.home_offset_mm,
    )


def check_settings(settings: dict[int, str], config: StageConfig, *, name: str) -> GrblSetup:
    """Read the settings that homing needs, and compare with the bench file.

    Raises
    ------
    DeviceSettingsError
        If the controller reports inches, or settings differ from the expected ones.
    DeviceProtocolError
        If a setting is missing or not a number.
    """
    if _number(settings, REPORT_INCHES, name) != 0:
        raise DeviceSettingsError(
            f"{name} reports inches; set $13=0 in a terminal", settings=(f"${REPORT_INCHES}",)
        )
    faults = {}
    for key, expected in config.expected_settings.items():
        digits = key.removeprefix("$")
        if not digits.isdecimal():
            raise DeviceSettingsError(
                f"expected_settings: {key!r} is not a Grbl setting such as '$102'", settings=(key,)
            )
        found = settings.get(int(digits))
        if found is None or _as_number(found) != expected:
            faults[f"${digits}"] = f"${digits} is {found or 'missing'}, expected {expected:g}"
    if faults:
        raise DeviceSettingsError(
            f"{name} does not have the settings of the bench file: {'; '.join(faults.values())}. "
            "Enter them in a terminal, or correct expected_settings",
            settings=tuple(faults),
        )
    homing = int(_number(settings, HOMING, name))
    inverted = int(_number(settings, HOMING_INVERTED, name))
    is_towards_minus = inverted >> AXES.index(config.axis) & 1
    return GrblSetup(
        is_homing_enabled=bool(homing & 1),
        keeps_homed_on_reset=bool(homing >> KEEP_HOMED_ON_RESET & 1),
        towards_switch=-1.0 if is_towards_minus else 1.0,
        pull_off_mm=_number(settings, PULL_OFF, name),
        locate_feed_mm_per_min=_number(settings, LOCATE_FEED, name),
        homing_s=_homing_s(settings, config, name),
    )


def numbers_of(settings: dict[int, str]) -> dict[int, float]:
    """Return the settings that are numbers, with Grbl's defaults; grblHAL's may be texts."""
    read = {number: _as_number(text) for number, text in settings.items()}
    return ABSENT | {number: value for number, value in read.items() if value is not None}


def _homing_s(settings: dict[int, str], config: StageConfig, name: str) -> float:
    """Longest homing cycle of Grbl 1.1 (``limits_go_home``): of one axis, or of all in turn."""
    seek_mm_per_min = _as_number(settings.get(SEEK_RATE, "")) or 0.0
    locate_mm_per_min = _number(settings, LOCATE_FEED, name)
    if min(seek_mm_per_min, locate_mm_per_min) <= 0:
        return 0.0
    stated = (_as_number(settings.get(FIRST_TRAVEL + index, "")) for index in range(len(AXES)))
    travels_mm = [abs(travel_mm) for travel_mm in stated if travel_mm is not None]
    if config.homing == "single_axis":
        own_mm = _as_number(settings.get(FIRST_TRAVEL + AXES.index(config.axis), ""))
        travels_mm = [] if own_mm is None else [abs(own_mm)]
    pull_off_mm = _number(settings, PULL_OFF, name)
    debounce_s = 1e-3 * (_as_number(settings.get(DEBOUNCE_MS, "")) or 0.0)
    quick_mm = SEARCHED * sum(travels_mm) + 2 * pull_off_mm * len(travels_mm)
    slow_mm = LOCATED * pull_off_mm * len(travels_mm)
    moving_s = 60.0 * (quick_mm / seek_mm_per_min + slow_mm / locate_mm_per_min)
    return moving_s + 4 * debounce_s * len(travels_mm)


def _number(settings: dict[int, str], number: int, name: str) -> float:
    if number not in settings and number in ABSENT:
        return ABSENT[number]
    value = _as_number(settings.get(number, ""))
    if value is None:
        raise DeviceProtocolError(f"{name} has no readable setting ${number}")
    return value


def _as_number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if isfinite(value) else None
