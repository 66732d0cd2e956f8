import numpy as np
import pytest

from simulation.pose.prefilter import LEAST_COPIES, QUINTIC_SPLINE, SamplingKernel
from simulation.pose.simulate import weight_table

KERNELS = [QUINTIC_SPLINE, LEAST_COPIES]


@pytest.mark.parametrize("kernel", KERNELS)
def test_weights_are_the_kernel_at_the_distances_of_six_pixels(kernel: SamplingKernel) -> None:
    part = np.linspace(0, 1, 11)
    weights = part[:, None] ** np.arange(6) @ weight_table(np.array(kernel.pieces))
    distances = np.abs(part[:, None] - np.arange(-2, 4))
    piece = np.minimum(distances.astype(int), 2)
    powers = (distances - piece)[..., None] ** np.arange(6)
    expected = (np.array(kernel.pieces)[piece] * powers).sum(axis=-1)
    # Rounding of coefficients written with 15 digits, where two pieces meet.
    np.testing.assert_allclose(weights[:, :6], expected, rtol=0, atol=1e-13)
    assert not weights[:, 6:].any()
