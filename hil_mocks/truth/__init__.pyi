from ._images import (
    SAMPLES_PER_PX as SAMPLES_PER_PX,
    PeriodicImage as PeriodicImage,
    SplineScene as SplineScene,
    spline_at as spline_at,
)
from .bench_truth import BenchTruth as BenchTruth
from .relief import Outline as Outline, inside_outline as inside_outline
from .render import (
    ADC_MAX_DN as ADC_MAX_DN,
    MONO8_SHIFT as MONO8_SHIFT,
    PIXEL_FORMATS as PIXEL_FORMATS,
    CameraPose as CameraPose,
    Sensor as Sensor,
    distort as distort,
    leaning_rotation as leaning_rotation,
    plane_rays as plane_rays,
    undistort as undistort,
)
from .scenes import (
    PHOTOGRAPHS as PHOTOGRAPHS,
    Edge as Edge,
    Placed as Placed,
    SumOfScenes as SumOfScenes,
    ZonePlate as ZonePlate,
    luma as luma,
)
from .targets import TARGETS as TARGETS, scene_of as scene_of
