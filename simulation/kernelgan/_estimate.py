"""KernelGAN: the blur of a photograph seen from further away, estimated from it alone.

A generator that can only blur and sample is trained until a discriminator cannot distinguish
small patches of the zoomed-out image from those of the image itself. The blur is then what the
camera would add. This needs no calibration, but textures that recur across scales. Theory,
departures from the publication and figures: ``docs/theory-kernelgan.md``.

Zoom-out with a kernel so found: ``exact`` samples the quintic spline through the blurred pixels at
the follow-up's grid, relative to the kernel's centre of mass: patches look the same wherever they
are, so KernelGAN cannot know the shift, and that of its kernel is removed. ``nearest`` takes the
blurred pixel nearest to the grid and the kernel as it is, as in the publication: the image shifts
by the centre of mass, and every pixel by up to 0.5 px; by exactly 0.5 px at zoom 2.

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
from simulation.choices import KERNEL_MODELS, SAMPLERS, TRAINING_STEPS, KernelModel, Sampler
from simulation.kernelgan._crops import CropPicker, KernelGanError, TorchMissingError
from simulation.resampling import (
    BandedMatrix,
    BlurCovariance,
    blur,
    gaussian_terms,
    spline_sampling,
)
from simulation.sampling_grid import SamplingGrid, refuse_non_finite
from simulation.zoom import SeparableSum, ZoomOperator

Progress = Callable[[int], None]
"""Called with the number of steps completed."""

KERNEL_SIZE = 13
"""Receptive field of layers of 7, 5 and 3 px (publication, section 4.1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KernelGanSettings:
    """What determines a trained kernel, besides the image or its central half."""

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

    The image is grey, shape ``(rows, cols)``, linear in light. On one machine the settings
    determine the kernel; for zoom 1 it is the identity, without training. ``progress`` is called
    with the number of steps completed, about a hundred times. A `KernelGanError` if PyTorch is
    missing, the image is too small or flat, or the training failed.
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
    from simulation.kernelgan._training import train

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


_FAINT_TERM = 1e-6
"""Singular values below this fraction of the first are omitted."""

_PREFILTER_TOLERANCE = 1e-6


def kernel_operator(
    shape: tuple[int, int],
    grid: SamplingGrid,
    kernel: EstimatedKernel,
    sampler: Sampler = "exact",
) -> ZoomOperator:
    """Operator that blurs references of a shape with a kernel and samples on a follow-up's grid.

    ``SamplingGrid.centred`` with ``nearest`` and a size that the zoom divides gives the pixels
    ``floor((i + 0.5) zoom)``.
    """
    if sampler not in SAMPLERS:
        raise ValueError(f"sampler must be one of {', '.join(SAMPLERS)}, got {sampler!r}")
    centre_y, centre_x = kernel.centre_px if sampler == "exact" else (0.0, 0.0)
    u, singular, vt = np.linalg.svd(kernel.weights)
    # Both matrices below convolve: a correlation kernel is reversed.
    return ZoomOperator(
        (
            SeparableSum(
                tuple(
                    (
                        _sampled(value * u[::-1, index], grid.rows_px, centre_y, shape[0], sampler),
                        _sampled(vt[index, ::-1], grid.cols_px, centre_x, shape[1], sampler),
                    )
                    for index, value in enumerate(singular)
                    if value > _FAINT_TERM * singular[0]
                )
            ),
        )
    )


def _sampled(
    kernel: FloatArray, positions_px: FloatArray, centre_px: float, size: int, sampler: Sampler
) -> BandedMatrix:
    if sampler == "exact":
        (prefilter,) = gaussian_terms(
            BlurCovariance(yy_px2=0.0, xx_px2=0.0),
            tail_tolerance=_PREFILTER_TOLERANCE,
            spline_prefilter=True,
        )
        # The correlation at p is centred on p + centre.
        shifted_px = positions_px - centre_px
        return spline_sampling(shifted_px, np.convolve(kernel, prefilter.along_y), size)
    nearest = np.clip(np.floor(positions_px + 0.5).astype(np.int64), 0, size - 1)
    rows = len(nearest)
    taken = BandedMatrix.from_entries(rows, size, np.arange(rows), nearest, np.ones(rows))
    return taken @ blur(kernel, size)
