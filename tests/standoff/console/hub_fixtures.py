"""A console over the simulated bench in this process, small and fast."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from acquisition.bench import BenchConfig, load_bench
from standoff.console.bench_hub import BenchHub
from standoff.console.drivers import bench_drivers
from standoff.shipped_configs import shipped_config

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


def wait_for(condition: Callable[[], bool], what: str) -> None:
    """Wait for something that other threads do; a failure names it."""
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"did not happen: {what}"
        time.sleep(0.005)
