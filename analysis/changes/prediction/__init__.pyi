from .filters import ExpectedFilters as ExpectedFilters
from .limit_curve import LimitCurve as LimitCurve
from .meeting import meet as meet
from .unexplained import Unexplained as Unexplained, unexplained as unexplained
