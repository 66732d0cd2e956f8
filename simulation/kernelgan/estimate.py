"""KernelGAN: the blur of a photograph seen from further away, estimated from it alone.

A generator that can only blur and sample is trained until a discriminator cannot distinguish
small patches of the zoomed-out image from those of the image itself. The blur is then what the
camera would add. This needs no calibration, but textures that recur across scales. Theory,
departures from the publication and figures: ``docs/theory-kernelgan.md``.

References
----------
S. Bell-Kligler, A. Shocher, M. Irani, "Blind Super-Resolution Kernel Estimation using an
Internal-GAN", NeurIPS 2019, arXiv 1909.06581.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from math import isfinite

import numpy as np

from simulation.arrays import AnyArray, FloatArray
from simulation.choices import KERNEL_MODELS, TRAINING_STEPS, KernelModel
from simulation.kernelgan.crops import CropPicker
from simulation.kernelgan.errors import KernelGanError, TorchMissingError
from simulation.resampling import refuse_non_finite

Progress = Callable[[int], None]
"""Called with the number of steps completed."""

KERNEL_SIZE = 13
"""Receptive field of layers of 7, 5 and 3 px (publication, section 4.1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KernelGanSettings:
    """What determines a trained kernel, besides the image.

    ``zoom`` is the zoom-out; ``is_centre_crop`` trains on the central half of the image only.
    """

    zoom: float
    model: KernelModel = "kernelgan"
    steps: int = TRAINING_STEPS
    seed: int = 0
    is_centre_crop: bool = False

    def __post_init__(self) -> None:
        if not (self.zoom >= 1 and isfinite(self.zoom)):
            raise ValueError(f"zoom must be a finite number of at least 1, got {self.zoom}")
        if self.model not in KERNEL_MODELS:
            raise ValueError(f"model must be one of {', '.join(KERNEL_MODELS)}, got {self.model!r}")
        if self.steps < 1:
            raise ValueError(f"steps must be at least 1, got {self.steps}")
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatedKernel:
    """A blur kernel, shape ``(13, 13)``, order (y, x); its weights sum to 1.

    It is a correlation kernel: the blurred pixel at ``p`` is the sum of
    ``weights[i, j] * image[p_y + i - 6, p_x + j - 6]``.
    """

    weights: FloatArray

    def __post_init__(self) -> None:
        if self.weights.shape != (KERNEL_SIZE, KERNEL_SIZE):
            raise ValueError(f"a kernel must have 13 x 13 weights, got {self.weights.shape}")
        # Also refuses NaN.
        if not abs(float(self.weights.sum()) - 1.0) < 1e-6:
            raise ValueError(f"a kernel's weights must sum to 1, got {self.weights.sum()}")

    def __repr__(self) -> str:
        (xx, xy), (_, yy) = self.covariance_px2.tolist()
        return f"EstimatedKernel(covariance {xx=:.4g}, {xy=:.4g}, {yy=:.4g} px^2)"

    @property
    def centre_px(self) -> tuple[float, float]:
        """Centre of mass (y, x) relative to the kernel's middle."""
        offset = np.arange(KERNEL_SIZE) - KERNEL_SIZE // 2
        return float(self.weights.sum(axis=1) @ offset), float(self.weights.sum(axis=0) @ offset)

    @property
    def covariance_px2(self) -> FloatArray:
        """Second moments about the centre of mass, shape (2, 2), order (x, y), in px^2."""
        centre_y, centre_x = self.centre_px
        y = np.arange(KERNEL_SIZE)[:, None] - KERNEL_SIZE // 2 - centre_y
        x = np.arange(KERNEL_SIZE)[None, :] - KERNEL_SIZE // 2 - centre_x
        xx, xy, yy = (float((self.weights * m).sum()) for m in (x * x, x * y, y * y))
        return np.array([[xx, xy], [xy, yy]])


def estimate_kernel(
    image: AnyArray,
    settings: KernelGanSettings,
    progress: Progress | None = None,
) -> EstimatedKernel:
    """Train on one image and return the blur between it and itself ``settings.zoom`` further away.

    Parameters
    ----------
    image
        Grey levels, shape ``(rows, cols)``, linear in light.
    settings
        Zoom-out, model, steps and seed: on one machine they determine the kernel.
    progress
        Called with the number of steps completed, about a hundred times.

    Returns
    -------
    EstimatedKernel
        For zoom 1 the identity kernel, without training.

    Raises
    ------
    TorchMissingError
        If PyTorch is not installed.
    KernelGanError
        If the image is too small or flat, or the training failed.
    ValueError
        If the image is not two-dimensional or not finite.
    """
    if image.ndim != 2:
        raise ValueError(f"KernelGAN needs grey levels (rows, cols), got shape {image.shape}")
    refuse_non_finite(image)
    if settings.zoom == 1:
        weights = np.zeros((KERNEL_SIZE, KERNEL_SIZE))
        weights[KERNEL_SIZE // 2, KERNEL_SIZE // 2] = 1.0
        return EstimatedKernel(weights=weights)
    if find_spec("torch") is None:
        raise TorchMissingError(
            f"model {settings.model} needs PyTorch: pip install standoff[kernelgan]",
            reason="torch_missing",
        )
    trained_on = centre_half(image) if settings.is_centre_crop else image
    levels = trained_on.astype(np.float64)
    span = float(levels.max() - levels.min())
    if span == 0:
        raise KernelGanError(
            "the image is flat, so there is nothing to train on; use another one", reason="flat"
        )
    picker = CropPicker.of_image((levels - levels.min()) / span, settings.zoom, KERNEL_SIZE)
    # Only here: everything else must run without PyTorch.
    from simulation.kernelgan.training import train

    weights = train(
        picker,
        is_gaussian=settings.model == "gaussian-kernelgan",
        zoom=settings.zoom,
        steps=settings.steps,
        seed=settings.seed,
        progress=progress,
    )
    return EstimatedKernel(weights=weights / weights.sum())


def centre_half(image: AnyArray) -> AnyArray:
    """Return the central half of an image along both axes, as a view."""
    (top, rows), (left, cols) = (
        ((size - (size + 1) // 2) // 2, (size + 1) // 2) for size in image.shape[:2]
    )
    return image[top : top + rows, left : left + cols]
