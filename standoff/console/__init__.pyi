from .bench_hub import BenchHub as BenchHub
from .drivers import bench_drivers as bench_drivers
from .pose_curves import GivenCurves as GivenCurves
