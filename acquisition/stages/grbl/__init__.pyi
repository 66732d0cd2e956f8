from .axis import open_grbl_stage as open_grbl_stage
from .controller import GrblController as GrblController
from .envelope import expected_envelopes as expected_envelopes
from .wire import parse_line as parse_line
