from .controller import GrblController as GrblController
from .stage import GrblStage as GrblStage, open_grbl_stage as open_grbl_stage
from .wire import parse_line as parse_line

__all__ = [
    "GrblController",
    "GrblStage",
    "open_grbl_stage",
    "parse_line",
]
