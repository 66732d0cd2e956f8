"""What a plan will take, shown to the operator before a run and in a dry run."""

import math
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from acquisition.bench import BenchConfig
from acquisition.capture import flicker_fraction, without_flicker
from acquisition.plan import CapturePlan, PlanEntry, PlanEstimate

FLICKER_LIMIT = 0.01


def frame_shape_of(bench: BenchConfig) -> tuple[int, int] | None:
    """Rows and columns of a frame, or None if the bench file does not say."""
    if bench.camera.region_px is not None:
        return bench.camera.region_px[3], bench.camera.region_px[2]
    if bench.camera.driver == "simulated" and bench.simulated is not None:
        return bench.simulated.height_px, bench.simulated.width_px
    return None


def preview_line(estimate: PlanEstimate, out: Path) -> str:
    """Captures, time and disk use in words."""
    placing = f"{estimate.placements} placements" if estimate.placements != 1 else "1 placement"
    room = f"{_free_bytes(out) / 1e6:.0f} MB free"
    if estimate.bytes_ is None:
        disk = f"disk use depends on the camera's frame ({room})"
    else:
        disk = f"{estimate.bytes_ / 1e6:.0f} MB on disk ({room})"
    return (
        f"{estimate.captures} captures, {placing}: about {time_text(estimate.seconds)} "
        f"plus the operator's own time; {disk}"
    )


def time_text(seconds: float) -> str:
    """A duration in hours, minutes or seconds: ``1 h 05 min``, ``3 min 20 s``, ``7 s``."""
    whole = math.ceil(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"


def flicker_warnings(
    plan: CapturePlan, entries: Sequence[PlanEntry], bench: BenchConfig
) -> Iterator[str]:
    """Warn of exposures that are not a multiple of the light's period, on a real bench."""
    mains_hz = bench.capture.mains_hz
    if bench.camera.driver == "simulated":
        return
    found_later = plan.auto_exposure
    asked_us = {
        # Longer exposures of a bracket are shortened to whole periods.
        entry.exposure_us or bench.camera.exposure_us
        for entry in entries
        if entry.kind != "dark" and (entry.exposure_us is not None or not found_later)
    }
    for exposure_us in sorted(asked_us):
        left = flicker_fraction(exposure_us, mains_hz)
        if left > FLICKER_LIMIT:
            better_us = max(without_flicker(exposure_us, mains_hz), 0.5e6 / mains_hz)
            yield (
                f"an exposure of {exposure_us:g} us is not a multiple of the "
                f"{0.5e3 / mains_hz:.3g} ms flicker period of lamps on {mains_hz} Hz mains, "
                f"and leaves {100 * left:.0f} % of the flicker; use {better_us:.0f} us, "
                "or capture.mains_hz = 0 for steady light"
            )


def _free_bytes(path: Path) -> int:
    there = path.resolve()
    while not there.exists():
        there = there.parent
    return shutil.disk_usage(there).free
