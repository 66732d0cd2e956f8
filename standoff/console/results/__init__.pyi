from .command_process import (
    CommandProgress as CommandProgress,
    CommandResult as CommandResult,
    run_command as run_command,
)
from .key_figures import KeyFigures as KeyFigures, key_figures as key_figures
from .lens_comparison import (
    earlier_calibration as earlier_calibration,
    lens_sentence as lens_sentence,
)
from .result_jobs import (
    ResultJobs as ResultJobs,
    ResultProgress as ResultProgress,
    ResultRequest as ResultRequest,
)
from .result_kinds import (
    ResultKind as ResultKind,
    ResultView as ResultView,
    missing_for as missing_for,
    page_path as page_path,
    results_of as results_of,
)
