from .chance import FilterWidth as FilterWidth, significance_threshold as significance_threshold
from .document import (
    Change as Change,
    ChangeSummary as ChangeSummary,
    DetectionLimit as DetectionLimit,
    PredictedLimit as PredictedLimit,
    SpotLimit as SpotLimit,
    change_table as change_table,
    read_changes as read_changes,
)
from .filter import (
    ChangeResult as ChangeResult,
    find_changes as find_changes,
)
from .focus_sentence import describe_focus as describe_focus
from .limit_sentence import describe_limit as describe_limit, size_text as size_text
from .matching import smoothing_for as smoothing_for
from .options import ChangeOptions as ChangeOptions
from .plot import changes_figure as changes_figure
from .power import detection_power as detection_power, height_for as height_for
from .prediction import (
    ExpectedFilters as ExpectedFilters,
    LimitCurve as LimitCurve,
    describe_prediction as describe_prediction,
    unexplained as unexplained,
)
