"""One axis of a Zaber device as a stage."""

from collections.abc import Callable
from threading import Event
from time import monotonic, sleep
from typing import Literal

from acquisition.bench import StageConfig
from acquisition.devices import DeviceInfo, StageState
from acquisition.errors import (
    DeviceError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceResetError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
)
from acquisition.stages.axis import POLL_S, AxisReading, AxisTraits
from acquisition.stages.motor import MotorStage
from acquisition.stages.progress import ProgressWatch, smallest_progress_mm
from acquisition.stages.serial_link import open_stage_link
from acquisition.stages.zaber.device import ZaberDevice, ZaberScale
from acquisition.stages.zaber.wire import WARNING_TEXTS, ZaberReply

NO_REFERENCE = ("WR", "WH")
DRIVER_OFF = ("FD", "FO", "FH")


class ZaberAxis:
    """A `MotorAxis` that moves to absolute positions in microsteps.

    A height is the position times ``microstep_um``, counted upwards, plus
    ``home_offset_mm``. `connect` begins the dialogue; the constructor sends nothing.

    Parameters
    ----------
    config
        Microstep, offset, limits, feed, tolerance.
    device
        One axis of the device, on an open link.
    clock, sleep
        Time in seconds, and a function that waits.

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
        device: ZaberDevice,
        *,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self.is_position_known = False
        self.warnings: tuple[str, ...] = ()
        self.traits = AxisTraits(
            # An encoder jitters by a few counts.
            repeat_mm=config.tolerance_mm / 2,
            is_homing_cancellable=True,
            # After a reset the device accepts moves from a meaningless position.
            may_move_after=(DeviceTimeoutError, DeviceProtocolError, DeviceResetError),
        )
        self._config = config
        self._device = device
        self._clock = clock
        self._sleep = sleep
        self._scale = ZaberScale.of(config)
        self._info = DeviceInfo(vendor="", model="", serial_number="", firmware="", driver="zaber")

    def connect(self) -> None:
        """Read its identity, compare its settings and set its speed; moves nothing.

        Without the warnings ``WR`` and ``WH`` the device claims to know its position; that is
        trusted.

        Raises
        ------
        DeviceError
            If it does not answer, is not a Zaber device, or does not have the expected settings.
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
        self.is_position_known = self._has_reference()

    @property
    def name(self) -> str:
        """Its name in error messages."""
        return self._device.name

    @property
    def info(self) -> DeviceInfo:
        """See `Stage.info`."""
        return self._info

    @property
    def homing_s(self) -> float:
        """See `HomingStage`; not asked for."""
        return 0.0

    def state(self) -> StageState:
        """See `MotorAxis.state`."""
        reply = self._device.ask("")
        if (reply.warning or "").startswith("F"):
            return "alarm"
        return "moving" if reply.is_busy else "idle"

    def known_height_mm(self) -> float | None:
        """See `MotorAxis.known_height_mm`."""
        self._is_busy()
        return self.height_mm() if self.is_position_known else None

    def travel_height_mm(self) -> float | None:
        """See `TravellingStage`; messages have ids, so that a query disturbs no move."""
        return self.height_mm()

    def ready_height_mm(self) -> float:
        """See `MotorAxis.ready_height_mm`."""
        self._refuse_faults()
        if not self.is_position_known:
            raise StageNotHomedError(f"{self.name} must be homed before it moves")
        if self._is_busy():
            raise DeviceError(f"{self.name} is moving; stop it or wait")
        return self.height_mm()

    def start_move(self, height_mm: float) -> None:
        """See `MotorAxis.start_move`."""
        steps = self._scale.steps(height_mm)
        reply = self._device.command(f"move abs {steps}")
        if reply.is_ok:
            self._watch(reply.warning)
        elif reply.data == "BADDATA":
            raise StageLimitError(
                f"{self.name} refuses {steps} microsteps as out of range; nothing moved. "
                "limits_mm, microstep_um or home_offset_mm in the bench file does not match the "
                "device",
                height_mm=height_mm,
                limits_mm=None,
            )
        else:
            raise DeviceRefusalError(
                f"{self.name} refuses to move: {reply.data}; nothing moved", code=reply.data
            )

    def wait_until_still(self, height_mm: float, deadline: float) -> float:
        """See `MotorAxis.wait_until_still`; a stalled move is reported with its warning flags."""
        progress = ProgressWatch(
            clock=self._clock, least_mm=smallest_progress_mm(self._config, self.traits)
        )
        while (reply := self._checked()).is_busy:
            at_mm = self.height_mm()
            state = f"BUSY {reply.warning or '--'}"
            progress.see(abs(at_mm - height_mm), state=state, height_mm=at_mm)
            self._pause(at_mm, deadline)
        return self.height_mm()

    def height_mm(self) -> float:
        """See `MotorAxis.height_mm`."""
        return self._scale.height_mm(self._device.number("pos"))

    def reading(self) -> AxisReading:
        """See `MotorAxis.reading`."""
        height_mm, is_moving = self.height_mm(), self._is_busy()
        return AxisReading(
            height_mm=height_mm, is_moving=is_moving, state="BUSY" if is_moving else "IDLE"
        )

    def is_moving(self) -> bool:
        """See `MotorAxis.is_moving`."""
        return self._device.ask("").is_busy

    def cancel(self) -> None:
        """See `MotorAxis.cancel`."""
        self._device.ask("stop")

    def interrupt(self) -> None:
        """See `MotorAxis.interrupt`."""
        self.is_position_known = False
        self._device.ask("estop")

    def abort(self) -> None:
        """See `MotorAxis.abort`."""
        self.interrupt()

    def prepare_homing(self) -> None:
        """See `MotorAxis.prepare_homing`."""
        self._refuse_faults()
        self._device.check_settings(self._config.expected_settings)

    def check_reference(self, deadline: float, stop: Event) -> None:
        """See `MotorAxis.check_reference`; the device detects a stall by itself."""

    def find_reference(self, deadline: float) -> None:
        """See `MotorAxis.find_reference`."""
        reply = self._device.command("home")
        if not reply.is_ok:
            raise self._device.rejected("home", reply)
        self._wait_until_idle(deadline)
        if not self._has_reference():
            raise DeviceError(f"{self.name} found no reference; home it again")

    def refresh_warnings(self) -> None:
        """See `MotorAxis.refresh_warnings`."""
        self._has_reference()

    def clear_alarm(self) -> None:
        """See `MotorAxis.clear_alarm`. After a fault the position is lost: home next."""
        flags = self._device.warnings()
        if any(flag.startswith("F") for flag in flags):
            self.is_position_known = False
        if any(flag in DRIVER_OFF for flag in flags):
            self._device.ask("driver enable")
        self._device.ask("warnings clear")

    def close(self) -> None:
        """See `MotorAxis.close`."""
        self._device.close()

    def _wait_until_idle(self, deadline: float) -> None:
        while self._is_busy():
            self._pause(self.height_mm(), deadline)

    def _pause(self, at_mm: float, deadline: float) -> None:
        if self._clock() >= deadline:
            raise DeviceTimeoutError(f"it is moving, now at {at_mm:.3f} mm")
        self._sleep(POLL_S)

    def _is_busy(self) -> bool:
        """As `is_moving`, but faults and resets are checked."""
        return self._checked().is_busy

    def _checked(self) -> ZaberReply:
        """Ask what it is doing; a fault or a reset is an error."""
        reply = self._device.ask("")
        self._watch(reply.warning)
        return reply

    def _has_reference(self) -> bool:
        """Whether no flag denies it; the other flags become `warnings`."""
        flags = self._device.warnings()
        self.warnings = tuple(
            f"{flag}: {WARNING_TEXTS.get(flag, 'see the protocol manual')}"
            for flag in flags
            if flag not in NO_REFERENCE
        )
        return not any(flag in NO_REFERENCE for flag in flags)

    def _watch(self, flag: str | None) -> None:
        """Raise the error that a reply's flag implies."""
        if flag is None:
            return
        if flag.startswith("F"):
            self.is_position_known = False
            text = WARNING_TEXTS.get(flag, "see the protocol manual")
            raise StageAlarmError(
                f"{self.name} is in alarm: {flag} ({text}); clear the alarm, then home", code=flag
            )
        if flag in NO_REFERENCE and self.is_position_known:
            self.is_position_known = False
            raise DeviceResetError(
                f"{self.name} was reset or lost power; its position is no longer known: "
                "home it again"
            )

    def _refuse_faults(self) -> None:
        for flag in self._device.warnings():
            self._watch(flag)


def open_zaber_stage(
    config: StageConfig,
    *,
    first: Literal["nothing", "stop"] = "nothing",
    stopped: Callable[[], None] = lambda: None,
) -> MotorStage:
    """Open the port of a bench file and begin the dialogue; moves nothing.

    Parameters
    ----------
    config
        The ``[stage]`` section.
    first
        ``stop`` ends a move that another program left running before anything else is sent.
    stopped
        Called once the stage stands, after ``stop``; what comes then may still fail.

    Raises
    ------
    StageNotStoppedError
        If it was told to stop first, and nothing says that it did.
    DeviceError
        If the port cannot be opened or the device is not as expected.
    """
    link = open_stage_link(config, name="the Zaber stage")
    device = ZaberDevice(
        link, device=config.device_address, axis=config.axis_number, clock=monotonic
    )
    axis = ZaberAxis(config, device, clock=monotonic, sleep=sleep)
    stage = MotorStage(config, axis, clock=monotonic, sleep=sleep)
    try:
        if first == "stop":
            stage.stop_first()
            stopped()
        axis.connect()
    except BaseException:
        stage.close()
        raise
    return stage
