"""Status reports of a Grbl emulator, in the form of each of its dialects."""

from collections.abc import Mapping
from dataclasses import dataclass

MM_PER_INCH = 25.4

MACHINE_POSITION, BUFFERS, FEED, PINS, OFFSET, OVERRIDES = 1, 2, 8, 16, 32, 64
ALARM_SUBSTATE = 1024
WHEN_HOMING = 4096
"""Bits of grblHAL's ``$10``."""

SINGLE_AXIS = 2
"""Bit of grblHAL's ``$22``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reported:
    """What a report is about.

    Parameters
    ----------
    state, alarm
        State, and the code of the alarm that it is in, 0 for none.
    height_mm, work_offset_mm, feed_mm_per_min
        Of Z.
    is_pressed, is_homed, is_blocked
        Whether a switch is, the axis is, and nothing but a reset ends the alarm.
    settings
        Those of the controller.
    count
        Reports since the reset.
    axes
        Letters of all axes.
    everything
        Whether every field was asked for.
    """

    state: str
    alarm: int
    height_mm: float
    work_offset_mm: float
    feed_mm_per_min: float
    is_pressed: bool
    is_homed: bool
    is_blocked: bool
    settings: Mapping[int, float]
    count: int
    axes: str
    everything: bool

    @property
    def unit(self) -> float:
        """Length that is reported for 1 mm."""
        return 1 / MM_PER_INCH if self.settings[13] else 1.0

    def positions(self, z_mm: float) -> str:
        """Position of every axis, all but Z at 0."""
        each = (z_mm * self.unit if letter == "Z" else 0.0 for letter in self.axes)
        return ",".join(f"{position:.3f}" for position in each)


def old_report(seen: Reported) -> str:
    """Return the report of Grbl 0.9."""
    return (
        f"<{seen.state.partition(':')[0]},MPos:{seen.positions(seen.height_mm)},"
        f"WPos:{seen.positions(seen.height_mm - seen.work_offset_mm)}>"
    )


def grbl_report(seen: Reported) -> str:
    """Return the report of Grbl 1.1."""
    shows_machine = int(seen.settings[10]) & MACHINE_POSITION
    fields = [
        seen.state,
        _position(seen, shows_machine=bool(shows_machine)),
        f"Bf:15,128|FS:{seen.feed_mm_per_min * seen.unit:.0f},0",
    ]
    if seen.is_pressed:
        fields.append("Pn:Z")
    if seen.count % 10 == 0:
        fields.append(_offset(seen))
    elif seen.count % 10 == 1:
        fields.append("Ov:100,100,100")
    return f"<{'|'.join(fields)}>"


def grblhal_report(seen: Reported, *, adds_homed: bool, adds: str) -> str:
    """Return the report of grblHAL, with the field of the homed axes and with others added."""
    bits, full = int(seen.settings[10]), seen.everything
    names_alarm = seen.state == "Alarm" and seen.alarm and (full or bits & ALARM_SUBSTATE)
    mask = f",{4 * seen.is_homed}" if int(seen.settings[22]) & SINGLE_AXIS else ""
    fields = (
        (True, f"Alarm:{seen.alarm}" if names_alarm else seen.state),
        (True, _position(seen, shows_machine=bool(bits & MACHINE_POSITION))),
        (bits & BUFFERS, "Bf:100,1023"),
        (bits & FEED, f"FS:{seen.feed_mm_per_min * seen.unit:.0f},0"),
        (bits & PINS and seen.is_pressed, "Pn:Z"),
        (bits & OFFSET and (full or seen.count % 10 == 1), _offset(seen)),
        (full, "WCS:G54"),
        (bits & OVERRIDES and (full or seen.count % 10 == 0), "Ov:100,100,100|A:"),
        (full, "Sc:|MPG:0"),
        (full or adds_homed, f"H:{int(seen.is_homed)}{mask}"),
        (full, "T:0|P:0|TLR:0|FW:grblHAL"),
        (full and seen.is_blocked, "$C:1"),
    )
    return f"<{'|'.join(text for is_shown, text in fields if is_shown)}{adds}>"


def _offset(seen: Reported) -> str:
    return f"WCO:{seen.positions(seen.work_offset_mm)}"


def _position(seen: Reported, *, shows_machine: bool) -> str:
    shift_mm = 0.0 if shows_machine else seen.work_offset_mm
    return f"{'MPos' if shows_machine else 'WPos'}:{seen.positions(seen.height_mm - shift_mm)}"
