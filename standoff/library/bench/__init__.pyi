from .bench import Bench as Bench, height_series as height_series
from .devices import (
    OpenBench as OpenBench,
    OpenCamera as OpenCamera,
    devices_of as devices_of,
    open_bench as open_bench,
    open_camera as open_camera,
    open_stage as open_stage,
    opened_camera as opened_camera,
    place_in_simulation as place_in_simulation,
    refuse_half_simulated as refuse_half_simulated,
)
from .live_focus import watch_focus as watch_focus
from .planned_comparison import PlannedComparisons as PlannedComparisons
