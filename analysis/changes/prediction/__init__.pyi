from .filters import ExpectedFilters as ExpectedFilters
from .limit_curve import LimitCurve as LimitCurve
from .meeting import describe_prediction as describe_prediction, meet as meet
from .unexplained import Unexplained as Unexplained, unexplained as unexplained
