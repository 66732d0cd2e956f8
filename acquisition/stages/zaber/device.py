"""The dialogue with one axis of a Zaber device: commands, replies with their ids, flags."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from threading import RLock
from typing import Self

from acquisition.bench import StageConfig
from acquisition.errors import (
    BenchConfigError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceSettingsError,
    DeviceTimeoutError,
)
from acquisition.stages.serial_link import SerialLink
from acquisition.stages.zaber.wire import (
    MESSAGE_IDS,
    REJECTIONS,
    ZaberReply,
    encode_command,
    parse_message,
)

MAXSPEED_PER_MICROSTEP_PER_S = 1.6384
"""Unit of ``maxspeed``; Zaber ASCII Protocol Manual, "Data conversion"."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ZaberScale:
    """Conversion between heights and microsteps; ``mm_per_step`` is negative downwards."""

    mm_per_step: float
    offset_mm: float
    limits_mm: tuple[float, float]

    @classmethod
    def of(cls, config: StageConfig) -> Self:
        """Return the scale for a bench file.

        Raises
        ------
        BenchConfigError
            If it gives no ``microstep_um``.
        """
        if config.microstep_um is None:
            raise BenchConfigError(
                "stage.microstep_um is missing; driver 'zaber' requires it",
                keys=("stage.microstep_um",),
            )
        sign = 1 if config.direction == "up" else -1
        return cls(
            mm_per_step=sign * config.microstep_um / 1000,
            offset_mm=config.home_offset_mm,
            limits_mm=config.limits_mm,
        )

    def height_mm(self, steps: float) -> float:
        """Height at a position, without binary rounding noise."""
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


ANSWER_TIMEOUT_S = 1.0
"""A device answers within a few ms; a chain of many, within a tenth of a second."""

READ_TRIES = 3
QUIET_S = 0.1
NOISE_TIMEOUT_S = 3.0


class ZaberDevice:
    """One axis on an open link; every command has its own id, so stale replies are ignored.

    Parameters
    ----------
    link
        Open link.
    device, axis
        Address in the chain and number of the axis.
    clock
        Time in seconds.
    """

    def __init__(
        self, link: SerialLink, *, device: int, axis: int, clock: Callable[[], float]
    ) -> None:
        self._link = link
        self._device = device
        self._axis = axis
        self._clock = clock
        self._lock = RLock()
        self._next_id = 0
        self._needs_checksum = False

    @property
    def name(self) -> str:
        """Its name in error messages."""
        return self._link.name

    def connect(self) -> None:
        """Wait for silence, then have every reply carry its checksum.

        Raises
        ------
        DeviceTimeoutError
            If nothing answers.
        DeviceProtocolError
            If what answers is not a Zaber device.
        """
        with self._lock:
            heard = self._link.drain(QUIET_S, NOISE_TIMEOUT_S)
            try:
                reply = self._read_tries("set comm.checksum 1", axis=0)
            except DeviceProtocolError as error:
                raise DeviceProtocolError(
                    f"{error}; is this the right port and baud rate?"
                ) from error
            except DeviceTimeoutError as error:
                hint = f"; it said {heard[0][:40]!r} before" if heard else ""
                raise DeviceTimeoutError(
                    f"{error}; check its power, the port, baud_rate and device_address{hint}"
                ) from error
            # Firmware before 6.14 has no such setting and sends no checksums.
            self._needs_checksum = reply.is_ok

    def command(self, text: str, *, axis: int | None = None) -> ZaberReply:
        """Send a command and return its reply, which may be a rejection.

        Raises
        ------
        DeviceTimeoutError, DeviceProtocolError
            If the reply was lost or garbled; the command may have been obeyed.
        """
        with self._lock:
            message_id = self._next_id
            self._next_id = (self._next_id + 1) % MESSAGE_IDS
            axis = self._axis if axis is None else axis
            self._link.write(encode_command(self._device, axis, message_id, text))
            deadline = self._clock() + ANSWER_TIMEOUT_S
            while True:
                line = self._link.read_line(max(deadline - self._clock(), 0.0))
                message = parse_message(line)
                if not isinstance(message, ZaberReply):
                    continue  # alerts and info lines repeat what replies say
                if message.device != self._device or message.message_id != message_id:
                    continue
                if self._needs_checksum and not message.has_checksum:
                    raise DeviceProtocolError(f"{self.name}: reply without checksum: {line!r}")
                return message

    def ask(self, text: str, *, axis: int | None = None) -> ZaberReply:
        """Send a command that changes nothing, and repeat it if its reply was lost.

        Raises
        ------
        DeviceTimeoutError, DeviceProtocolError
            If no readable reply came.
        DeviceRefusalError
            If it was rejected.
        """
        reply = self._read_tries(text, axis=axis)
        if not reply.is_ok:
            raise self.rejected(text, reply)
        return reply

    def number(self, setting: str, *, axis: int | None = None) -> float:
        """Value of a setting.

        Raises
        ------
        DeviceProtocolError
            If it is not a number.
        DeviceRefusalError
            If the device does not know the setting.
        """
        data = self.ask(f"get {setting}", axis=axis).data
        try:
            value = float(data.split()[0])
        except (ValueError, IndexError) as error:
            raise DeviceProtocolError(
                f"{self.name}: {setting} is {data!r}, not a number"
            ) from error
        if not isfinite(value):
            raise DeviceProtocolError(f"{self.name}: {setting} is {data!r}, not a number")
        return value

    def check_settings(self, expected: Mapping[str, float]) -> None:
        """Compare settings of the device with those of the bench file.

        Raises
        ------
        DeviceSettingsError
            If some differ.
        """
        faults = {
            setting: f"{setting} is {found:g}, expected {value:g}"
            for setting, value in expected.items()
            if (found := self.number(setting)) != value
        }
        if faults:
            raise DeviceSettingsError(
                f"{self.name} does not have the settings of the bench file: "
                f"{'; '.join(faults.values())}. Correct the device or expected_settings",
                settings=tuple(faults),
            )

    def warnings(self) -> tuple[str, ...]:
        """All warning flags, the most serious first."""
        count, *flags = self.ask("warnings").data.split()
        if count != f"{len(flags):02d}":
            raise DeviceProtocolError(f"{self.name}: {count} warnings announced, {flags} sent")
        return tuple(flags)

    def rejected(self, text: str, reply: ZaberReply) -> DeviceRefusalError:
        """Return the error that says why a command was rejected."""
        reason = REJECTIONS.get(reply.data, "see the protocol manual")
        return DeviceRefusalError(
            f"{self.name} rejects {text!r}: {reply.data} ({reason}); nothing moved",
            code=reply.data,
        )

    def close(self) -> None:
        """Close the link; closing twice is harmless."""
        self._link.close()

    def _read_tries(self, text: str, *, axis: int | None = None) -> ZaberReply:
        for left in reversed(range(READ_TRIES)):
            try:
                return self.command(text, axis=axis)
            except (DeviceTimeoutError, DeviceProtocolError):
                if not left:
                    raise
        raise AssertionError("unreachable")
