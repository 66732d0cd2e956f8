"""A stage by hand: one that a person moves and reads, and one action of any stage."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any, Self

from acquisition.bench import StageConfig
from acquisition.choices import StageAction
from acquisition.devices import DeviceInfo, Stage, StageState
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    StageAlarmError,
    StageNotHomedError,
)
from acquisition.stages._motor import (
    MotorStage,
    home_timeout_s,
    move_timeout_s,
    refuse_beyond_limits,
)

_TRIES = 5


class ManualStage:
    """Asks the operator to set each height and to state the reading of the scale.

    It is homed once a height has been stated; an empty answer confirms the requested height.
    """

    def __init__(self, config: StageConfig, *, ask: Callable[[str], str]) -> None:
        self._config = config
        self._ask = ask
        self._height_mm: float | None = None
        self._is_emergency = False
        self._is_open = True

    @property
    def info(self) -> DeviceInfo:
        """See `Stage.info`."""
        return DeviceInfo(
            vendor="", model="set by hand", serial_number="", firmware="", driver="manual"
        )

    @property
    def limits_mm(self) -> tuple[float, float]:
        """See `Stage.limits_mm`."""
        return self._config.limits_mm

    @property
    def is_homed(self) -> bool:
        """See `Stage.is_homed`."""
        return self._height_mm is not None

    @property
    def state(self) -> StageState:
        """See `Stage.state`."""
        return "alarm" if self._is_emergency else "idle"

    def home(self, timeout_s: float) -> None:
        """See `Stage.home`: asks for the reading of the scale."""
        self._check_ready()
        self._height_mm = None
        low_mm, high_mm = self.limits_mm
        question = "Height shown on the scale, in mm"
        for _ in range(_TRIES):
            height_mm = _number(self._ask(question))
            if height_mm is not None and low_mm <= height_mm <= high_mm:
                self._height_mm = height_mm
                return
            question = f"Enter a height from {low_mm:g} to {high_mm:g} mm"
        raise DeviceError("the operator did not state the stage's height; nothing was captured")

    def move_to(self, height_mm: float, timeout_s: float) -> float:
        """See `Stage.move_to`: asks for the move; returns the height that the operator reads."""
        refuse_beyond_limits(height_mm, self.limits_mm)
        self._check_ready()
        if self._height_mm is None:
            raise StageNotHomedError(
                "the height of the stage is not known: home it before it moves"
            )
        self._height_mm = None
        side = "below" if self._config.approach == "from_below" else "above"
        wish = (
            f"Set the stage to {height_mm:.3f} mm, coming from {side}. "
            "Press Enter once it is there, or type the height it shows"
        )
        question = wish
        for _ in range(_TRIES):
            answer = self._ask(question)
            shown_mm = _number(answer) if answer.strip() else height_mm
            if shown_mm is None:
                question = f"{answer.strip()!r} is not a height in mm. {wish}"
                continue
            off_mm = shown_mm - height_mm
            if abs(off_mm) <= self._config.tolerance_mm + 1e-6:
                self._height_mm = shown_mm
                return shown_mm
            question = f"That is {off_mm:+.3f} mm off. {wish}"
        raise DeviceError(
            f"the stage was not set to {height_mm:g} mm within {self._config.tolerance_mm:g} mm; "
            "state its height again, or raise stage.tolerance_mm"
        )

    def position_mm(self) -> float:
        """See `Stage.position_mm`: the height that the operator last stated."""
        if not self._is_open:
            raise DeviceDisconnectedError("the manual stage is closed")
        if self._height_mm is None:
            raise StageNotHomedError("the height of the stage has not been stated: home it")
        return self._height_mm

    def stop(self) -> None:
        """See `Stage.stop`: a person has already stopped."""

    def emergency_stop(self) -> None:
        """See `Stage.emergency_stop`."""
        self._height_mm = None
        self._is_emergency = True

    def clear_alarm(self) -> None:
        """See `Stage.clear_alarm`."""
        self._is_emergency = False

    def close(self) -> None:
        """See `Stage.close`."""
        self._is_open = False

    def _check_ready(self) -> None:
        if not self._is_open:
            raise DeviceDisconnectedError("the manual stage is closed")
        if self._is_emergency:
            raise StageAlarmError("the stage was stopped in an emergency; clear the alarm first")


def _number(text: str) -> float | None:
    """Read a height, with a point or a decimal comma, with or without its unit."""
    try:
        value = float(text.strip().removesuffix("mm").strip().replace(",", "."))
    except ValueError:
        return None
    return value if isfinite(value) else None


_WITHOUT_ANSWER = dict.fromkeys(("vendor", "model", "serial_number", "firmware"), "")


@dataclass(frozen=True, slots=True, kw_only=True)
class StageReport:
    """The stage after an action; ``state`` is ``unknown`` if it stopped and then told no more."""

    action: StageAction
    state: str
    position_mm: float | None
    is_homed: bool
    limits_mm: tuple[float, float]
    info: dict[str, str]
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(cls, stage: Stage, action: StageAction) -> Self:
        """Ask an open stage."""
        state = stage.state
        try:
            position_mm = stage.position_mm()
        except StageNotHomedError:
            position_mm = None
        return cls(
            action=action,
            state=state,
            position_mm=position_mm,
            is_homed=stage.is_homed,
            limits_mm=stage.limits_mm,
            info=asdict(stage.info),
            warnings=tuple(stage.warnings) if isinstance(stage, MotorStage) else (),
        )

    @classmethod
    def without_answer(cls, config: StageConfig, error: str) -> Self:
        """The report of a stage that has stopped and then told nothing more."""
        return cls(
            action="stop",
            state="unknown",
            position_mm=None,
            is_homed=False,
            limits_mm=config.limits_mm,
            info={**_WITHOUT_ANSWER, "driver": config.driver},
            warnings=(error,),
        )

    def to_json(self) -> dict[str, Any]:
        """Return the report as ``standoff stage --json`` prints it."""
        return {
            "action": self.action,
            "stopped": True if self.action == "stop" else None,
            "state": self.state,
            "position_mm": self.position_mm,
            "is_homed": self.is_homed,
            "limits_mm": list(self.limits_mm),
            "info": self.info,
            "warnings": list(self.warnings),
        }


def act_on_stage(
    stage: Stage,
    config: StageConfig,
    action: StageAction,
    height_mm: float | None = None,
    *,
    homes_first: bool = False,
) -> None:
    """Home, move or unlock an open stage; it was stopped when it was opened."""
    if action == "home" or (homes_first and not stage.is_homed):
        stage.home(home_timeout_s(config, stage))
    if height_mm is not None:
        try:
            stage.move_to(height_mm, move_timeout_s(config))
        except StageNotHomedError as error:
            raise StageNotHomedError(f"{error}; run `standoff stage home` or add --home") from error
    elif action == "unlock":
        stage.clear_alarm()
