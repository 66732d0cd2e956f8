"""A console over the simulated bench in this process, small and fast."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from acquisition.bench import BenchConfig, load_bench
from acquisition.devices import Frame
from analysis.pose import PoseVerdict
from hil_mocks import SimulatedBench
from hil_mocks.devices import RealTimeClock
from standoff.console.bench_hub import BenchHub
from standoff.console.devices import BenchDrivers, bench_drivers
from standoff.library import place_in_simulation
from standoff.shipped_configs import shipped_config
from tests.acquisition.fakes import SETTINGS

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


DEADLINE_S = 300.0

PLAN = """
schema = "standoff.plan/1"
name = "two heights"
heights_mm = [300.0, 301.0]
frames_per_capture = 2

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0]
"""


def pose_verdict(**facts: Any) -> PoseVerdict:
    """A go of which nothing else is known, but for these facts."""
    unknown = dict.fromkeys(("probability", "dprime", "margin", "homography", "zoom", "overlap"))
    usual = {"accepted": True, "verdict": "go", "reason": "because", "anchored": False}
    return PoseVerdict(**{**unknown, **usual, **facts})


def small_bench(**keys: object) -> BenchConfig:
    """The simulated bench with a small frame and a fast stage; ``keys`` as in ``camera__x``."""
    overrides: dict[str, object] = {
        "simulated.width_px": 64,
        "simulated.height_px": 48,
        "stage.feed_mm_per_min": 60000.0,
        "stage.settle_s": 0.0,
        **{key.replace("__", "."): value for key, value in keys.items()},
    }
    return load_bench(shipped_config("simulated.toml"), overrides)


def idle_hub(folder: Path, **keys: object) -> BenchHub:
    """A hub whose devices are never opened; its plan folder is ``folder``."""
    bench = small_bench(**keys)
    (folder / "two.toml").write_text(PLAN)
    return BenchHub(
        bench, bench_drivers(bench), sessions=folder / "sessions", plan_folders=(folder,)
    )


@contextmanager
def running_hub(folder: Path, **keys: object) -> Iterator[BenchHub]:
    """A hub over the simulated bench, with pictures and an answering stage."""
    hub = idle_hub(folder, **keys)
    hub.start()
    try:
        wait_for(lambda: hub.frames.latest is not None, "a picture")
        wait_for(lambda: hub.stage.status.is_ready, "the stage")
        yield hub
    finally:
        hub.close()


class SimulatedHub:
    """A hub with the simulated bench behind it, whose faults can be set.

    ``drivers`` replace those of the bench.
    """

    def __init__(self, folder: Path, **drivers: Any) -> None:
        config = small_bench()
        self.bench = SimulatedBench(config, clock=RealTimeClock())
        clock = self.bench.clock
        usual = {
            "open_camera": self.bench.open_camera,
            "open_stage": lambda _again, _ask: self.bench.stage,
            "laid": place_in_simulation(self.bench),
            "clock": lambda: clock.now_s,
            "sleep": clock.advance,
        }
        (folder / "two.toml").write_text(PLAN)
        self.hub = BenchHub(
            config,
            BenchDrivers(**(usual | drivers)),
            sessions=folder / "sessions",
            plan_folders=(folder,),
        )


def wait_for(condition: Callable[[], bool], what: str) -> None:
    """Wait for something that other threads do; a failure names it."""
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"did not happen: {what}"
        time.sleep(0.005)
