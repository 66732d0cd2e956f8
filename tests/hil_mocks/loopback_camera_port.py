"""The control port of a camera on 127.0.0.1, which one test of all processes has at a time."""

import fcntl
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def loopback_camera_port() -> Iterator[None]:
    """Wait for UDP port 3956 of 127.0.0.1 and keep it from other tests, bound or not.

    A camera that is killed and started again leaves the port free in between: without the lock,
    another test would answer there in the camera's place.
    """
    with (Path(tempfile.gettempdir()) / "standoff-loopback-camera-port.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
