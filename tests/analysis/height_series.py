"""Height series of a texture in closed form, with one capture that is not as it should be."""

from collections.abc import Mapping
from math import sqrt
from pathlib import Path

import numpy as np

from acquisition.averaging import AveragedFrames
from acquisition.session import Take
from acquisition.session._reader import Session
from calibration.noise import LevelNoise
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from tests.acquisition.fakes import SETTINGS, FakeUtc
from tests.acquisition.session_fixtures import plan_of, writer
from tests.calibration.edge_session import averaged
from tests.simulation.closed_form import photograph, random_scene

OPTICAL_SIGMA_PX = 0.6
PSF = GaussianPsf(
    sigma_x_px=sqrt(OPTICAL_SIGMA_PX**2 + 1 / 12), sigma_y_px=sqrt(OPTICAL_SIGMA_PX**2 + 1 / 12)
)
HEIGHTS_MM = (100.0, 120.0, 150.0, 190.0)
SHAPE = (120, 160)
LARGE_SHAPE = (150, 200)
"""Of which also mutual information ranks the models by their physics."""
SCENE_PX = 460.0
ITEMS = 420
NOISE = LevelNoise(offset_dn2=1.0, slope_dn=0.01, floor_dn2=1.0)


def texture_dn(
    zoom: float, seed: int = 3, shift_px: float = 0.0, shape: tuple[int, int] = SHAPE
) -> FloatArray:
    """The texture about its middle; ``shift_px`` moves the camera along x, in its own pixels."""
    origin = (-shape[0] * zoom / 2, (-shape[1] / 2 + shift_px) * zoom)
    scene = random_scene(seed, SCENE_PX, ITEMS)
    return 8.0 * photograph(scene, shape, zoom, OPTICAL_SIGMA_PX, origin)


def shaken(
    zoom: float, step_px: float, rng: np.random.Generator, shape: tuple[int, int]
) -> AveragedFrames:
    """Ten frames, the camera ``step_px`` further from the sixth on."""
    still, moved = (texture_dn(zoom, shift_px=shift, shape=shape) for shift in (0.0, step_px))
    clean = np.stack([still] * 5 + [moved] * 5)
    frames = clean + rng.normal(size=clean.shape) * np.sqrt(NOISE.variance_dn2(clean))
    levels = averaged(still, rng, NOISE)
    return AveragedFrames(
        mean_dn=frames.mean(axis=0).astype(np.float32),
        variance_dn2=frames.var(axis=0, ddof=1).astype(np.float32),
        frames_used=10,
        incomplete_frames=0,
        resent_packets=0,
        saturated_pixels=0,
        min_dn=levels.min_dn,
        max_dn=levels.max_dn,
        first_timestamp_ns=1,
        last_timestamp_ns=2,
    )


def height_series(
    path: Path,
    *,
    other_target_at: float | None = None,
    shaken_at: Mapping[float, float] | None = None,
    heights_mm: tuple[float, ...] = HEIGHTS_MM,
    height_errors_mm: Mapping[float, float] | None = None,
    shape: tuple[int, int] = SHAPE,
) -> Session:
    """A session of one texture.

    Parameters
    ----------
    path
        Where it is written.
    other_target_at
        Height at which another texture lay there.
    shaken_at
        Height and px by which the camera moved in mid-average.
    heights_mm
        Of the captures; the entrance pupil is at 0.
    height_errors_mm
        Height and by how much the camera truly was above it.
    shape
        Of the photographs, ``(rows, cols)``.
    """
    rng = np.random.default_rng(4)
    plan = plan_of(heights_mm=list(heights_mm), targets=[{"kind": "texture", "target": "leaves"}])
    now = FakeUtc()
    with writer(path, plan=plan) as session:
        for entry in session.entries:
            above_mm = (height_errors_mm or {}).get(entry.height_mm, 0.0)
            zoom = (entry.height_mm + above_mm) / heights_mm[0]
            step_px = (shaken_at or {}).get(entry.height_mm)
            seed = 77 if entry.height_mm == other_target_at else 3
            if step_px is None:
                frames = averaged(texture_dn(zoom, seed, shape=shape), rng, NOISE)
            else:
                frames = shaken(zoom, step_px, rng, shape)
            session.add_capture(
                entry,
                Take(
                    averaged=frames,
                    settings=SETTINGS,
                    height_mm=entry.height_mm,
                    focus_value=0.5,
                    started=now(),
                    finished=now(),
                ),
            )
    return Session(path)
