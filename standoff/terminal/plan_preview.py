"""What a plan will take, shown to the operator before a run and in a dry run."""

import math
import shutil
from pathlib import Path

from acquisition.plan import PlanEstimate
from acquisition.session import SPARE_BYTES


def preview_line(estimate: PlanEstimate, out: Path) -> str:
    """Captures, time and disk use in words."""
    placing = f"{estimate.placements} placements" if estimate.placements != 1 else "1 placement"
    free = _free_bytes(out)
    room = f"{free / 1e6:.0f} MB free"
    if estimate.bytes_ is not None and free < estimate.bytes_ + SPARE_BYTES:
        room += f", which is NOT ENOUGH: {SPARE_BYTES / 1e6:.0f} MB stay free"
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


def _free_bytes(path: Path) -> int:
    there = path.resolve()
    while not there.exists():
        there = there.parent
    return shutil.disk_usage(there).free
