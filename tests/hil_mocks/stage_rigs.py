"""Real drivers over simulated controllers, in a time that passes only while somebody waits."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from acquisition.bench import StageConfig
from acquisition.stages._control import ManualStage
from acquisition.stages._grbl import _GrblAxis
from acquisition.stages._motor import MotorStage
from acquisition.stages._serial_link import SerialLink, _WireLog
from acquisition.stages.grbl_controller import GrblController
from acquisition.stages.zaber import _ZaberAxis, _ZaberDevice
from hil_mocks import SimulatedClock
from hil_mocks.stages._grbl import GrblFaults, GrblFirmware
from hil_mocks.stages._grbl_protocol import GrblDialect
from hil_mocks.stages._plant import StagePlant
from hil_mocks.stages._serial_stage import SerialLine
from hil_mocks.stages._zaber import ZaberFaults, ZaberFirmware
from tests.hil_mocks.virtual_port import VirtualPort

MICROSTEP_UM = 0.49609375

STAGE_KEYS: dict[str, Any] = {
    "limits_mm": [10.0, 400.0],
    "feed_mm_per_min": 1200.0,
    "settle_s": 0.5,
    "port": "virtual",
}


class EventClock(SimulatedClock):
    """Lets things happen at planned times."""

    def __init__(self) -> None:
        super().__init__()
        self._events: list[tuple[float, Callable[[], object]]] = []

    def at(self, in_s: float, event: Callable[[], object]) -> None:
        self._events.append((self.now_s + in_s, event))
        self._events.sort(key=lambda planned: planned[0])

    def advance(self, duration_s: float) -> None:
        end_s = self.now_s + duration_s
        while self._events and self._events[0][0] <= end_s:
            when_s, event = self._events.pop(0)
            super().advance(max(when_s - self.now_s, 0.0))
            event()
        super().advance(max(end_s - self.now_s, 0.0))


@dataclass(kw_only=True)
class StageRig:
    """A stage with its driver, its controller, its mechanics and the cable between."""

    config: StageConfig
    plant: StagePlant
    line: SerialLine
    clock: EventClock = field(default_factory=EventClock)
    log: _WireLog | None = None
    round_mm: float = 0.005
    """How well the position is known after a homing: to a step and what the switch adds."""
    stage: MotorStage = field(init=False)

    def __post_init__(self) -> None:
        self.reopened()

    @property
    def sent(self) -> list[str]:
        """The commands that reached the controller."""
        raise NotImplementedError

    def fail(self, **faults: Any) -> None:
        """Put the controller at fault; none heals it."""
        raise NotImplementedError

    def reopened(self) -> MotorStage:
        """The stage on a port that another process has just opened; nothing was sent yet."""
        raise NotImplementedError

    def link(self) -> SerialLink:
        port = VirtualPort(self.line, clock=self.clock)
        return SerialLink(port, name="the stage", clock=self.now_s, log=self.log)

    def moved_by(self, axis: _GrblAxis | _ZaberAxis) -> MotorStage:
        self.stage = MotorStage(self.config, axis, clock=self.now_s, sleep=self.clock.advance)
        return self.stage

    def now_s(self) -> float:
        return self.clock.now_s

    def in_mid_move(self, event: Callable[[], object], in_s: float = 2.0) -> None:
        """Plan something for a moment when the stage moves."""

        def happen() -> None:
            self.line.pass_time(self.clock.now_s)
            event()

        self.clock.at(in_s, happen)

    def wait(self, seconds: float) -> None:
        self.clock.advance(seconds)
        self.line.pass_time(self.clock.now_s)


@dataclass(kw_only=True)
class GrblRig(StageRig):
    firmware: GrblFirmware
    axis: _GrblAxis = field(init=False)

    @property
    def sent(self) -> list[str]:
        return self.firmware.lines_received

    def fail(self, **faults: Any) -> None:
        self.firmware.faults = GrblFaults(**faults)

    def reopened(self) -> MotorStage:
        controller = GrblController(self.link(), clock=self.now_s)
        self.axis = _GrblAxis(self.config, controller, clock=self.now_s, sleep=self.clock.advance)
        return self.moved_by(self.axis)

    def reopen(self, *, reset: bool = False) -> MotorStage:
        """A new connection, as another process would make it."""
        self.reopened()
        self.axis.connect(reset=reset)
        return self.stage


@dataclass(kw_only=True)
class ZaberRig(StageRig):
    firmware: ZaberFirmware
    axis: _ZaberAxis = field(init=False)
    round_mm: float = 0.006  # a step of homing at 1 mm/s and a microstep

    @property
    def sent(self) -> list[str]:
        return self.firmware.commands_received

    def fail(self, **faults: Any) -> None:
        self.firmware.faults = ZaberFaults(**faults)

    def reopened(self) -> MotorStage:
        device = _ZaberDevice(
            self.link(),
            device=self.config.device_address,
            axis=self.config.axis_number,
            clock=self.now_s,
        )
        self.axis = _ZaberAxis(self.config, device, clock=self.now_s, sleep=self.clock.advance)
        return self.moved_by(self.axis)

    def reopen(self) -> MotorStage:
        """A new connection, as another process would make it."""
        self.reopened()
        self.axis.connect()
        return self.stage


def grbl_rig(
    dialect: GrblDialect = "grbl",
    *,
    settings: dict[int, float] | None = None,
    work_offset_mm: float = 0.0,
    axes: str = "XYZ",
    boots: bool = True,
    connect: bool = True,
    high_switch_mm: float = 409.5,
    log: _WireLog | None = None,
    **keys: object,
) -> GrblRig:
    """A stage with 400 mm of travel, homing to its lower switch unless ``settings`` say else."""
    plant = StagePlant(low_switch_mm=high_switch_mm - 400, high_switch_mm=high_switch_mm)
    firmware = GrblFirmware(
        plant, dialect=dialect, settings=settings, work_offset_mm=work_offset_mm, axes=axes
    )
    if boots:
        firmware.power_cycle()
    config = _config("grbl", {"home_offset_mm": high_switch_mm, **keys})
    line = SerialLine(firmware)
    rig = GrblRig(config=config, plant=plant, line=line, firmware=firmware, log=log)
    if connect:
        rig.axis.connect()
    return rig


def homed_grbl(dialect: GrblDialect = "grbl", **keys: Any) -> GrblRig:
    rig = grbl_rig(dialect, **keys)
    rig.stage.home(120)
    return rig


def zaber_rig(*, connect: bool = True, **keys: object) -> ZaberRig:
    plant = StagePlant(low_switch_mm=10.0, high_switch_mm=410.0)
    firmware = ZaberFirmware(plant, microstep_um=MICROSTEP_UM)
    config = _config("zaber", {"microstep_um": MICROSTEP_UM, "home_offset_mm": 10.0, **keys})
    rig = ZaberRig(config=config, plant=plant, line=SerialLine(firmware), firmware=firmware)
    if connect:
        rig.axis.connect()
    return rig


def homed_zaber(**keys: Any) -> ZaberRig:
    rig = zaber_rig(**keys)
    rig.stage.home(120)
    return rig


def _config(driver: str, keys: dict[str, object]) -> StageConfig:
    return StageConfig.model_validate({**STAGE_KEYS, "driver": driver, **keys})


class Operator:
    """Sets what is asked for and confirms it; ``answers`` come first."""

    def __init__(self, *answers: str) -> None:
        self.answers = list(answers)
        self.questions: list[str] = []

    def __call__(self, question: str) -> str:
        self.questions.append(question)
        if self.answers:
            return self.answers.pop(0)
        return "150" if question.startswith("Height") else ""


def manual_stage(*answers: str, **keys: object) -> tuple[ManualStage, Operator]:
    operator = Operator(*answers)
    return ManualStage(_config("manual", keys), ask=operator), operator
