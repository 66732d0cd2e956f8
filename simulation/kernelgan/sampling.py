"""Zoom-out with a given blur kernel, as after a KernelGAN training.

``exact`` samples the quintic spline through the blurred pixels at the follow-up's grid, relative
to the kernel's centre of mass: patches look the same wherever they are, so KernelGAN cannot know
the shift, and that of its kernel is removed. ``nearest`` takes the blurred pixel nearest to the
grid and the kernel as it is, as in the publication: the image shifts by the centre of mass, and
every pixel by up to 0.5 px; by exactly 0.5 px at zoom 2.
"""

import numpy as np

from simulation.arrays import FloatArray
from simulation.choices import SAMPLERS, Sampler
from simulation.kernelgan.estimate import EstimatedKernel
from simulation.resampling import (
    BandedMatrix,
    BlurCovariance,
    SamplingGrid,
    blur,
    gaussian_terms,
    spline_sampling,
)
from simulation.zoom import SeparableSum, ZoomOperator

_FAINT_TERM = 1e-6
"""Singular values below this fraction of the first are omitted."""

_PREFILTER_TOLERANCE = 1e-6


def kernel_operator(
    shape: tuple[int, int],
    grid: SamplingGrid,
    kernel: EstimatedKernel,
    sampler: Sampler = "exact",
) -> ZoomOperator:
    """Operator that blurs with a kernel and samples on a grid.

    Parameters
    ----------
    shape
        ``(rows, cols)`` of the references.
    grid
        Pixels of the follow-up; ``SamplingGrid.centred`` with ``nearest`` and a size that the
        zoom divides gives the pixels ``floor((i + 0.5) zoom)``.
    kernel
        Correlation kernel.
    sampler
        One of ``SAMPLERS``.

    Raises
    ------
    ValueError
        If the sampler is unknown.
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
