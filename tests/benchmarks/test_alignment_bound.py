"""The Cramer-Rao bound of the alignment's benchmark, beside a closed form."""

from math import pi, sin, sqrt

import numpy as np
import pytest

from benchmarks.studies.alignment import BORDER_PX, Case
from benchmarks.truth.pairs import FlatScene, Pair, PairPose

FRAME = (203, 263)
FREQUENCY = 2 * pi / 8  # rad/px
AMPLITUDE_DN = 20.0
NOISE_DN = 1.5


@pytest.mark.parametrize("bits", [8, 12])
def test_the_bound_of_crossed_waves_is_that_of_eight_equal_parameters(bits: int) -> None:
    # The slopes g of a wave along x plus one along y are uncorrelated and alike everywhere, so that
    # the information is <g^2> / variance times the sum of flow flow^T, and the mean of
    # flow^T covariance flow is 8 variance / (<g^2> n), whatever the 8 motions.
    rows, cols = FRAME
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    waves = 100 + AMPLITUDE_DN * (np.cos(FREQUENCY * x) + np.cos(FREQUENCY * y))
    flat = FlatScene(name="waves", coefficients=waves.astype(np.float32), origin_px=(0.0, 0.0))
    pair = Pair(scene=flat, pose=PairPose(), reference_dn=waves, followup_dn=waves)
    case = Case(
        kind="waves",
        pair=pair,
        contrast_dn=AMPLITUDE_DN,
        noise_dn=NOISE_DN,
        bits=bits,
        reference=waves,
        followup=waves,
    )
    # Central differences attenuate the slope by sin(k) / k; both photographs have the noise.
    square = (AMPLITUDE_DN * sin(FREQUENCY)) ** 2 / 2
    variance = 2 * (NOISE_DN**2 + (1 / 12 if bits == 8 else 0))
    number = (rows - 2 * BORDER_PX) * (cols - 2 * BORDER_PX)
    expected = sqrt(8 * variance / (square * number))
    # 2 %: some 25 and 32 periods of each wave, and the gain's small share in the slopes.
    assert case.bound_px() == pytest.approx(expected, rel=0.02)
