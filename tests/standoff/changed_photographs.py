"""Photographs of a scene in closed form with sixteen changes, for the commands that compare."""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import tifffile

from simulation.arrays import FloatArray
from tests.analysis.blob_scene import blobs, photograph

NEAR, FAR, ZOOM, PSF_PX, SHIFT_PX = (270, 330), (170, 210), 1.5, 0.9, 2.3
NOISE_DN = 1.5
CHANGE_SIGMA_PX = 2.0
LIGHT = 1.05 + 0.1 * np.linspace(-1, 1, FAR[1])[None, :]


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """Two photographs, and what changed, in the follow-up's levels without its light."""

    reference: FloatArray
    followup: FloatArray
    truth: FloatArray


@lru_cache
def changed_pair(seed: int, contrast_dn: float) -> Pair:
    """Reference, and a follow-up from 1.5 times as far in other light, with sixteen changes."""
    rng = np.random.default_rng(seed)
    scene = blobs(seed, 5000, 240.0)
    places = np.arange(-60.0, 61.0, 40.0)
    change = np.array([[y, x, CHANGE_SIGMA_PX, contrast_dn] for y in places for x in places])
    noiseless = (
        photograph(scene, NEAR, 1.0, PSF_PX),
        photograph(np.vstack([scene, change]), FAR, ZOOM, PSF_PX, SHIFT_PX) * LIGHT,
    )
    reference, followup = (
        image + NOISE_DN * rng.standard_normal(image.shape) for image in noiseless
    )
    truth = photograph(change, FAR, ZOOM, PSF_PX, SHIFT_PX) - 120.0
    return Pair(reference=reference, followup=followup, truth=truth)


def write_levels(path: Path, levels: FloatArray) -> Path:
    """Write a float32 TIFF."""
    tifffile.imwrite(path, levels.astype(np.float32))
    return path


def write_psf(path: Path) -> Path:
    """Write the psf.json of these photographs."""
    psf = {"schema": "standoff.psf/1", "sigma_x_px": PSF_PX, "sigma_y_px": PSF_PX, "rho": 0.0}
    path.write_text(json.dumps(psf), encoding="utf-8")
    return path
