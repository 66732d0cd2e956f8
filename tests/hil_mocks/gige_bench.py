"""A simulated GigE camera for the tests of whatever speaks GigE Vision.

with gige_bench() as bench:
    camera = Aravis.Camera.new(bench.camera.address)
    bench.place("flat")
    bench.camera.faults = GigeFaults(packet_loss_rate=0.01)
"""

import itertools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import DeviceError
from hil_mocks.gige import FrameRequest
from hil_mocks.gige._device import ETHERNET_MTU_BYTES
from hil_mocks.gige._features import Maker
from hil_mocks.gige._wire import PIXEL_LAYOUTS, image_of_levels
from hil_mocks.practice_bench import PracticeBench
from tests.hil_mocks.benches import bench_config

HEIGHT_MM = 200.0
ADDRESSES_TRIED = 50
_numbers = itertools.count()


def free_addresses() -> Iterator[str]:
    """Loopback addresses that no other process of the tests uses, the next one each time."""
    process = os.getpid()
    for number in itertools.islice(_numbers, ADDRESSES_TRIED):
        yield f"127.{64 + process % 64}.{process // 64 % 250 + 1}.{number % 250 + 2}"


@contextmanager
def gige_bench(
    *,
    height_mm: float | Callable[[], float] = HEIGHT_MM,
    bayer_order: str | None = None,
    link_mtu_bytes: int = ETHERNET_MTU_BYTES,
    maker: Maker = "allied_vision",
    **keys: object,
) -> Iterator[PracticeBench]:
    """Serve a small bench (96 x 64 px) as a GigE camera on a free address.

    ``keys`` replace single keys of the bench, such as ``simulated__width_px=780``. The camera
    is ``bench.camera`` (`GigeDevice`: ``address``, ``faults``, ``restart()``), its frames can be
    had from ``bench.source`` as well.
    """
    config = bench_config(**keys)
    for address in free_addresses():
        bench = PracticeBench(
            config,
            height_mm=height_mm if callable(height_mm) else lambda: height_mm,
            address=address,
            bayer_order=bayer_order,
            link_mtu_bytes=link_mtu_bytes,
            maker=maker,
        )
        try:
            bench.camera.open()
        except DeviceError:
            continue
        break
    else:
        raise RuntimeError("no loopback address is free")
    try:
        yield bench
    finally:
        bench.camera.close()


def expected_image(
    bench: PracticeBench,
    pixel_format: str,
    *,
    index: int,
    acquisition: int = 1,
    exposure_us: float = 8000.0,
    gain_db: float = 0.0,
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """The frame of an acquisition as the bench's source has it."""
    request = FrameRequest(
        acquisition=acquisition,
        index=index,
        exposure_us=exposure_us,
        gain_db=gain_db,
        black_level_dn=64.0,
    )
    return image_of_levels(bench.source.levels_dn(request), PIXEL_LAYOUTS[pixel_format])
