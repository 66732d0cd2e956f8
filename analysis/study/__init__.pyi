from ._change_errors import (
    BUILT_IN as BUILT_IN,
    STUDIED_ZOOM as STUDIED_ZOOM,
    StudiedScene as StudiedScene,
    built_in_scenes as built_in_scenes,
)
from ._document import (
    NAMES as NAMES,
    STUDY_SCHEMA as STUDY_SCHEMA,
    BudgetShare as BudgetShare,
    PlanStudy as PlanStudy,
    PredictedQuantity as PredictedQuantity,
    StudiedWant as StudiedWant,
    StudyNeeds as StudyNeeds,
    read_study as read_study,
)
from ._edges import (
    EdgeLevels as EdgeLevels,
    EdgeSession as EdgeSession,
    KnownTransfer as KnownTransfer,
    PlannedEdge as PlannedEdge,
    TransferErrors as TransferErrors,
    TransferModel as TransferModel,
    WidthErrors as WidthErrors,
    edges_of_captures as edges_of_captures,
    sigma_err_px as sigma_err_px,
    transfer_errors as transfer_errors,
    white_noise_sigma_err_px as white_noise_sigma_err_px,
    width_errors as width_errors,
)
from ._pupil_errors import (
    BoardCapture as BoardCapture,
    BoardSession as BoardSession,
    PupilErrors as PupilErrors,
    pupil_errors as pupil_errors,
)
from ._study import (
    QUANTITIES as QUANTITIES,
    UNITS as UNITS,
    PlanSize as PlanSize,
    Prediction as Prediction,
    StudiedPlan as StudiedPlan,
    StudyPredictions as StudyPredictions,
    Want as Want,
    WantName as WantName,
    next_step as next_step,
    studied as studied,
    studied_want as studied_want,
)
