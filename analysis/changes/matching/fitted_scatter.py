"""Of what the difference of a matched pair consists, as the fit of its variance says."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from analysis.changes.matching.matching_kernel import WhiteNoiseGain, white_noise_gain
from analysis.changes.matching.pair_fit import PairFit
from analysis.changes.matching.pixels import sampled
from analysis.changes.matching.relative_blur import Smoothing
from analysis.changes.matching.residual_variance import GRADIENT, LAPLACIAN, VarianceTerms
from simulation.arrays import BoolArray, Float32Array

_SAMPLE_PX = 25_000


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedScatter:
    """Noise of a difference, and the shares of its variance that are none.

    Parameters
    ----------
    smoothing
        Of the two photographs.
    gains
        Of white noise in either of them.
    noise_dn2
        Mean variance by noise.
    gradient_share, laplacian_share, detail_share
        Shares of the variance by positions that are wrong, by a blur that is wrong, and by the
        finest detail, as means over the pixels.
    """

    smoothing: Smoothing
    gains: WhiteNoiseGain
    noise_dn2: float
    gradient_share: float
    laplacian_share: float
    detail_share: float

    @classmethod
    def of(
        cls,
        fit: PairFit,
        terms: VarianceTerms,
        floor_dn2: Float32Array | None,
        valid: BoolArray,
        smoothing: Smoothing,
        zoom: float,
    ) -> Self:
        """Read it off a fit, on a sample of the pixels ``valid``."""
        rows, cols = sampled(valid, _SAMPLE_PX)
        parts = fit.sizes[:, None] * terms.at(rows, cols)
        floor = 1e-12 if floor_dn2 is None else floor_dn2[rows, cols].astype(np.float64)
        shares = np.mean(parts / np.maximum(parts.sum(axis=0), floor), axis=1)
        return cls(
            smoothing=smoothing,
            gains=white_noise_gain(fit.kernel.taps, smoothing, zoom),
            noise_dn2=float(np.mean(np.maximum(parts[:GRADIENT].sum(axis=0), floor))),
            gradient_share=float(shares[GRADIENT]),
            laplacian_share=float(shares[LAPLACIAN]),
            detail_share=float(shares[LAPLACIAN + 1 : LAPLACIAN + 3].sum()),
        )
