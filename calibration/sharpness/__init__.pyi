from ._dead_leaves import (
    TextureSfr as TextureSfr,
    find_dead_leaves as find_dead_leaves,
    measure_dead_leaves as measure_dead_leaves,
    spread_of as spread_of,
)
from ._edge_figures import (
    FIGURE_NAMES as FIGURE_NAMES,
    NYQUIST as NYQUIST,
    EdgeFigures as EdgeFigures,
    MeasuredValue as MeasuredValue,
    Sharpening as Sharpening,
    edge_figures as edge_figures,
    median_figures as median_figures,
    sharpening_of as sharpening_of,
)
from ._resolution import (
    lp_per_mm as lp_per_mm,
    lw_per_ph as lw_per_ph,
    reported_mtf50 as reported_mtf50,
    with_sharpness as with_sharpness,
)
from ._star import (
    EdgeMtf as EdgeMtf,
    StarPlace as StarPlace,
    StarSfr as StarSfr,
    find_star as find_star,
    mean_of_sectors as mean_of_sectors,
    measure_star as measure_star,
)
from ._verdict import (
    CAMERA_TABLES as CAMERA_TABLES,
    MODEL_REMARK as MODEL_REMARK,
    VERDICT_COLUMNS as VERDICT_COLUMNS,
    Direction as Direction,
    LimitVerdict as LimitVerdict,
    Picture as Picture,
    SharpnessLimits as SharpnessLimits,
    SharpnessVerdict as SharpnessVerdict,
    edge_cells as edge_cells,
    edge_name as edge_name,
    edge_row as edge_row,
    judge_sharpness as judge_sharpness,
    median_of_edges as median_of_edges,
    position_in_field as position_in_field,
    read_limits as read_limits,
    verdict_rows as verdict_rows,
)
