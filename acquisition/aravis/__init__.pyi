from .camera import AravisCamera as AravisCamera
from .controls import COUNTS as COUNTS, StatedValue as StatedValue
from .device import open_device as open_device
from .discovery import (
    CameraProbe as CameraProbe,
    FoundCamera as FoundCamera,
    list_cameras as list_cameras,
    probe_camera as probe_camera,
)
from .feature_names import bench_key as bench_key
from .features import Bounds as Bounds
from .library import AravisLibrary as AravisLibrary, load_aravis as load_aravis
from .route import (
    NetworkRoute as NetworkRoute,
    receive_buffer_limit_bytes as receive_buffer_limit_bytes,
    route_to as route_to,
)
from .stream import SOCKET_BUFFER_BYTES as SOCKET_BUFFER_BYTES
