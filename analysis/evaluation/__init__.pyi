from ._document import (
    FPR as FPR,
    Evaluation as Evaluation,
    EvaluationCurve as EvaluationCurve,
    FailedPair as FailedPair,
    FrocPoints as FrocPoints,
    Photographs as Photographs,
    PhotographScores as PhotographScores,
    RocPoints as RocPoints,
    evaluation_curves as evaluation_curves,
    is_evaluation as is_evaluation,
    read_evaluation as read_evaluation,
    scores_of as scores_of,
)
from ._plot import auc_figure as auc_figure, roc_figure as roc_figure
from ._work import EvaluationWork as EvaluationWork
from .pairs import ChangePair as ChangePair, PairMaker as PairMaker, refocused as refocused
from .task import (
    Condition as Condition,
    EvaluationTask as EvaluationTask,
    LaterScene as LaterScene,
    PaintedChange as PaintedChange,
    Patch as Patch,
    Spot as Spot,
)
