from .change_pairs import (
    ChangePairs as ChangePairs,
    ChangePairsTask as ChangePairsTask,
    change_pairs as change_pairs,
    read_change_pairs as read_change_pairs,
)
from .evaluate import (
    EvaluatedDetector as EvaluatedDetector,
    EvaluationTask as EvaluationTask,
    Patch as Patch,
    Spot as Spot,
    evaluate as evaluate,
    evaluation_figure_paths as evaluation_figure_paths,
    evaluation_made_by as evaluation_made_by,
    patch_of as patch_of,
)
