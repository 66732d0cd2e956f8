from ._bench import Bench as Bench, height_series as height_series
from ._devices import (
    OpenBench as OpenBench,
    devices_of as devices_of,
    find_cameras as find_cameras,
    open_bench as open_bench,
    open_camera as open_camera,
    open_stage as open_stage,
    opened_camera as opened_camera,
    place_in_simulation as place_in_simulation,
    place_target as place_target,
    refuse_half_simulated as refuse_half_simulated,
)
from ._focus import (
    FoundFocus as FoundFocus,
    WatchedFocus as WatchedFocus,
    find_focus as find_focus,
    watch_focus as watch_focus,
)
from ._plan_preview import (
    bench_config as bench_config,
    given_plan as given_plan,
    preview_plan as preview_plan,
)
from ._session_capture import (
    CapturedSession as CapturedSession,
    PlannedComparisons as PlannedComparisons,
    capture_session as capture_session,
)
from ._stage_control import operate_stage as operate_stage
