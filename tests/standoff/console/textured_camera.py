"""A console whose camera sees a texture, which compresses as badly as real scenes do."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import numpy as np
from scipy.ndimage import gaussian_filter

from acquisition.devices import Frame
from standoff.console.bench_hub import BenchHub
from tests.acquisition.fakes import SETTINGS
from tests.standoff.console.hub_fixtures import idle_hub

RATE_HZ = 25.0


@contextmanager
def textured_hub(folder: Path, *, noise_dn: float = 20.0) -> Iterator[BenchHub]:
    """A console whose camera sees a noisy texture of 780 x 580 pixels, a corner of it saturated."""
    rng = np.random.default_rng(1)
    texture = 2000 + 9000 * gaussian_filter(rng.normal(size=(580, 780)), 2.0)
    frames = [
        np.clip(texture + rng.normal(0, noise_dn, texture.shape), 0, 4094).astype(np.uint16)
        for _ in range(3)
    ]
    for image_dn in frames:
        image_dn[:80, :80] = 4095
    hub, is_over = idle_hub(folder), Event()

    def publish() -> None:
        number = 0
        while not is_over.wait(1 / RATE_HZ):
            number += 1
            image_dn = frames[number % len(frames)]
            hub.frames.publish(
                Frame(image_dn=image_dn, frame_id=number, timestamp_ns=number), SETTINGS
            )

    camera = Thread(target=publish)
    camera.start()
    try:
        yield hub
    finally:
        is_over.set()
        camera.join()
