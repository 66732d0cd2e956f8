"""One action of a stage by hand, and what the stage is like after it."""

from dataclasses import asdict, dataclass
from typing import Any, Self

from acquisition.bench import StageConfig
from acquisition.choices import StageAction
from acquisition.devices import Stage
from acquisition.errors import StageNotHomedError
from acquisition.stages.motor import MotorStage
from acquisition.stages.travel import home_timeout_s, move_timeout_s

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
        """Ask an open stage.

        Raises
        ------
        DeviceError
            If it does not answer.
        """
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
    """Home, move or unlock an open stage; it was stopped when it was opened.

    Raises
    ------
    StageNotHomedError
        If it does not know its height, and is not to home first.
    DeviceError
        If it does not do what it is told.
    """
    if action == "home" or (homes_first and not stage.is_homed):
        stage.home(home_timeout_s(config, stage))
    if height_mm is not None:
        try:
            stage.move_to(height_mm, move_timeout_s(config))
        except StageNotHomedError as error:
            raise StageNotHomedError(f"{error}; run `standoff stage home` or add --home") from error
    elif action == "unlock":
        stage.clear_alarm()
