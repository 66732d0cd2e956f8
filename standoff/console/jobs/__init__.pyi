from .control_arbiter import ControlDesk as ControlDesk, ControlView as ControlView
from .job_runner import BusyError as BusyError, Job as Job, JobDesk as JobDesk
from .prompt_queue import Prompt as Prompt, PromptBoard as PromptBoard
from .session_run import (
    PlanRow as PlanRow,
    RunView as RunView,
    SessionRun as SessionRun,
    rows_of as rows_of,
)

__all__ = [
    "BusyError",
    "ControlDesk",
    "ControlView",
    "Job",
    "JobDesk",
    "PlanRow",
    "Prompt",
    "PromptBoard",
    "RunView",
    "SessionRun",
    "rows_of",
]
