"""Executes the commands of whoever is in control; anybody may stop."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from pydantic import Field

from acquisition.capture import flicker_warnings
from acquisition.devices import Stage
from acquisition.plan import CapturePlan, estimate_plan, plan_entries
from acquisition.stages import home_timeout_s, move_timeout_s, refuse_beyond_limits
from standoff.console.bench_hub import BenchHub
from standoff.console.jobs import BusyError, Job
from standoff.console.plans import DraftError, PlanDraft, plan_of
from standoff.console.session_run import rows_of
from standoff.console.web._messages import (
    Finite,
    Index,
    MessageReader,
    Name,
    command,
    commands_of,
)
from standoff.console.web._picture_commands import PictureCommands
from standoff.console.web._session_commands import SessionCommands, used_record
from standoff.console.web._view_model import Document, preview_document
from standoff.errors import ApplicationError
from standoff.library import PlannedComparisons, make_folder

MOST_DPRIME = 1000.0
"""Two photographs differ by no such d' in any pixel that is not saturated."""


class CommandHandler(PictureCommands, SessionCommands):
    """Executes the messages of the pages of a bench, one after the other."""

    _hub: BenchHub

    def __init__(self, hub: BenchHub) -> None:
        super().__init__(hub)

    @command("home")
    def _home(self) -> None:
        """Home the stage."""
        config = self._hub.bench.stage
        self._stage_job("homing the stage", lambda stage: stage.home(home_timeout_s(config, stage)))

    @command("move")
    def _move(self, height_mm: Finite, is_relative: bool = False) -> None:
        """Move the stage to a height, or by a distance."""
        if is_relative:
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

    @command("unlock")
    def _unlock(self) -> None:
        """Clear the stage's alarm."""
        self._stage_job("clearing the alarm", lambda stage: stage.clear_alarm())

    def _stage_job(self, name: str, act: Callable[[Stage], object]) -> None:
        def work(job: Job) -> None:
            act(self._hub.stage.lent(job.check))

        self._hub.jobs.begin(name, work)

    @command("run")
    def _run(self, plan: Name, session: Name) -> None:
        """Run a plan as a new session."""
        loaded = self._hub.plans.load(plan)
        path = self._hub.sessions.path_for(session)
        if path.exists():
            raise ApplicationError(
                f"There is already a session {session!r}: resume it, or choose another name"
            )
        self._begin(path, loaded, ())

    @command("resume")
    def _resume(self, session: Name) -> None:
        """Resume a session with its own plan."""
        begun = self._hub.sessions.open(session)
        self._begin(begun.path, begun.plan, ())

    @command("pause")
    def _pause(self) -> None:
        """Wait before the next capture."""
        self._hub.run.pause()

    @command("go-on")
    def _go_on(self) -> None:
        """End the pause."""
        self._hub.run.go_on()

    @command("target-moved")
    def _target_moved(self) -> None:
        """Ask to place the target again: it is not where it was."""
        self._hub.run.target_moved()

    @command("retake")
    def _retake(self, session: Name, index: Index) -> None:
        """Retake a capture of the session."""
        if self._hub.jobs.current is not None and self._hub.run.view.session == session:
            self._hub.run.retake(index)
            return
        begun = self._hub.sessions.open(session)
        self._begin(begun.path, begun.plan, (index,))

    def _begin(self, path: Path, plan: CapturePlan, retake: tuple[int, ...]) -> None:
        hub = self._hub
        hub.require_devices()
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
                f"The plan {plan.name!r} is no longer in any folder of plans: its captures are not "
                "compared with the photographs that it names."
            )
            return PlannedComparisons(session=path)
        return PlannedComparisons.of(plan, folder, path)

    @command("answer")
    def _answer(
        self, number: Index, choice: Name, text: Annotated[str, Field(max_length=200)] = ""
    ) -> None:
        """Answer the question that is waiting."""
        if not self._hub.prompts.answer(number, choice, text):
            raise ApplicationError("That question has already been answered.")

    @command("preview", needs_control=False)
    def _preview(self, plan: Name) -> Document:
        """Show what a plan will take."""
        return self._cost(plan, self._hub.plans.load(plan))

    @command("plan-check", needs_control=False)
    def _check_plan(self, draft: PlanDraft) -> Document:
        """Say what is wrong with a draft of a plan, or what it will take."""
        try:
            plan = plan_of(draft)
        except DraftError as error:
            return {"type": "draft", "is_ok": False, "text": str(error), "keys": list(error.keys)}
        cost = self._cost("", plan)
        facts = {key: value for key, value in cost.items() if key not in ("type", "rows")}
        return {"type": "draft", "is_ok": True, "text": "", "keys": [], **facts}

    @command("plan-save")
    def _save_plan(self, name: Name, draft: PlanDraft, is_replacing: bool = False) -> Document:
        """Write a draft to the folder of plans, under a new name unless it may replace one."""
        plan = plan_of(draft)
        if not is_replacing and self._hub.plans.has(name):
            return {"type": "plan-exists", "name": name}
        path = self._hub.plans.save(name, plan)
        return {"type": "plan-saved", "name": name, "path": str(path)}

    def _cost(self, name: str, plan: CapturePlan) -> Document:
        entries, bench = plan_entries(plan), self._hub.bench
        settings = self._hub.camera.settings
        shape = None if settings is None else (settings.height_px, settings.width_px)
        return preview_document(
            name,
            plan,
            entries,
            estimate_plan(plan, entries, bench, shape),
            tuple(flicker_warnings(plan, entries, bench)),
            free_bytes=self._hub.free_bytes(),
        )

    def _refuse_running(self, name: str) -> None:
        hub = self._hub
        job = hub.jobs.current
        if job is not None and hub.run.view.session == name and hub.run.is_under_way:
            raise BusyError(job.name, "The session is running: wait for its end, or stop it.")

    @command("pose-reference")
    def _choose_reference(self, session: Name | None = None, index: Index | None = None) -> None:
        """Compare the pose with a capture, or with the current picture if none is named."""
        hub = self._hub
        if session is None or index is None:
            latest = hub.frames.latest
            if latest is None:
                raise ApplicationError("There is no picture yet.")
            hub.pose.choose(
                "the picture taken just now", latest.image_dn, latest.settings.max_level_dn
            )
            return
        opened = hub.sessions.open(session)
        record = used_record(opened, index)
        name = f"{session}, capture {index} at {record.height_mm:.1f} mm"
        most_dn = record.max_level_dn if record.bracket is None else None
        hub.pose.choose(name, opened.load(record).mean_dn, most_dn)

    @command("pose-clear")
    def _clear_reference(self) -> None:
        """Forget the reference."""
        self._hub.pose.clear()

    @command("pose-curve")
    def _choose_curve(
        self, file: Annotated[str, Field(max_length=1000)], curve: Index | None = None
    ) -> None:
        """Judge the pose by a curve of a file, by its number; by none if no file is named."""
        self._hub.curves.choose(file, curve)
        self._tell_curve()

    @command("pose-threshold")
    def _set_threshold(
        self, min_dprime: Annotated[float, Field(gt=0, le=MOST_DPRIME, allow_inf_nan=False)]
    ) -> None:
        """Demand another d' of a pose that is good enough."""
        self._hub.curves.set_threshold(min_dprime)
        self._tell_curve()

    def _tell_curve(self) -> None:
        """Say on all pages what counts from now on, unless the card asks to choose a curve."""
        view = self._hub.curves.view
        if view.chosen is not None:
            self._hub.tell(
                f"Poses are judged by {view.file}: {view.name}; d' at least {view.min_dprime:g}."
            )
        elif not view.file:
            self._hub.tell(f"No curve judges poses; d' at least {view.min_dprime:g}.")


_READER = MessageReader(commands_of(CommandHandler).values())
MESSAGES = _READER.kinds
"""The kinds of messages that are understood."""

parse_message = _READER.read
