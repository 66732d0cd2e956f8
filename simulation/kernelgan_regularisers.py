"""What the publication asks of a kernel beside deceiving the discriminator (section 4.3)."""

import torch
from torch import Tensor

__all__ = ["KernelRegulariser", "boundary_mask"]

_SUM_WEIGHT = 0.5  # alpha
_BOUNDARY_WEIGHT = 0.5  # beta
_SPARSE_WEIGHT = 5.0  # gamma
_CENTRE_WEIGHT = 1.0  # delta
_ROOT_FLOOR = 1e-6
"""Below it the square root of the sparsity term has no useful slope."""

_BOUNDARY_GROWTH_PX = 2.0


def boundary_mask(size: int, dtype: torch.dtype) -> Tensor:
    """Return weights that grow exponentially with the distance from the middle, up to 1.

    The publication gives no rate: e-fold in 2 px, 0 in the middle.
    """
    offset = torch.arange(size, dtype=dtype) - size // 2
    distance_px = torch.hypot(offset[:, None], offset[None, :])
    grown = torch.expm1(distance_px / _BOUNDARY_GROWTH_PX)
    return grown / grown.max()


class KernelRegulariser:
    """Sum of 1, nothing at the boundary, few weights, centre of mass in the middle."""

    def __init__(self, size: int, dtype: torch.dtype) -> None:
        self._mask = boundary_mask(size, dtype)
        self._offset = torch.arange(size, dtype=dtype) - size // 2

    def __call__(self, kernel: Tensor) -> Tensor:
        """Return the penalty of a kernel, one differentiable number."""
        total = kernel.sum()
        centre_y = (kernel.sum(dim=1) * self._offset).sum() / total
        centre_x = (kernel.sum(dim=0) * self._offset).sum() / total
        size = kernel.abs()
        return (
            _SUM_WEIGHT * (1 - total).abs()
            + _BOUNDARY_WEIGHT * (size * self._mask).sum()
            + _SPARSE_WEIGHT * ((size + _ROOT_FLOOR) ** 0.5).mean()
            + _CENTRE_WEIGHT * (centre_y**2 + centre_x**2 + _ROOT_FLOOR) ** 0.5
        )
