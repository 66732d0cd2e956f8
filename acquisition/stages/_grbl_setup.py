"""What a Grbl controller's settings mean for the stage: homing, and the work envelope.

After homing the stage stands the pull-off ``$27`` from its home switch. The switch is an end of
the travel ``$132`` (``$130`` for X), so heights nearer to it than that are reached only where
hard limits are off. grblHAL keeps off the other end as well then.

References
----------
Grbl v1.1, ``limits.c`` (``limits_go_home``) and ``system.c`` (``system_check_travel_limits``).
grblHAL 1.1f.20260817, ``machine_limits.c`` (``limits_set_work_envelope``).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Literal

from acquisition.bench import StageConfig
from acquisition.errors import DeviceProtocolError, DeviceSettingsError
from acquisition.stages.grbl_wire import AXES

_REPORT_INCHES, HARD_LIMITS, _HOMING, _HOMING_INVERTED, _LOCATE_FEED, _PULL_OFF = (
    13,
    21,
    22,
    23,
    24,
    27,
)
_SEEK_RATE, _DEBOUNCE_MS, _FIRST_TRAVEL = 25, 26, 130
_SEARCHED, _LOCATED = 1.5, 5.0
"""Grbl looks for a switch over so many times the travel, then over so many times the pull-off."""

_KEEP_HOMED_ON_RESET = 7
"""Bit of grblHAL's ``$22``."""

_ABSENT = {_REPORT_INCHES: 0.0, _HOMING_INVERTED: 0.0, _LOCATE_FEED: 25.0, _PULL_OFF: 1.0}
"""Grbl's defaults, where a grblHAL with settings per axis does not list a value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _HeightAxis:
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
    """The settings that homing depends on; ``homing_s`` is its longest time, 0 if not stated."""

    is_homing_enabled: bool
    keeps_homed_on_reset: bool
    towards_switch: float
    pull_off_mm: float
    locate_feed_mm_per_min: float
    homing_s: float = 0.0


def height_axis(config: StageConfig) -> _HeightAxis:
    """Return the axis given in the bench file."""
    return _HeightAxis(
        letter=config.axis,
        sign=1.0 if config.direction == "up" else -1.0,
        offset_mm=config.home_offset_mm,
    )


def check_settings(settings: dict[int, str], config: StageConfig, *, name: str) -> GrblSetup:
    """Read the settings that homing needs, and compare with the bench file."""
    if _number(settings, _REPORT_INCHES, name) != 0:
        raise DeviceSettingsError(
            f"{name} reports inches; set $13=0 in a terminal", settings=(f"${_REPORT_INCHES}",)
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
    homing = int(_number(settings, _HOMING, name))
    inverted = int(_number(settings, _HOMING_INVERTED, name))
    is_towards_minus = inverted >> AXES.index(config.axis) & 1
    return GrblSetup(
        is_homing_enabled=bool(homing & 1),
        keeps_homed_on_reset=bool(homing >> _KEEP_HOMED_ON_RESET & 1),
        towards_switch=-1.0 if is_towards_minus else 1.0,
        pull_off_mm=_number(settings, _PULL_OFF, name),
        locate_feed_mm_per_min=_number(settings, _LOCATE_FEED, name),
        homing_s=_homing_s(settings, config, name),
    )


def numbers_of(settings: dict[int, str]) -> dict[int, float]:
    """Return the settings that are numbers, with Grbl's defaults; grblHAL's may be texts."""
    read = {number: _as_number(text) for number, text in settings.items()}
    return _ABSENT | {number: value for number, value in read.items() if value is not None}


def _homing_s(settings: dict[int, str], config: StageConfig, name: str) -> float:
    """Longest homing cycle of Grbl 1.1 (``limits_go_home``): of one axis, or of all in turn."""
    seek_mm_per_min = _as_number(settings.get(_SEEK_RATE, "")) or 0.0
    locate_mm_per_min = _number(settings, _LOCATE_FEED, name)
    if min(seek_mm_per_min, locate_mm_per_min) <= 0:
        return 0.0
    stated = (_as_number(settings.get(_FIRST_TRAVEL + index, "")) for index in range(len(AXES)))
    travels_mm = [abs(travel_mm) for travel_mm in stated if travel_mm is not None]
    if config.homing == "single_axis":
        own_mm = _as_number(settings.get(_FIRST_TRAVEL + AXES.index(config.axis), ""))
        travels_mm = [] if own_mm is None else [abs(own_mm)]
    pull_off_mm = _number(settings, _PULL_OFF, name)
    debounce_s = 1e-3 * (_as_number(settings.get(_DEBOUNCE_MS, "")) or 0.0)
    quick_mm = _SEARCHED * sum(travels_mm) + 2 * pull_off_mm * len(travels_mm)
    slow_mm = _LOCATED * pull_off_mm * len(travels_mm)
    moving_s = 60.0 * (quick_mm / seek_mm_per_min + slow_mm / locate_mm_per_min)
    return moving_s + 4 * debounce_s * len(travels_mm)


def _number(settings: dict[int, str], number: int, name: str) -> float:
    if number not in settings and number in _ABSENT:
        return _ABSENT[number]
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


_ORIGIN_BIT = 8
"""Bit of grblHAL's ``$22``: homing sets the position to 0 where it ends."""

_SLACK_MM = 1e-3
"""Positions are reported to a thousandth."""

_End = Literal["home", "far"]


@dataclass(frozen=True, slots=True, kw_only=True)
class _EnvelopeFault:
    """Limits that go beyond a work envelope, and what to change."""

    found: str
    remedy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _WorkEnvelope:
    """Heights between which the controller moves, and the ends that the pull-off shortens."""

    low_mm: float
    high_mm: float
    travel_mm: float
    travel_setting: str
    pull_off_mm: float
    shortened_at: tuple[_End, ...]

    @property
    def explanation(self) -> str:
        """The heights, and the settings that they follow from."""
        heights = f"{self.low_mm:g} to {self.high_mm:g} mm: {self.travel_setting} = "
        pull_off = f"$27 = {self.pull_off_mm:g} mm"
        match self.shortened_at:
            case ():
                why = f" ({pull_off} of it between the home switch and where homing ends)"
            case ("home",):
                why = f" less {pull_off} to the home switch, which raises an alarm ($21=1)"
            case ("far",):
                why = f" less {pull_off} at the far end, which grblHAL keeps off ($21=1)"
            case _:
                why = f" less {pull_off} at each end, which grblHAL keeps off ($21=1)"
        return f"{heights}{self.travel_mm:g} mm{why}"

    def fault(self, limits_mm: tuple[float, float]) -> _EnvelopeFault | None:
        """Return what is wrong with ``limits_mm`` of the bench file; None if all is reached."""
        low_mm, high_mm = limits_mm
        if low_mm >= self.low_mm - _SLACK_MM and high_mm <= self.high_mm + _SLACK_MM:
            return None
        settings = f"stage.home_offset_mm and {self.travel_setting}"
        kept_mm = max(low_mm, self.low_mm), min(high_mm, self.high_mm)
        remedy = f"correct {settings}: as they are set, the stage reaches none of these heights"
        if kept_mm[0] < kept_mm[1]:
            shorter = ", or a shorter $27 that still releases the switch"
            remedy = (
                f"set stage.limits_mm = [{kept_mm[0]:g}, {kept_mm[1]:g}]"
                f"{shorter if self.shortened_at else ''}; or correct {settings}"
            )
        return _EnvelopeFault(
            found=(
                f"stage.limits_mm are {low_mm:g} to {high_mm:g} mm, but the controller reaches "
                f"{self.explanation}"
            ),
            remedy=remedy,
        )


def work_envelope(
    settings: Mapping[int, float],
    config: StageConfig,
    *,
    family: Literal["Grbl", "grblHAL"],
    sets_origin: bool,
) -> _WorkEnvelope | None:
    """Return the work envelope that settings by number make; None if they state no travel.

    ``$27`` is needed. grblHAL keeps off both ends where hard limits are on. ``sets_origin`` is
    whether homing sets the position to 0 where it ends.
    """
    scale = height_axis(config)
    number = _FIRST_TRAVEL + scale.index
    travel_mm, pull_off_mm = abs(settings.get(number, 0.0)), settings[_PULL_OFF]
    if travel_mm == 0.0:
        return None
    inwards = 1.0 if int(settings.get(_HOMING_INVERTED, 0.0)) >> scale.index & 1 else -1.0
    # Unless told otherwise Grbl counts from -travel to 0, wherever the switch is.
    home_mm = 0.0 if sets_origin or inwards < 0 else -travel_mm
    far_mm = home_mm + inwards * travel_mm
    shortened_at: list[_End] = []
    if int(settings.get(HARD_LIMITS, 0.0)) & 1:
        if not sets_origin:
            home_mm += inwards * pull_off_mm
            shortened_at.append("home")
        if family == "grblHAL":
            far_mm -= inwards * pull_off_mm
            shortened_at.append("far")
    low_mm, high_mm = sorted((scale.height_mm(home_mm), scale.height_mm(far_mm)))
    return _WorkEnvelope(
        low_mm=low_mm,
        high_mm=high_mm,
        travel_mm=travel_mm,
        travel_setting=f"${number}",
        pull_off_mm=pull_off_mm,
        shortened_at=tuple(shortened_at),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _ExpectedEnvelopes:
    """What ``stage.expected_settings`` tells of the most and least that the controller reaches."""

    largest: _WorkEnvelope | None
    smallest: _WorkEnvelope | None
    unnamed: tuple[str, ...]


def expected_envelopes(config: StageConfig) -> _ExpectedEnvelopes:
    """Return the work envelopes that the expected settings of a bench file leave possible."""
    keys = {key.removeprefix("$"): value for key, value in config.expected_settings.items()}
    named = {int(digits): value for digits, value in keys.items() if digits.isdecimal()}
    asked = (HARD_LIMITS, _HOMING_INVERTED, _PULL_OFF, _FIRST_TRAVEL + height_axis(config).index)
    unnamed = tuple(f"${number}" for number in asked if number not in named)
    sets_origin = bool(int(named.get(_HOMING, 0.0)) & _ORIGIN_BIT)
    needed = asked[1:] if sets_origin else asked[2:]
    if not all(number in named for number in needed):
        return _ExpectedEnvelopes(largest=None, smallest=None, unnamed=unnamed)
    with_limits = {HARD_LIMITS: 1.0, **named}
    is_end_known = _HOMING_INVERTED in named
    return _ExpectedEnvelopes(
        largest=work_envelope(
            named if is_end_known else {**named, HARD_LIMITS: 0.0},
            config,
            family="Grbl",
            sets_origin=sets_origin,
        ),
        smallest=work_envelope(with_limits, config, family="grblHAL", sets_origin=sets_origin),
        unnamed=unnamed,
    )
