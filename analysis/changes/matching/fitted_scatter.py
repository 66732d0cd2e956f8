"""Of what the difference of a matched pair consists: noise, displacement, and other structure."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from analysis.changes.matching.matching_kernel import WhiteNoiseGain
from analysis.changes.matching.pair_fit import PairFit
from analysis.changes.matching.pixels import pixel_noise_dn, sampled
from analysis.changes.matching.residual_variance import GRADIENT, LAPLACIAN, VarianceTerms
from simulation.arrays import BoolArray, Float32Array

_SAMPLE_PX = 25_000


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedScatter:
    """Noise of a difference, and the shares of its variance that are none.

    Parameters
    ----------
    gains
        Of white noise in either photograph.
    noise_dn2
        Mean variance by noise.
    white_dn2
        The part of it that the noise of single pixels explains. Compression and resampling take the
        finest noise away, and what they leave is alike in neighbours.
    structure_share
        Share of the variance by positions, blur and the finest detail.
    displaced
        Variance by positions that are wrong over the variance that was fitted: that of the
        gradient, and what the kernel leaves of a displacement that varies over the frame. Only
        roughly so where it is large.
    """

    gains: WhiteNoiseGain
    noise_dn2: float
    white_dn2: float
    structure_share: float
    displaced: float

    @classmethod
    def of(
        cls,
        fit: PairFit,
        terms: VarianceTerms,
        floor_dn2: Float32Array | None,
        valid: BoolArray,
        gains: WhiteNoiseGain,
        images: tuple[Float32Array, Float32Array],
    ) -> Self:
        """Read it off a fit, on a sample of the pixels ``valid``; ``images`` are the pair's."""
        rows, cols = sampled(valid, _SAMPLE_PX)
        at = terms.at(rows, cols)
        parts = fit.sizes[:, None] * at
        floor = 1e-12 if floor_dn2 is None else floor_dn2[rows, cols].astype(np.float64)
        whole = np.maximum(parts.sum(axis=0), floor)
        shares = np.mean(parts / whole, axis=1)
        # What varies of a displacement is in the kernel to first order; its square is left as blur.
        bent = fit.model.kernel.varying_shift_px2**2 * float(np.mean(at[LAPLACIAN] / whole))
        noise_dn2 = float(np.mean(np.maximum(parts[:GRADIENT].sum(axis=0), floor)))
        source_dn = pixel_noise_dn(images[0])
        target_dn = pixel_noise_dn(images[1], valid)
        white_dn2 = gains.source * source_dn**2 + gains.target * target_dn**2
        return cls(
            gains=gains,
            noise_dn2=noise_dn2,
            white_dn2=min(white_dn2, noise_dn2),
            structure_share=float(shares[GRADIENT : LAPLACIAN + 3].sum()),
            displaced=float(shares[GRADIENT]) + bent,
        )

    @property
    def unexplained_share(self) -> float:
        """Share of the variance that is not white noise."""
        correlated = 1 - self.white_dn2 / max(self.noise_dn2, 1e-30)
        return self.structure_share + (1 - self.structure_share) * correlated

    @property
    def displaced_share(self) -> float:
        """The part of it by positions that are wrong."""
        return min(self.displaced, self.unexplained_share)

    @property
    def unlike_share(self) -> float:
        """The part of it by what is not alike in both photographs: aliasing, compression, blur."""
        return self.unexplained_share - self.displaced_share
