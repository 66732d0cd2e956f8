from .edge_table import edge_table_section as edge_table_section
from .front_page import calibration_front as calibration_front, verdict_section as verdict_section
from .history import (
    history_document as history_document,
    history_sections as history_sections,
    ordered_history as ordered_history,
)
from .sections import (
    calibration_sections as calibration_sections,
    calibration_verdicts as calibration_verdicts,
)

__all__ = [
    "calibration_front",
    "calibration_sections",
    "calibration_verdicts",
    "edge_table_section",
    "history_document",
    "history_sections",
    "ordered_history",
    "verdict_section",
]
