from .edge_table import edge_csv as edge_csv, edge_table_section as edge_table_section
from .front_page import calibration_front as calibration_front, verdict_section as verdict_section
from .history import (
    HistoryEntry as HistoryEntry,
    history_document as history_document,
    history_sections as history_sections,
    ordered_history as ordered_history,
    plot_history as plot_history,
)
from .remarks import psf_remarks as psf_remarks
from .sections import (
    calibration_sections as calibration_sections,
    calibration_verdicts as calibration_verdicts,
)
