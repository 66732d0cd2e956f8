from .fit import (
    CLIPPED_FRACTION as CLIPPED_FRACTION,
    SHARPEST_PX as SHARPEST_PX,
    EdgeFit as EdgeFit,
    fit_edge as fit_edge,
)
from .jpeg import (
    JpegCompression as JpegCompression,
)
from .model import (
    EdgeShape as EdgeShape,
    edge_profile as edge_profile,
    edge_shape as edge_shape,
    shape_slopes as shape_slopes,
    shape_value as shape_value,
)
from .rounding import (
    Rounding as Rounding,
    rounding_bias as rounding_bias,
)
from .shading import (
    shading_levels as shading_levels,
    slopes_across as slopes_across,
)
