from .softness import (
    SoftnessFit as SoftnessFit,
    TargetSoftness as TargetSoftness,
    measure_softness as measure_softness,
)
