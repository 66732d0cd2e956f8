from .change_errors import STUDIED_ZOOM as STUDIED_ZOOM, StudiedScene as StudiedScene
from .document import (
    NAMES as NAMES,
    STUDY_SCHEMA as STUDY_SCHEMA,
    BudgetShare as BudgetShare,
    PlanStudy as PlanStudy,
    PredictedQuantity as PredictedQuantity,
    StudiedWant as StudiedWant,
    StudyNeeds as StudyNeeds,
    read_study as read_study,
)
from .edge_information import (
    EdgeLevels as EdgeLevels,
    sigma_err_px as sigma_err_px,
    white_noise_sigma_err_px as white_noise_sigma_err_px,
)
from .planned_edges import (
    EdgeSession as EdgeSession,
    PlannedEdge as PlannedEdge,
    edges_of_captures as edges_of_captures,
)
from .pupil_errors import (
    BoardCapture as BoardCapture,
    BoardSession as BoardSession,
    PupilErrors as PupilErrors,
    pupil_errors as pupil_errors,
)
from .scene_texture import BUILT_IN as BUILT_IN, built_in_scenes as built_in_scenes
from .sources import Prediction as Prediction
from .study import (
    StudiedPlan as StudiedPlan,
    StudyPredictions as StudyPredictions,
    studied as studied,
)
from .transfer_errors import (
    KnownTransfer as KnownTransfer,
    TransferErrors as TransferErrors,
    TransferModel as TransferModel,
    transfer_errors as transfer_errors,
)
from .wants import (
    QUANTITIES as QUANTITIES,
    UNITS as UNITS,
    PlanSize as PlanSize,
    Want as Want,
    WantName as WantName,
    next_step as next_step,
    studied_want as studied_want,
)
from .width_errors import WidthErrors as WidthErrors, width_errors as width_errors
