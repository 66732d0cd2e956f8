from .curves import FPR as FPR, Photographs as Photographs, evaluation_curves as evaluation_curves
from .document import (
    Evaluation as Evaluation,
    EvaluationCurve as EvaluationCurve,
    FrocPoints as FrocPoints,
    RocPoints as RocPoints,
    is_evaluation as is_evaluation,
    read_evaluation as read_evaluation,
)
from .painted_changes import (
    LaterScene as LaterScene,
    PaintedChange as PaintedChange,
    Patch as Patch,
    Spot as Spot,
)
from .pairs import ChangePair as ChangePair, PairMaker as PairMaker, refocused as refocused
from .plot import auc_figure as auc_figure, roc_figure as roc_figure
from .scores import FailedPair as FailedPair, PhotographScores as PhotographScores
from .task import Condition as Condition, EvaluationTask as EvaluationTask
from .work import EvaluationWork as EvaluationWork
