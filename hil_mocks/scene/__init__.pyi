from .pinhole import (
    CameraPose as CameraPose,
    distort as distort,
    undistort as undistort,
)
from .prints import PHOTOGRAPHS as PHOTOGRAPHS, luma as luma
from .scenes import Edge as Edge, Placed as Placed
from .sensor import (
    ADC_MAX_DN as ADC_MAX_DN,
    MONO8_SHIFT as MONO8_SHIFT,
    PIXEL_FORMATS as PIXEL_FORMATS,
    Sensor as Sensor,
)
from .spline import PeriodicImage as PeriodicImage
from .targets import TARGETS as TARGETS, scene_of as scene_of
from .truth import BenchTruth as BenchTruth
