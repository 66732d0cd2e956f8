"""Executes the commands of whoever is in control; anybody may stop."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from acquisition.devices import Stage
from acquisition.plan import CapturePlan
from acquisition.stages import home_timeout_s, move_timeout_s, refuse_beyond_limits
from standoff.console.bench_hub import BenchHub
from standoff.console.jobs import BusyError, Job, rows_of
from standoff.console.web import messages
from standoff.console.web.measure_commands import measure_commands, require_devices
from standoff.console.web.picture_commands import picture_commands
from standoff.console.web.plan_commands import PlanCommands
from standoff.console.web.pose import pose_commands
from standoff.console.web.session_commands import SessionCommands
from standoff.errors import ApplicationError
from standoff.library import PlannedComparisons, login_name, make_folder

WITHOUT_CONTROL = (messages.Preview, messages.CheckPlan, messages.Probe, messages.Profile)
"""Messages that change nothing: those who watch may send them, too."""


class NotInControlError(ApplicationError):
    """Somebody else is in control; nothing was done."""


class CommandHandler:
    """Executes the messages of a page, one after the other.

    Parameters
    ----------
    hub
        The bench.
    """

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub
        self._commands: dict[type[Any], Callable[[Any], dict[str, Any] | None]] = {
            **picture_commands(hub),
            **measure_commands(hub),
            messages.Home: self._home,
            messages.Move: self._move,
            messages.Unlock: self._unlock,
            messages.Run: self._run,
            messages.Resume: self._resume,
            messages.Pause: lambda _: hub.run.pause(),
            messages.GoOn: lambda _: hub.run.go_on(),
            messages.TargetMoved: lambda _: hub.run.target_moved(),
            messages.Retake: self._retake,
            messages.Answer: self._answer,
            **pose_commands(hub),
            **PlanCommands(hub).by_message(),
            **SessionCommands(hub).by_message(),
        }

    def carry_out(self, viewer: str, message: messages.Message) -> dict[str, Any] | None:
        """Execute a message; return what to send to that page alone, if anything.

        Raises
        ------
        NotInControlError
            If somebody else is in control.
        ApplicationError, DeviceError, SessionError
            If it cannot be executed; the error says why.
        """
        match message:
            case messages.Stop():
                self._hub.stop()
                return None
            case messages.TakeControl():
                self._hub.control.join(viewer, message.name.strip() or login_name())
                self._hub.control.take(viewer)
                return None
            case messages.Release():
                self._hub.control.release(viewer)
                return None
            case messages.Grant():
                self._hub.control.grant(viewer)
                return None
            case messages.Refuse():
                self._hub.control.refuse(viewer)
                return None
        if not isinstance(message, WITHOUT_CONTROL) and not self._hub.control.is_holder(viewer):
            raise NotInControlError("You are not in control: take control first.")
        command = self._commands.get(type(message))
        return None if command is None else command(message)

    def _home(self, _: messages.Home) -> None:
        config = self._hub.bench.stage
        self._stage_job("homing the stage", lambda stage: stage.home(home_timeout_s(config, stage)))

    def _move(self, message: messages.Move) -> None:
        height_mm = message.height_mm
        if message.is_relative:
            now_mm = self._hub.stage.view.height_mm
            if now_mm is None:
                raise ApplicationError("The stage does not know its height; home it first.")
            height_mm = round(now_mm + height_mm, 3)
        refuse_beyond_limits(height_mm, self._hub.bench.stage.limits_mm)
        timeout_s = move_timeout_s(self._hub.bench.stage)
        self._stage_job(
            f"moving the stage to {height_mm:g} mm",
            lambda stage: stage.move_to(height_mm, timeout_s),
        )

    def _unlock(self, _: messages.Unlock) -> None:
        self._stage_job("clearing the alarm", lambda stage: stage.clear_alarm())

    def _stage_job(self, name: str, act: Callable[[Stage], object]) -> None:
        def work(job: Job) -> None:
            act(self._hub.stage.lent(job.check))

        self._hub.jobs.begin(name, work)

    def _run(self, message: messages.Run) -> None:
        plan = self._hub.plans.load(message.plan)
        path = self._hub.sessions.path_for(message.session)
        if path.exists():
            raise ApplicationError(
                f"There is already a session {message.session!r}: resume it, or choose another name"
            )
        self._begin(path, plan, ())

    def _resume(self, message: messages.Resume) -> None:
        session = self._hub.sessions.open(message.session)
        self._begin(session.path, session.plan, ())

    def _retake(self, message: messages.Retake) -> None:
        running = self._hub.jobs.current is not None
        if running and self._hub.run.view.session == message.session:
            self._hub.run.retake(message.index)
            return
        session = self._hub.sessions.open(message.session)
        self._begin(session.path, session.plan, (message.index,))

    def _begin(self, path: Path, plan: CapturePlan, retake: tuple[int, ...]) -> None:
        hub = self._hub
        require_devices(hub)
        rows_of(path, plan)
        if hub.jobs.current is not None:
            raise BusyError(hub.jobs.current.name)
        make_folder(hub.sessions.folder)
        operator = hub.operator
        comparisons = self._comparisons(path, plan)

        def work(job: Job) -> None:
            hub.run.work(job, path, plan, operator, retake)
            for sentence in comparisons.write():
                hub.tell(sentence)

        hub.run.prepare(path, plan, comparisons.pose_sentence)
        hub.jobs.begin(f"session {path.name}", work)

    def _comparisons(self, path: Path, plan: CapturePlan) -> PlannedComparisons:
        """Read the earlier photographs that the plan names, if it names any."""
        if all(target.reference is None for target in plan.targets):
            return PlannedComparisons(session=path)
        folder = self._hub.plans.folder_of(plan)
        if folder is None:
            self._hub.tell(
                f"The plan {plan.name!r} is in no folder of plans any more: its captures are not "
                "compared with the photographs that it names."
            )
            return PlannedComparisons(session=path)
        return PlannedComparisons.of(plan, folder, path)

    def _answer(self, message: messages.Answer) -> None:
        if not self._hub.prompts.answer(message.number, message.choice, message.text):
            raise ApplicationError("That question has already been answered.")
