"""What a plan will take: time at the bench and room on the disk."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from acquisition.bench import BenchConfig
from acquisition.plan import CapturePlan, PlanEntry

__all__ = ["PlanEstimate", "bytes_per_pixel", "estimate_plan"]

RAMP_S = 0.3
"""Speeding up and slowing down of one move."""

OVERHEAD_S = 0.25
"""Starting and stopping the stream, reading the stage twice, storing the capture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanEstimate:
    """Captures, placements by the operator, seconds without them, and bytes.

    ``bytes_`` is None where the size of a frame is not known.
    """

    captures: int
    placements: int
    seconds: float
    bytes_: int | None


def bytes_per_pixel(frames: int, *, keep_frames: bool) -> int:
    """Bytes that a capture stores for each pixel: mean and variance, and the raw frames."""
    return 2 * 4 + (2 * frames if keep_frames else 0)


def estimate_plan(
    plan: CapturePlan,
    entries: Sequence[PlanEntry],
    bench: BenchConfig,
    frame_shape: tuple[int, int] | None,
) -> PlanEstimate:
    """Estimate what it takes to capture the entries, from the middle of the travel on.

    Parameters
    ----------
    entries
        Those of the plan that are to be captured, in order.
    frame_shape
        ``(rows, cols)`` of a frame, if known.
    """
    frames = plan.frames_per_capture or bench.capture.frames_per_capture
    stage = bench.stage
    height_mm = math.fsum(stage.limits_mm) / 2
    seconds = 0.0
    placements = 0
    placed: tuple[str, str, float] | None = None
    approached: float | None = None
    for entry in entries:
        if entry.placement != placed:
            placed, approached = entry.placement, None
            placements += 1
        if entry.height_mm != approached:
            travel_mm = abs(entry.height_mm - height_mm)
            is_wrong_side = (entry.height_mm < height_mm) == (stage.approach == "from_below")
            travel_mm += 2 * stage.backlash_mm * is_wrong_side
            seconds += RAMP_S + 60 * travel_mm / stage.feed_mm_per_min
            seconds += stage.settle_s + plan.settle_s
            height_mm = approached = entry.height_mm
        exposure_s = 1e-6 * (entry.exposure_us or bench.camera.exposure_us)
        period_s = max(1 / bench.camera.frame_rate_hz, exposure_s)
        seconds += OVERHEAD_S + (frames + 1) * period_s
    size = None
    if frame_shape is not None:
        per_capture = math.prod(frame_shape) * bytes_per_pixel(frames, keep_frames=plan.keep_frames)
        size = len(entries) * per_capture
    return PlanEstimate(captures=len(entries), placements=placements, seconds=seconds, bytes_=size)
