"""What a worker's process needs to be as quick as the command's own."""

import ctypes
from contextlib import suppress
from functools import cache

import cv2

from analysis.design_cache import keep_designs_on_disk

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of glibc's mallopt(3)
_KEPT_BYTES, _HEAP_BYTES = 1 << 27, 1 << 25  # the second is the most that glibc takes


@cache
def prepare_process() -> None:
    """Give OpenCV one thread, keep freed memory for the next image, and kernels on disk; once.

    Dask's nannies start workers with ``MALLOC_TRIM_THRESHOLD_=65536``: each freed array goes back
    to the system, and work on images takes twice the time, in page faults.
    """
    cv2.setNumThreads(1)  # as many batches are done at once as there are cores
    keep_freed_memory()
    keep_designs_on_disk()


def keep_freed_memory() -> None:
    """Keep up to 128 MiB of freed memory in this process for its next arrays."""
    with suppress(OSError, AttributeError):  # another C library has no mallopt
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_MMAP_THRESHOLD, _HEAP_BYTES)
