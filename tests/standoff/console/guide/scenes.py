"""Scenes of random texture, and the files that are made of them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from benchmarks.truth.hand_held import HeldPose, Wall

SIZE = (400, 300)


@dataclass(frozen=True, kw_only=True)
class Stills:
    """Files: the reference, one from nearly its pose with a change, and one of another scene."""

    reference: Path
    again: Path
    other: Path


def levels(seed: int) -> NDArray[np.float64]:
    noise = np.random.default_rng(seed).standard_normal((600, 800))
    texture = gaussian_filter(noise, 2) * 8 + gaussian_filter(noise, 8) * 25
    return np.clip(110 + 30 * texture, 0, 235)


def wall(seed: int = 1) -> Wall:
    return Wall.of(levels(seed), SIZE, 0.8)


def save(image: NDArray[np.uint8], path: Path) -> Path:
    Image.fromarray(image).save(path, quality=95)
    return path


def again_pose() -> HeldPose:
    """1 % too far and 1 % of the width aside."""
    return HeldPose(centre=np.array([0.012, 0.0, -0.01]))
