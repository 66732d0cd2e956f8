from ._camera import (
    AravisCamera as AravisCamera,
    CameraProbe as CameraProbe,
    FoundCamera as FoundCamera,
    list_cameras as list_cameras,
    probe_camera as probe_camera,
)
from ._device import (
    AravisLibrary as AravisLibrary,
    load_aravis as load_aravis,
    open_device as open_device,
)
from ._features import (
    COUNTS as COUNTS,
    Bounds as Bounds,
    bench_key as bench_key,
)
from ._network import (
    NetworkRoute as NetworkRoute,
    receive_buffer_limit_bytes as receive_buffer_limit_bytes,
    route_to as route_to,
)
from ._stream import SOCKET_BUFFER_BYTES as SOCKET_BUFFER_BYTES
