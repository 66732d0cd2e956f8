"""What a sweep of very many photographs needs: memory, disk and time, by images, pixels, models.

Each line is a run in processes of its own. The photographs are synthetic and cheap, so that what
is left is the sweep's own: 64 x 64 px, one model, one zoom, a window of 5 px. Memory is the most
that the client, or its largest worker, held above what it held after its imports.
"""

import gc
import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from analysis.detectability import (
    ArtefactWork,
    DetectionTask,
    GaussianSignal,
    SweepSums,
    curves_of,
)
from analysis.sweep import Manifest, SweepOptions, run_sweep
from benchmarks.harness import Recorder, apart, benchmark
from benchmarks.truth.sweep_scenes import PLAN, load_scene, memory_bytes, scene_files
from simulation import Model

MODELS: tuple[Model, ...] = ("bicubic", "paper", "matched")
TASK = DetectionTask(
    signal=GaussianSignal(sigma_px=0.5),
    zooms=PLAN.zooms,
    noises_dn=(2.0,),
    window_px=PLAN.scenario.window_px,
)
MB = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class _Run:
    """What one sweep needed."""

    seconds: float
    client_bytes: int
    worker_bytes: int
    state_bytes: int


def _by_images(record: Recorder) -> None:
    """Memory, disk and time by number of images, in this process and with two workers."""
    for workers in (1, 2):
        counts = record.pick((1000, 10_000, 100_000), (500, 4000))
        record.say(f"{workers} worker{'s' * (workers > 1)}")
        record.say(" images   ms/image   client / MB   worker / MB   state / MB")
        runs = {}
        for count in counts:
            run = runs[count] = _started(count, 64, 1, workers)
            record.say(
                f"{count:7d} {1e3 * run.seconds / count:10.2f} {run.client_bytes / MB:13.1f} "
                f"{run.worker_bytes / MB:13.1f} {run.state_bytes / MB:12.2f}"
            )
        few, many = runs[counts[0]], runs[counts[-1]]
        name = f"{counts[-1]} images, {workers} worker{'s' * (workers > 1)}"
        for what, most, least in (
            ("client", many.client_bytes, few.client_bytes),
            ("worker", many.worker_bytes, few.worker_bytes),
        ):
            if least:
                record.figure(
                    f"memory of the {what} at {name}",
                    most / MB,
                    "MB",
                    f"{counts[0]} images",
                    least / MB,
                )
        grown = (many.state_bytes - few.state_bytes) / (counts[-1] - counts[0])
        record.figure(f"state for each image and model, {name}", grown, "bytes")


def _by_size(record: Recorder) -> None:
    """Time by pixels and by models."""
    count = record.pick(1000, 200)
    for side in record.pick((64, 128, 256, 512), (64, 256)):
        run = _started(count, side, 1, 1)
        record.figure(f"an image of {side} x {side} px", 1e3 * run.seconds / count, "ms")
    for models in (1, 2, 3):
        run = _started(count, 256, models, 1)
        took_ms = 1e3 * run.seconds / count
        record.figure(f"an image of 256 x 256 px, {models} models", took_ms, "ms")
        record.figure(f"state, {models} models", run.state_bytes / MB, "MB")


def _by_growth(record: Recorder) -> None:
    """Photographs that are measured when some came to those of an earlier run."""
    pairs = ((127, 129), (1000, 1030), (4095, 4097), (8191, 8200))
    for before, after in record.pick(pairs, pairs[:2]):
        with TemporaryDirectory() as name:
            folder = Path(name)
            scene_files(folder / "photographs", after, 64)
            paths = sorted((folder / "photographs").iterdir())
            work = ArtefactWork(plan=PLAN, load=load_scene, folder=folder / "state")
            for some in (paths[:before], paths):
                with Manifest(some, work.state) as manifest:
                    summary, _ = run_sweep(manifest, work)
        measured = summary.images - summary.found_done
        record.figure(f"measured when {before} photographs become {after}", measured, "photographs")


def _started(count: int, side_px: int, models: int, workers: int) -> _Run:
    with TemporaryDirectory() as folder:
        return apart(_one_run, Path(folder), count, side_px, models, workers)


def _one_run(folder: Path, count: int, side_px: int, models: int, workers: int) -> _Run:
    """Sweep and compute the curves; Dask is imported before the memory is measured."""
    import analysis.sweep.cluster  # noqa: F401

    scene_files(folder / "photographs", count, side_px)
    plan = replace(PLAN, models=MODELS[:models])
    work = ArtefactWork(plan=plan, load=load_scene, folder=folder / "state")
    gc.collect()
    before_bytes = memory_bytes("VmRSS")
    start_s = time.perf_counter()
    with Manifest((folder / "photographs").iterdir(), work.state) as manifest:
        _, records = run_sweep(manifest, work, SweepOptions(workers=workers))
        records.tidy()
        sums = SweepSums(records)
        curves_of(sums.artefacts, sums.images, plan, TASK)
    seconds = time.perf_counter() - start_s
    noted = [
        [int(word) for word in path.read_text().split()]
        for path in (folder / "memory").iterdir()
        if workers > 1 and len(path.read_text().split()) == 2
    ]
    return _Run(
        seconds=seconds,
        client_bytes=memory_bytes("VmHWM") - before_bytes,
        worker_bytes=max((most - first for first, most in noted), default=0),
        state_bytes=sum(path.stat().st_size for path in work.state.iterdir()),
    )


@benchmark("numpy", "distributed")
def main(record: Recorder) -> None:
    _by_images(record)
    _by_size(record)
    _by_growth(record)
