from ._bench_devices import (
    HeightStage as HeightStage,
    SessionCamera as SessionCamera,
    WorkStatus as WorkStatus,
    height_scan as height_scan,
)
