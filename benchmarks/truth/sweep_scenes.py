"""Synthetic photographs of a sweep: empty files whose names say what is in them."""

import hashlib
import os
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from analysis.detectability import Scenario, SceneImage, SweepPlan
from simulation import GaussianPsf
from simulation.arrays import FloatArray

_TEXTURES = 20
_NOTED_EVERY = 50

PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.9)
PLAN = SweepPlan(
    scenario=Scenario(psf=PSF, window_px=5, positions=1),
    models=("bicubic",),
    zooms=(1.5,),
    tiles_per_side=1,
)
"""One cheap model, one zoom, a small window."""


def scene_files(folder: Path, count: int, side_px: int) -> None:
    """Write the names of so many photographs."""
    folder.mkdir()
    for number in range(count):
        (folder / f"{number:07d}-{side_px}.png").touch()


def load_scene(path: Path) -> SceneImage:
    """Return the photograph of a name; every process notes its memory beside the folder."""
    number, side = path.stem.split("-")
    _note_memory(path.parent.parent / "memory", int(side))
    # Rough as surfaces are, and quick: one of twenty textures, shifted and brightened.
    shift = int(number) % 61
    texture = np.roll(_texture(int(number) % _TEXTURES, int(side)), (shift, 7 * shift), axis=(0, 1))
    digest = hashlib.sha256(path.name.encode()).hexdigest()
    return SceneImage(grey_dn=texture + int(number) % 7, sha256=digest)


def memory_bytes(field: str, process: int | str = "self") -> int:
    """Return a field of the process's status: VmRSS now, VmHWM at its most."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == field:
            return int(value.split()[0]) * 1024
    raise ValueError(f"the status of a process has no {field}")


@lru_cache(maxsize=_TEXTURES)
def _texture(number: int, side_px: int) -> FloatArray:
    rough = np.random.default_rng(number).standard_normal((side_px, side_px))
    return np.asarray(120 + 150 * cv2.GaussianBlur(rough, (0, 0), 1.2), np.float64)


_calls = 0
_first_bytes = 0


def _note_memory(folder: Path, side_px: int) -> None:
    """Keep this process's memory before its first photograph, and at its most since."""
    global _calls, _first_bytes
    if _calls == 0:
        for number in range(_TEXTURES):
            _texture(number, side_px)
        _first_bytes = memory_bytes("VmRSS")
    if _calls % _NOTED_EVERY == 0:
        folder.mkdir(exist_ok=True)
        (folder / str(os.getpid())).write_text(f"{_first_bytes} {memory_bytes('VmHWM')}")
    _calls += 1
