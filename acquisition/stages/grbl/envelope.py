"""The work envelope: the heights that a controller's settings leave to the stage.

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
from typing import Literal

from acquisition.bench import StageConfig
from acquisition.stages.grbl.setup import (
    FIRST_TRAVEL,
    HARD_LIMITS,
    HOMING,
    HOMING_INVERTED,
    PULL_OFF,
    height_axis,
)

ORIGIN_BIT = 8
"""Bit of grblHAL's ``$22``: homing sets the position to 0 where it ends."""

SLACK_MM = 1e-3
"""Positions are reported to a thousandth."""

End = Literal["home", "far"]


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvelopeFault:
    """Limits that go beyond a work envelope, and what to change."""

    found: str
    remedy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkEnvelope:
    """Heights between which the controller moves the stage.

    ``shortened_at`` names the ends at which it keeps off by the pull-off.
    """

    low_mm: float
    high_mm: float
    travel_mm: float
    travel_setting: str
    pull_off_mm: float
    shortened_at: tuple[End, ...]

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

    def fault(self, limits_mm: tuple[float, float]) -> EnvelopeFault | None:
        """Return what is wrong with ``limits_mm`` of the bench file; None if all is reached."""
        low_mm, high_mm = limits_mm
        if low_mm >= self.low_mm - SLACK_MM and high_mm <= self.high_mm + SLACK_MM:
            return None
        settings = f"stage.home_offset_mm and {self.travel_setting}"
        kept_mm = max(low_mm, self.low_mm), min(high_mm, self.high_mm)
        remedy = f"correct {settings}, with which no height within them is reached"
        if kept_mm[0] < kept_mm[1]:
            shorter = ", or a shorter $27 that still releases the switch"
            remedy = (
                f"set stage.limits_mm = [{kept_mm[0]:g}, {kept_mm[1]:g}]"
                f"{shorter if self.shortened_at else ''}; or correct {settings}"
            )
        return EnvelopeFault(
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
) -> WorkEnvelope | None:
    """Return the work envelope that a controller's settings make.

    Parameters
    ----------
    settings
        Values by number, as the controller lists them; ``$27`` is needed.
    config
        The ``[stage]`` section.
    family
        Firmware: grblHAL keeps off both ends where hard limits are on.
    sets_origin
        Whether homing sets the position to 0 where it ends, instead of counting from the switch.

    Returns
    -------
    WorkEnvelope or None
        None if the settings state no travel.
    """
    scale = height_axis(config)
    number = FIRST_TRAVEL + scale.index
    travel_mm, pull_off_mm = abs(settings.get(number, 0.0)), settings[PULL_OFF]
    if travel_mm == 0.0:
        return None
    inwards = 1.0 if int(settings.get(HOMING_INVERTED, 0.0)) >> scale.index & 1 else -1.0
    # Unless told otherwise Grbl counts from -travel to 0, wherever the switch is.
    home_mm = 0.0 if sets_origin or inwards < 0 else -travel_mm
    far_mm = home_mm + inwards * travel_mm
    shortened_at: list[End] = []
    if int(settings.get(HARD_LIMITS, 0.0)) & 1:
        if not sets_origin:
            home_mm += inwards * pull_off_mm
            shortened_at.append("home")
        if family == "grblHAL":
            far_mm -= inwards * pull_off_mm
            shortened_at.append("far")
    low_mm, high_mm = sorted((scale.height_mm(home_mm), scale.height_mm(far_mm)))
    return WorkEnvelope(
        low_mm=low_mm,
        high_mm=high_mm,
        travel_mm=travel_mm,
        travel_setting=f"${number}",
        pull_off_mm=pull_off_mm,
        shortened_at=tuple(shortened_at),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedEnvelopes:
    """What ``stage.expected_settings`` tells of the work envelope, without asking the controller.

    Parameters
    ----------
    largest, smallest
        What the controller reaches at most and at least, whatever is not named; None if not even
        travel and pull-off are.
    unnamed
        Settings that would tell the rest.
    """

    largest: WorkEnvelope | None
    smallest: WorkEnvelope | None
    unnamed: tuple[str, ...]


def expected_envelopes(config: StageConfig) -> ExpectedEnvelopes:
    """Return the work envelopes that the expected settings of a bench file leave possible."""
    keys = {key.removeprefix("$"): value for key, value in config.expected_settings.items()}
    named = {int(digits): value for digits, value in keys.items() if digits.isdecimal()}
    asked = (HARD_LIMITS, HOMING_INVERTED, PULL_OFF, FIRST_TRAVEL + height_axis(config).index)
    unnamed = tuple(f"${number}" for number in asked if number not in named)
    sets_origin = bool(int(named.get(HOMING, 0.0)) & ORIGIN_BIT)
    needed = asked[1:] if sets_origin else asked[2:]
    if not all(number in named for number in needed):
        return ExpectedEnvelopes(largest=None, smallest=None, unnamed=unnamed)
    with_limits = {HARD_LIMITS: 1.0, **named}
    is_end_known = HOMING_INVERTED in named
    return ExpectedEnvelopes(
        largest=work_envelope(
            named if is_end_known else {**named, HARD_LIMITS: 0.0},
            config,
            family="Grbl",
            sets_origin=sets_origin,
        ),
        smallest=work_envelope(with_limits, config, family="grblHAL", sets_origin=sets_origin),
        unnamed=unnamed,
    )
