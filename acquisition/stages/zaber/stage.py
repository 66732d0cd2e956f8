"""A height stage on a Zaber controller."""

from collections.abc import Callable
from time import monotonic, sleep
from typing import Literal

from acquisition.bench import StageConfig
from acquisition.devices import DeviceInfo, StageState
from acquisition.errors import (
    DeviceError,
    DeviceProtocolError,
    DeviceResetError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
)
from acquisition.stages.serial_link import SerialLink, open_stage_link
from acquisition.stages.travel import approach_heights_mm, refuse_beyond_limits
from acquisition.stages.zaber.device import ZaberDevice, ZaberScale
from acquisition.stages.zaber.wire import WARNING_TEXTS

__all__ = ["ZaberStage", "open_zaber_stage"]

POLL_S = 0.05
STOP_TIMEOUT_S = 5.0

NO_REFERENCE = ("WR", "WH")
DRIVER_OFF = ("FD", "FO", "FH")


class ZaberStage:
    """Moves by absolute positions in microsteps, and believes only what it reads back.

    A height is the position times ``microstep_um``, turned to point up, plus
    ``home_offset_mm``. `connect` begins the dialogue; the constructor sends nothing.

    Parameters
    ----------
    config
        Address, microstep, limits, feed, settling, tolerance, side of approach.
    link
        Open link; `close` gives it back.
    clock, sleep
        Seconds, and how to let them pass.

    Attributes
    ----------
    warnings
        What the operator should know.

    Raises
    ------
    BenchConfigError
        If the bench file gives no ``microstep_um``.
    """

    def __init__(
        self,
        config: StageConfig,
        link: SerialLink,
        *,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self.warnings: tuple[str, ...] = ()
        self._config = config
        self._clock = clock
        self._sleep = sleep
        self._device = ZaberDevice(
            link, device=config.device_address, axis=config.axis_number, clock=clock
        )
        self._scale = ZaberScale.of(config)
        self._info = DeviceInfo(vendor="", model="", serial_number="", firmware="", driver="zaber")
        self._is_position_known = False
        self._is_flank_taken = False
        self._is_homing = False
        self._is_moving = False
        self._is_stop_wanted = False
        self._is_emergency = False

    def connect(self) -> None:
        """Ask who it is, compare its settings and set its speed; moves nothing.

        Without the warnings ``WR`` and ``WH`` the device says that it knows its position; that
        is believed.

        Raises
        ------
        DeviceError
            If it does not answer, is no Zaber device, or is not set as the bench file expects.
        """
        self._device.connect()
        model = self._device.number("device.id", axis=0)
        self._info = DeviceInfo(
            vendor="Zaber",
            model=f"device {model:.0f}",
            serial_number=self._device.ask("get system.serial", axis=0).data,
            firmware=self._device.ask("get version", axis=0).data,
            driver="zaber",
        )
        self._device.check_settings(self._config.expected_settings)
        speed = self._scale.maxspeed(self._config.feed_mm_per_min)
        if self._device.number("maxspeed") != speed:
            self._device.ask(f"set maxspeed {speed}")
        flags = self._device.warnings()
        self._is_position_known = not any(flag in NO_REFERENCE for flag in flags)
        self._keep_warnings(flags)

    @property
    def info(self) -> DeviceInfo:
        """See `Stage.info`."""
        return self._info

    @property
    def limits_mm(self) -> tuple[float, float]:
        """See `Stage.limits_mm`."""
        return self._config.limits_mm

    @property
    def is_homed(self) -> bool:
        """See `Stage.is_homed`."""
        return self._is_position_known and not self._is_emergency

    @property
    def state(self) -> StageState:
        """See `Stage.state`."""
        reply = self._device.ask("")
        if self._is_emergency or (reply.warning or "").startswith("F"):
            return "alarm"
        if reply.is_busy:
            return "homing" if self._is_homing else "moving"
        return "idle"

    def position_mm(self) -> float:
        """See `Stage.position_mm`.

        Raises
        ------
        StageNotHomedError
            If the position is not known.
        """
        if not self._is_emergency:
            self._watch(self._device.ask("").warning)
        if not self.is_homed:
            raise StageNotHomedError(f"{self._device.name} does not know its height: home it")
        return self._read_height_mm()

    def travel_height_mm(self) -> float | None:
        """See `TravellingStage`; messages have identities, so that asking disturbs no move."""
        return self._read_height_mm() if self.is_homed else None

    def home(self, timeout_s: float) -> None:
        """See `Stage.home`."""
        self._refuse_faults()
        deadline = self._clock() + timeout_s
        self._device.check_settings(self._config.expected_settings)
        self._is_position_known = self._is_flank_taken = False
        # Stays set through a keyboard interrupt, as a position without reference does.
        self._is_homing = True
        try:
            reply = self._device.command("home")
            if not reply.is_ok:
                raise self._device.rejected("home", reply)
            self._wait_for_idle(deadline)
        except (DeviceTimeoutError, DeviceProtocolError) as error:
            raise type(error)(
                f"{self._device.name} is not homed within {timeout_s:g} s: {error}; {self._halt()}"
            ) from error
        except DeviceError:
            self._is_homing = False
            raise
        flags = self._device.warnings()
        self._is_homing = False
        self._keep_warnings(flags)
        if any(flag in NO_REFERENCE for flag in flags):
            raise DeviceError(f"{self._device.name} found no reference; home it again")
        self._is_position_known = True

    def move_to(self, height_mm: float, timeout_s: float) -> float:
        """See `Stage.move_to`."""
        refuse_beyond_limits(height_mm, self.limits_mm)
        if self._is_moving:
            raise DeviceError(f"{self._device.name} is moving already; nothing was sent")
        self._is_stop_wanted = False
        self._refuse_faults()
        deadline = self._clock() + timeout_s
        if not self.is_homed:
            raise StageNotHomedError(f"{self._device.name} must be homed before it moves")
        reply = self._device.ask("")
        self._watch(reply.warning)
        if reply.is_busy:
            raise DeviceError(f"{self._device.name} is moving; stop it or wait")
        stops_mm = approach_heights_mm(
            self._config,
            start_mm=self._read_height_mm(),
            target_mm=height_mm,
            is_flank_taken=self._is_flank_taken,
        )
        self._is_moving, self._is_flank_taken = True, False
        try:
            for stop_mm in stops_mm:
                self._travel(stop_mm, deadline)
            read_back_mm = self._settle(height_mm, deadline)
        except DeviceTimeoutError as error:
            raise DeviceTimeoutError(
                f"{self._device.name} did not settle at {height_mm:g} mm within {timeout_s:g} s: "
                f"{error}; {self._halt()}"
            ) from error
        except (DeviceProtocolError, DeviceResetError) as error:
            # After a reset the device takes moves from a position that is none.
            raise type(error)(f"{error}; {self._halt()}") from error
        finally:
            self._is_moving = False
        self._is_flank_taken = True
        self._keep_warnings(self._device.warnings())
        return read_back_mm

    def stop(self) -> None:
        """See `Stage.stop`; a stage that was homing has to be homed again."""
        self._is_stop_wanted = True
        self._is_flank_taken = self._is_homing = False
        self._device.ask("stop")
        deadline = self._clock() + STOP_TIMEOUT_S
        while self._device.ask("").is_busy:
            if self._clock() >= deadline:
                self._is_position_known = False
                self._device.ask("estop")
                raise DeviceTimeoutError(
                    f"{self._device.name} did not stop within {STOP_TIMEOUT_S:g} s and got an "
                    "emergency stop: home it again"
                )
            self._sleep(POLL_S)

    def emergency_stop(self) -> None:
        """See `Stage.emergency_stop`."""
        self._is_emergency = self._is_stop_wanted = True
        self._is_position_known = self._is_homing = False
        self._device.ask("estop")

    def clear_alarm(self) -> None:
        """See `Stage.clear_alarm`. After a fault the position is void: home next."""
        flags = self._device.warnings()
        if any(flag.startswith("F") for flag in flags):
            self._is_position_known = False
        if any(flag in DRIVER_OFF for flag in flags):
            self._device.ask("driver enable")
        self._device.ask("warnings clear")
        self._is_emergency = False

    def close(self) -> None:
        """See `Stage.close`."""
        self._device.close()

    def _travel(self, height_mm: float, deadline: float) -> None:
        """Move and wait there; a lost reply is made good once."""
        steps = self._scale.steps(height_mm)
        for is_last_try in (False, True):
            if self._must_stop():
                raise DeviceError(f"{self._device.name} was told to stop; nothing more was sent")
            lost: DeviceError | None = None
            try:
                reply = self._device.command(f"move abs {steps}")
                if not reply.is_ok:
                    raise self._refused(steps, reply.data)
                if self._must_stop():  # another thread said so just before the move
                    self._device.ask("stop")
                self._watch(reply.warning)
            except (DeviceTimeoutError, DeviceProtocolError) as error:
                # The stage may move or not: ask where it is before anything is sent again.
                lost = error
            self._wait_for_idle(deadline)
            at_mm = self._read_height_mm()
            if abs(at_mm - height_mm) <= self._config.tolerance_mm + 1e-6:
                return
            if lost is not None and is_last_try and not self._is_stop_wanted:
                raise lost
            if lost is None or self._is_stop_wanted:
                raise DeviceError(
                    f"{self._device.name} stopped at {at_mm:.3f} mm, not at {height_mm:.3f} mm"
                    + (", as it was told to" if self._is_stop_wanted else "; home it and try again")
                )

    def _must_stop(self) -> bool:
        return self._is_stop_wanted

    def _wait_for_idle(self, deadline: float) -> None:
        while True:
            reply = self._device.ask("")
            self._watch(reply.warning)
            if not reply.is_busy:
                return
            if self._clock() >= deadline:
                raise DeviceTimeoutError(f"it moves, now at {self._read_height_mm():.3f} mm")
            self._sleep(POLL_S)

    def _settle(self, height_mm: float, deadline: float) -> float:
        """Read back after the settling time, until two readings agree."""
        before_mm = self._read_height_mm()
        while True:
            self._sleep(self._config.settle_s)
            after_mm = self._read_height_mm()
            reply = self._device.ask("")
            self._watch(reply.warning)
            # An encoder trembles by a few counts.
            if not reply.is_busy and abs(after_mm - before_mm) <= self._config.tolerance_mm / 2:
                break
            before_mm = after_mm
            if self._clock() >= deadline:
                raise DeviceTimeoutError(f"it creeps, now at {after_mm:.3f} mm")
            self._sleep(POLL_S)
        if not abs(after_mm - height_mm) <= self._config.tolerance_mm + 1e-6:
            raise DeviceTimeoutError(f"it crept to {after_mm:.3f} mm")
        return after_mm

    def _read_height_mm(self) -> float:
        return self._scale.height_mm(self._device.number("pos"))

    def _watch(self, flag: str | None) -> None:
        """Raise what a reply's flag says about the position."""
        if flag is None:
            return
        if flag.startswith("F"):
            self._is_position_known = False
            raise self._alarm(flag)
        if flag in NO_REFERENCE and self._is_position_known:
            self._is_position_known = False
            raise DeviceResetError(
                f"{self._device.name} was reset or lost power meanwhile; its position is void: "
                "home it again"
            )

    def _refuse_faults(self) -> None:
        if self._is_emergency:
            raise self._alarm("emergency")
        for flag in self._device.warnings():
            self._watch(flag)

    def _alarm(self, flag: str) -> StageAlarmError:
        text = WARNING_TEXTS.get(flag, "emergency stop")
        return StageAlarmError(
            f"{self._device.name} is in alarm: {flag} ({text}); clear the alarm, then home",
            code=flag,
        )

    def _refused(self, steps: int, reason: str) -> DeviceError:
        if reason == "BADDATA":
            return StageLimitError(
                f"{self._device.name} refuses {steps} microsteps as out of range; limits_mm, "
                "microstep_um or home_offset_mm in the bench file do not fit it. Nothing moved"
            )
        return DeviceError(f"{self._device.name} refuses to move: {reason}; nothing moved")

    def _halt(self) -> str:
        """Stop after a failure, and say what came of it."""
        try:
            self.stop()
            where_mm = self._read_height_mm()
        except DeviceError as error:
            return f"stopping it failed: {error}"
        return f"it was stopped at {where_mm:.3f} mm" if self.is_homed else "it was stopped"

    def _keep_warnings(self, flags: tuple[str, ...]) -> None:
        self.warnings = tuple(
            f"{flag}: {WARNING_TEXTS.get(flag, 'see the protocol manual')}"
            for flag in flags
            if flag not in NO_REFERENCE
        )


def open_zaber_stage(
    config: StageConfig, *, first: Literal["nothing", "stop"] = "nothing"
) -> ZaberStage:
    """Open the port of a bench file and begin the dialogue; moves nothing.

    Parameters
    ----------
    config
        The stage's section.
    first
        ``stop`` ends a move that another program left running before anything else is asked.

    Raises
    ------
    DeviceError
        If the port cannot be opened or the device is not as expected.
    """
    link = open_stage_link(config, name="the Zaber stage")
    stage = ZaberStage(config, link, clock=monotonic, sleep=sleep)
    try:
        if first == "stop":
            stage.stop()
        stage.connect()
    except BaseException:
        stage.close()
        raise
    return stage
