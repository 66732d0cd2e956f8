from .changes import patch_of as patch_of
from .evaluate import (
    EvaluatedDetector as EvaluatedDetector,
    EvaluationTask as EvaluationTask,
    Patch as Patch,
    Spot as Spot,
    evaluate as evaluate,
    evaluation_figure_paths as evaluation_figure_paths,
    evaluation_made_by as evaluation_made_by,
)
