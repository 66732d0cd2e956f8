from .access import MIN_TOKEN_CHARS as MIN_TOKEN_CHARS, is_loopback_host as is_loopback_host
from .bench_hub import BenchHub as BenchHub, ConsoleHub as ConsoleHub
from .devices import bench_drivers as bench_drivers
from .pose_curves import GivenCurves as GivenCurves
from .server import open_socket as open_socket, serve as serve
