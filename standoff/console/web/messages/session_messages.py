"""What a page may send about plans, sessions and their results."""

from typing import Annotated, Literal

from pydantic import Field

from standoff.console.plan_drafts import PlanDraft
from standoff.console.results import ResultKind
from standoff.console.web.messages.fields import Index, Name, PageMessage, Reason


class Preview(PageMessage):
    """Show what a plan will take."""

    do: Literal["preview"]
    plan: Name


class CheckPlan(PageMessage):
    """Say what is wrong with a draft of a plan, or what it will take."""

    do: Literal["plan-check"]
    draft: PlanDraft


class SavePlan(PageMessage):
    """Write a draft to the folder of plans, under a name of its own unless it may replace one."""

    do: Literal["plan-save"]
    name: Name
    draft: PlanDraft
    is_replacing: bool = False


class Run(PageMessage):
    """Run a plan as a new session."""

    do: Literal["run"]
    plan: Name
    session: Name


class Resume(PageMessage):
    """Resume a session with its own plan."""

    do: Literal["resume"]
    session: Name


class Pause(PageMessage):
    """Wait before the next capture."""

    do: Literal["pause"]


class GoOn(PageMessage):
    """End the pause."""

    do: Literal["go-on"]


class TargetMoved(PageMessage):
    """Ask to place the target again: it is not where it was."""

    do: Literal["target-moved"]


class Retake(PageMessage):
    """Retake a capture of the session."""

    do: Literal["retake"]
    session: Name
    index: Index


class Answer(PageMessage):
    """Answer the question that is waiting."""

    do: Literal["answer"]
    number: Index
    choice: Name
    text: Annotated[str, Field(max_length=200)] = ""


class ComputeResult(PageMessage):
    """Compute a result of a session; a pose or changes compare two captures."""

    do: Literal["result"]
    session: Name
    result: ResultKind
    is_replacing: bool = False
    reference_session: Name | None = None
    reference: Index | None = None
    followup: Index | None = None


class CancelResult(PageMessage):
    """Cancel the result that is being computed."""

    do: Literal["cancel-result"]


class Exclude(PageMessage):
    """Keep a capture out of calibration and analysis."""

    do: Literal["exclude"]
    session: Name
    index: Index
    reason: Reason


class Include(PageMessage):
    """Use an excluded capture again."""

    do: Literal["include"]
    session: Name
    index: Index
    reason: Reason = ""
