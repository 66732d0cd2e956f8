from .field_position import (
    Direction as Direction,
    FieldPosition as FieldPosition,
    position_in_field as position_in_field,
)
from .limits import (
    SharpnessLimits as SharpnessLimits,
    read_limits as read_limits,
)
from .resolution import (
    NORMAL_95 as NORMAL_95,
    Mtf50 as Mtf50,
    lp_per_mm as lp_per_mm,
    lw_per_ph as lw_per_ph,
    reported_mtf50 as reported_mtf50,
    with_sharpness as with_sharpness,
)
from .tables import (
    MODEL_REMARK as MODEL_REMARK,
    VERDICT_COLUMNS as VERDICT_COLUMNS,
    edge_cells as edge_cells,
    edge_name as edge_name,
    edge_row as edge_row,
    verdict_rows as verdict_rows,
    with_reach as with_reach,
)
from .verdict import (
    LimitVerdict as LimitVerdict,
    Picture as Picture,
    SharpnessVerdict as SharpnessVerdict,
    judge_sharpness as judge_sharpness,
    median_of_edges as median_of_edges,
)
