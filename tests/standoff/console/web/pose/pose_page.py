"""A bench page whose live picture goes on, and what is seen at a place of it."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from acquisition.devices import FrameImage
from standoff.console.bench_hub import BenchHub
from standoff.console.devices.device_status import DeviceStatus
from tests.acquisition.fakes import SETTINGS, frame
from tests.standoff.console.web.live_page import LivePage

ROWS, COLS = 90, 120
PERIOD_S = 0.1


class Streaming:
    """Ten pictures a second, all the same, until ``is_dead`` is set."""

    def __init__(self, hub: BenchHub, image_dn: FrameImage) -> None:
        self.image_dn = image_dn
        self.is_dead = Event()
        self._hub = hub
        hub.camera._status = DeviceStatus(state="ready")
        self._thread = Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        """End the pictures."""
        self.is_dead.set()
        self._thread.join()

    def _run(self) -> None:
        count = 0
        while not self.is_dead.wait(PERIOD_S):
            count += 1
            self._hub.frames.publish(frame(self.image_dn, count), SETTINGS)


@contextmanager
def streaming(hub: BenchHub, image_dn: FrameImage) -> Iterator[Streaming]:
    """Pictures of a hub whose camera is never opened."""
    made = Streaming(hub, image_dn)
    try:
        yield made
    finally:
        made.close()


def even_dn(level: float, rows: int = ROWS, cols: int = COLS) -> NDArray[np.uint16]:
    """A picture that is shown with this level of 0 to 254."""
    return np.full((rows, cols), round(level * SETTINGS.max_level_dn / 254), np.uint16)


def step_dn(column_px: float) -> NDArray[np.uint16]:
    """Dark up to a column, bright from there on."""
    x_px = np.broadcast_to(np.arange(COLS), (ROWS, COLS))
    share = 0.5 + 0.5 * erf((x_px - column_px) / np.sqrt(2))
    return np.asarray(np.rint(600 + 1500 * share), dtype=np.uint16)


def seen(live: LivePage) -> NDArray[np.int64]:
    """What is in the frame of the picture on the screen: rows, columns, and blue, green, red."""
    data = live.page.locator("#frame").screenshot()
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image, np.int64)


def level_at(live: LivePage, x_px: float, y_px: float) -> list[int]:
    """Blue, green and red that are seen at a place of the picture."""
    right, down = live.asked(f"standoff.view.shown([{x_px}, {y_px}])")
    return [int(value) for value in seen(live)[int(down), int(right)]]
