from .control_arbiter import ControlArbiter as ControlArbiter, ControlView as ControlView
from .focus_sweep import (
    FocusSweepRun as FocusSweepRun,
    SweepPlan as SweepPlan,
    SweepView as SweepView,
)
from .job_runner import BusyError as BusyError, Job as Job, JobRunner as JobRunner
from .prompt_queue import Prompt as Prompt, PromptQueue as PromptQueue
from .session_run import (
    PlanRow as PlanRow,
    RunView as RunView,
    SessionRun as SessionRun,
    rows_of as rows_of,
)
from .stage_stop import StageStop as StageStop, StopView as StopView
