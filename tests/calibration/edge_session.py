"""A capture session on disk with photographs of edges, as a bench would write it."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from acquisition.averaging import AveragedFrames
from acquisition.session import Take
from acquisition.session._reader import Session
from calibration.noise import LevelNoise
from simulation.arrays import FloatArray
from tests.acquisition.fakes import SETTINGS, FakeUtc
from tests.acquisition.session_fixtures import plan_of, writer
from tests.calibration.edge_photographs import clean_photograph

FRAMES = 10
FRAME_NOISE = LevelNoise(offset_dn2=30.0, slope_dn=0.4, floor_dn2=1.0)
"""Noise of a single frame, on the 12-bit levels of ``photograph_dn``."""


def photograph_dn(normal_deg: float) -> FloatArray:
    """An edge from 500 to 3250 DN."""
    return clean_photograph(normal_deg) / 16.0


def averaged(
    clean: FloatArray, rng: np.random.Generator, noise: LevelNoise = FRAME_NOISE
) -> AveragedFrames:
    """Mean and unbiased variance of FRAMES noisy frames of one clean image."""
    spread = np.sqrt(noise.variance_dn2(clean))
    frames = clean + rng.normal(size=(FRAMES, *clean.shape)) * spread
    return AveragedFrames(
        mean_dn=frames.mean(axis=0).astype(np.float32),
        variance_dn2=frames.var(axis=0, ddof=1).astype(np.float32),
        frames_used=FRAMES,
        incomplete_frames=0,
        resent_packets=0,
        saturated_pixels=0,
        min_dn=int(frames.min()),
        max_dn=int(frames.max()),
        first_timestamp_ns=1,
        last_timestamp_ns=2,
    )


def edge_session(path: Path, normals_deg: Iterable[float] = (6.0, 96.0)) -> Session:
    """Edges with these normals at one height, if any, then a flat; 10 frames each."""
    rng = np.random.default_rng(6)
    targets: list[dict[str, object]] = [{"kind": "flat", "target": "paper"}]
    if normals := list(normals_deg):
        targets.insert(0, {"kind": "edge", "target": "Kante", "orientations_deg": normals})
    plan = plan_of(heights_mm=[100.0], targets=targets)
    now = FakeUtc()
    with writer(path, plan=plan) as session:
        for entry in session.entries:
            level = np.full((90, 110), 2000.0)
            clean = photograph_dn(entry.orientation_deg) if entry.kind == "edge" else level
            session.add_capture(
                entry,
                Take(
                    averaged=averaged(clean, rng),
                    settings=SETTINGS,
                    height_mm=entry.height_mm,
                    focus_value=0.5,
                    started=now(),
                    finished=now(),
                ),
            )
    return Session(path)
