from .corrections import NeutralFeatures as NeutralFeatures, neutralise as neutralise
from .frame_start import FrameRate as FrameRate, set_trigger as set_trigger
from .levels import (
    COUNTS as COUNTS,
    US_PER_UNIT as US_PER_UNIT,
    LevelControls as LevelControls,
    StatedValue as StatedValue,
)
