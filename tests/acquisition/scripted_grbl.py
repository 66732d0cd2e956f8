"""A Grbl controller that answers by script or creeps to where it is sent, and its time."""

import re
from collections.abc import Callable, Iterable
from itertools import chain, repeat
from typing import Any, cast

from acquisition.bench import StageConfig
from acquisition.stages._grbl import _GrblAxis
from acquisition.stages.grbl_controller import GrblController
from acquisition.stages.grbl_wire import JOG_CANCEL, Alarm, ErrorReply, StatusReport

CONFIG = StageConfig.model_validate(
    {
        "driver": "grbl",
        "port": "virtual",
        "limits_mm": [0.0, 300.0],
        "settle_s": 0.5,
        "tolerance_mm": 0.01,
        "home_offset_mm": 20.0,
    }
)
"""Height 20 mm where the controller reads 0."""


def at(z_mm: float, state: str = "Idle") -> StatusReport:
    return StatusReport(state=state, machine=(1.0, 2.0, z_mm))


class Answer:
    def __init__(self, code: int | None = None) -> None:
        self.error = None if code is None else ErrorReply(code)


class ScriptedController:
    """Gives its reports in turn, the last one for ever; takes jogs, or fails as planned."""

    name = "grbl on virtual"

    def __init__(
        self, reports: Iterable[StatusReport], jogs: Iterable[Answer | Exception] = ()
    ) -> None:
        known = list(reports)
        self._reports = chain(known, repeat(known[-1]))
        self._jogs = chain(jogs, repeat(Answer()))
        self.offset: tuple[float, ...] | None = None
        self.alarm: Alarm | None = None
        self.is_position_known = True
        self.lost_steps = 0
        self.sent: list[Any] = []
        self.reset_error: Exception | None = None

    def status(self) -> StatusReport:
        return next(self._reports)

    def command(self, line: Any) -> Answer:
        self.sent.append(line)
        answer = next(self._jogs)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def send_realtime(self, byte: Any) -> None:
        self.sent.append(byte)

    def lose_step(self) -> None:
        self.lost_steps += 1

    def reset(self) -> None:
        self.sent.append("reset")
        if self.reset_error is not None:
            raise self.reset_error


class Time:
    def __init__(self) -> None:
        self.now_s = 0.0

    def clock(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s


class CreepingController(ScriptedController):
    """Goes 0.02 mm nearer to its target with every report; ``pressed`` says where the switch is."""

    def __init__(self, z_mm: float, pressed: Callable[[float], bool]) -> None:
        super().__init__([at(z_mm)])
        self.z_mm = self._target_mm = z_mm
        self.pressed = pressed
        self.refuse_with: Answer | None = None

    def command(self, line: Any) -> Answer:
        if self.refuse_with is not None:
            return self.refuse_with
        answer = super().command(line)
        found = re.search(r"Z(-?[0-9.]+)", line)
        assert found is not None
        self._target_mm = float(found.group(1))
        return answer

    def send_realtime(self, byte: Any) -> None:
        super().send_realtime(byte)
        if byte == JOG_CANCEL:
            self._target_mm = self.z_mm

    def status(self) -> StatusReport:
        away_mm = self._target_mm - self.z_mm
        self.z_mm = round(self.z_mm + max(min(away_mm, 0.02), -0.02), 6)
        return StatusReport(
            state="Idle" if away_mm == 0 else "Jog",
            machine=(1.0, 2.0, self.z_mm),
            pins="Z" if self.pressed(self.z_mm) else "",
        )


def axis_of(controller: ScriptedController, time: Time | None = None) -> _GrblAxis:
    time = time or Time()
    return _GrblAxis(CONFIG, cast("GrblController", controller), clock=time.clock, sleep=time.sleep)
