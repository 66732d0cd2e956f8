"""Trained kernels on disk, so that one image is trained on once for a zoom and its settings.

Each is a ``.npy`` that every tool reads, and a picture of it beside. Both are replaced as a whole:
a training that is interrupted leaves nothing.
"""

import hashlib
import json
import os
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from tokenize import TokenError

import numpy as np
from PIL import Image

from acquisition.session import atomic_write
from analysis.choices import CACHE_VARIABLE
from analysis.design_cache import user_cache_folder
from analysis.errors import ResultsFileError
from simulation.arrays import AnyArray, FloatArray
from simulation.kernelgan import EstimatedKernel, KernelGanSettings

_TRAINING_VERSION = 1
"""Increases when training gives different kernels than before."""

_KEY_DIGITS = 24
_PICTURE_PX_PER_WEIGHT = 16


def default_cache_folder() -> Path:
    """Return the folder of ``STANDOFF_KERNEL_CACHE``, else the user's cache folder (XDG)."""
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named)
    return user_cache_folder() / "kernels"


class KernelCache:
    """A folder of trained kernels; it is created when the first is stored."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, image: AnyArray, settings: KernelGanSettings) -> Path:
        """Return the path of the kernel of an image and settings, whether or not it exists."""
        content = hashlib.sha256()
        stated = {**asdict(settings), "version": _TRAINING_VERSION}
        stated |= {"shape": image.shape, "dtype": image.dtype.str}
        content.update(json.dumps(stated, sort_keys=True).encode())
        content.update(np.ascontiguousarray(image).tobytes())
        return self.folder / f"{settings.model}-{content.hexdigest()[:_KEY_DIGITS]}.npy"

    def load(self, image: AnyArray, settings: KernelGanSettings) -> EstimatedKernel | None:
        """Return a stored kernel; None where there is none, or its file is damaged."""
        path = self.path(image, settings)
        try:
            weights = np.load(path, allow_pickle=False)
            return EstimatedKernel(weights=np.asarray(weights, dtype=np.float64))
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ResultsFileError(
                f"cannot read {path}: {error.strerror or error}", source=str(path)
            ) from error
        except (ValueError, EOFError, SyntaxError, TokenError):
            # It is trained again, and the file replaced.
            return None

    def store(self, image: AnyArray, settings: KernelGanSettings, kernel: EstimatedKernel) -> Path:
        """Store a kernel and its picture; return the path of the ``.npy``."""
        path = self.path(image, settings)
        buffer = BytesIO()
        np.save(buffer, kernel.weights, allow_pickle=False)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            atomic_write(path.with_suffix(".png"), _picture(kernel.weights))
            atomic_write(path, buffer.getvalue())
        except OSError as error:
            raise ResultsFileError(
                f"cannot write {path}: {error.strerror or error}", source=str(path)
            ) from error
        return path


def _picture(weights: FloatArray) -> bytes:
    """Return a PNG of the weights: 0 black, the largest white, negative ones black."""
    levels = np.clip(np.rint(255 * weights / weights.max()), 0, 255).astype(np.uint8)
    magnified = np.kron(levels, np.ones((_PICTURE_PX_PER_WEIGHT,) * 2, dtype=np.uint8))
    buffer = BytesIO()
    Image.fromarray(magnified).save(buffer, format="PNG")
    return buffer.getvalue()
