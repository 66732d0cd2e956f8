from ._colour import PairColours as PairColours
from ._depth import (
    DepthMap as DepthMap,
    ParallaxMap as ParallaxMap,
    depth_in_mm as depth_in_mm,
)
from ._document import (
    Change as Change,
    ChangeSummary as ChangeSummary,
    SceneHeights as SceneHeights,
    SceneParallax as SceneParallax,
    change_table as change_table,
    describe_depth as describe_depth,
    describe_focus as describe_focus,
    describe_least as describe_least,
    describe_limit as describe_limit,
    describe_moved as describe_moved,
    describe_prediction as describe_prediction,
    read_changes as read_changes,
)
from ._filter import ChangeResult as ChangeResult, changes_between as changes_between
from ._photograph_pair import (
    ChangeCriteria as ChangeCriteria,
    ChangeOptions as ChangeOptions,
    CodedAlike as CodedAlike,
)
from ._plot import changes_figure as changes_figure
from ._prediction import (
    ExpectedFilters as ExpectedFilters,
    LimitCurve as LimitCurve,
    unexplained as unexplained,
)
from ._significance import (
    FilterWidth as FilterWidth,
    detection_power as detection_power,
    height_for as height_for,
    significance_threshold as significance_threshold,
)
from .matching import smoothing_for as smoothing_for
