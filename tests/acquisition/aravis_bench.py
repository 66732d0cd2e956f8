"""The Aravis driver on the simulated GigE camera, for the tests."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.aravis._camera import AravisCamera
from acquisition.aravis._device import load_aravis
from acquisition.bench import CameraConfig
from acquisition.devices import Frame
from acquisition.errors import DriverMissingError
from hil_mocks.gige._settings import FrameRequest
from hil_mocks.gige._wire import PIXEL_LAYOUTS, image_of_levels
from hil_mocks.practice_bench import PracticeBench


def _missing() -> str:
    try:
        load_aravis()
    except DriverMissingError as error:
        return str(error)
    return ""


needs_aravis = pytest.mark.skipif(_missing() != "", reason=_missing())


def camera_config(address: str, **keys: object) -> CameraConfig:
    """A quick camera, with single keys replaced; nothing tries which packets arrive."""
    return CameraConfig.model_validate(
        {
            "driver": "aravis",
            "address": address,
            "pixel_format": "Mono12",
            "exposure_us": 4000.0,
            "gain_db": 0.0,
            "frame_rate_hz": 60.0,
            "packet_size_bytes": 1500,
            "reconnect_timeout_s": 5.0,
            **keys,
        }
    )


@contextmanager
def opened(bench: PracticeBench, **keys: object) -> Iterator[AravisCamera]:
    """The driver on the bench's camera."""
    with closing(AravisCamera.open(camera_config(bench.camera.address, **keys))) as camera:
        yield camera


def sent_image(
    bench: PracticeBench, camera: AravisCamera, frame: Frame
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """The picture that the simulated camera made for this frame, before it was sent."""
    settings = camera.settings
    level_dn = bench.source.levels_dn(
        FrameRequest(
            acquisition=bench.camera.acquisitions,
            index=frame.frame_id - 1,
            exposure_us=settings.exposure_us,
            gain_db=bench.camera.value("Gain"),
            black_level_dn=bench.camera.value("BlackLevel"),
        )
    )
    left, top = (int(settings.features[name]) for name in ("OffsetX", "OffsetY"))
    region = level_dn[top : top + settings.height_px, left : left + settings.width_px]
    return image_of_levels(region, PIXEL_LAYOUTS[settings.pixel_format])


def after_frames(camera: AravisCamera, count: int, happen: Callable[[], None]) -> None:
    """Let something happen once, when so many frames more have been delivered."""
    deliver = camera.next_frame
    delivered = 0

    def next_frame(timeout_s: float) -> Frame:
        nonlocal delivered
        frame = deliver(timeout_s)
        delivered += 1
        if delivered == count:
            happen()
        return frame

    camera.next_frame = next_frame  # type: ignore[method-assign]  # observed, not changed
