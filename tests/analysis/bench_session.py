"""A session as a bench writes it: edges and a texture at three heights, in closed form."""

from collections.abc import Callable
from math import sqrt
from pathlib import Path

import numpy as np

from acquisition.averaging import AveragedFrames
from acquisition.plan import CapturePlan, PlanEntry
from acquisition.session import Take
from acquisition.session._reader import Session
from calibration.noise import LevelNoise
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from tests.acquisition.fakes import SETTINGS, FakeUtc
from tests.acquisition.session_fixtures import plan_of, writer
from tests.calibration.edge_photographs import EIGHT_NORMALS_DEG
from tests.calibration.edge_session import averaged, photograph_dn
from tests.simulation.closed_form import photograph, random_scene

OPTICAL_SIGMA_PX = 0.6
PSF = GaussianPsf(
    sigma_x_px=sqrt(OPTICAL_SIGMA_PX**2 + 1 / 12), sigma_y_px=sqrt(OPTICAL_SIGMA_PX**2 + 1 / 12)
)
HEIGHTS_MM = (100.0, 150.0, 200.0)
SHAPE = (300, 390)
CHART_SHAPE = (120, 160)
SCENE_PX = 900.0
TEXTURE_SEED = 3
LOW_NOISE = LevelNoise(offset_dn2=1.0, slope_dn=0.01, floor_dn2=1.0)
"""Of the texture's frames: where noise prevails, the model that blurs most has the least error."""


def texture_dn(zoom: float, seed: int = TEXTURE_SEED, shape: tuple[int, int] = SHAPE) -> FloatArray:
    """A texture from ``zoom`` times the nearest distance: the whole frame shows it, 12 bit."""
    return 8.0 * photograph(random_scene(seed, SCENE_PX, 900), shape, zoom, OPTICAL_SIGMA_PX)


def bench_session(path: Path, target: str = "leaves") -> Session:
    """Edges in eight directions and one texture, each at three heights: 27 captures."""
    rng = np.random.default_rng(9)
    plan = plan_of(
        heights_mm=list(HEIGHTS_MM),
        targets=[
            {"kind": "edge", "target": "Kante", "orientations_deg": list(EIGHT_NORMALS_DEG)},
            {"kind": "texture", "target": target},
        ],
    )

    def frames(entry: PlanEntry) -> AveragedFrames:
        if entry.kind == "edge":
            return averaged(photograph_dn(entry.orientation_deg), rng)
        return averaged(texture_dn(entry.height_mm / HEIGHTS_MM[0]), rng, LOW_NOISE)

    return _captured(path, plan, frames, above_mm=0.002)


def chart_session(path: Path, *seeds: int) -> Session:
    """Captures of a chart, one height further away each; another seed is another chart."""
    rng = np.random.default_rng(1)
    heights = [100.0 * 1.25**k for k in range(len(seeds))]
    plan = plan_of(heights_mm=heights, targets=[{"kind": "chart", "target": "mixed"}])

    def frames(entry: PlanEntry) -> AveragedFrames:
        return averaged(texture_dn(entry.height_mm / 100.0, seeds[entry.index], CHART_SHAPE), rng)

    return _captured(path, plan, frames)


def _captured(
    path: Path,
    plan: CapturePlan,
    frames: Callable[[PlanEntry], AveragedFrames],
    above_mm: float = 0.0,
) -> Session:
    now = FakeUtc()
    with writer(path, plan=plan) as session:
        for entry in session.entries:
            session.add_capture(
                entry,
                Take(
                    averaged=frames(entry),
                    settings=SETTINGS,
                    height_mm=entry.height_mm + above_mm,
                    focus_value=0.5,
                    started=now(),
                    finished=now(),
                ),
            )
    return Session(path)
