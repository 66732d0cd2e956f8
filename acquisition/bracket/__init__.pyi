from .exposure_control import ExposedFrames as ExposedFrames, ExposureControl as ExposureControl
from .merging import (
    BracketExposure as BracketExposure,
    MergedBracket as MergedBracket,
    merge_bracket as merge_bracket,
)
