from .cross_validation import cross_validate as cross_validate
from .document import (
    CrossValidation as CrossValidation,
    HalvesCheck as HalvesCheck,
    Misfit as Misfit,
    MisfitKind as MisfitKind,
)
from .height_trend import (
    HeightGroup as HeightGroup,
    HeightTrend as HeightTrend,
    fit_height_trend as fit_height_trend,
)
from .misfits import shared_of as shared_of
from .softness import (
    SoftnessFit as SoftnessFit,
    TargetSoftness as TargetSoftness,
    measure_softness as measure_softness,
)
