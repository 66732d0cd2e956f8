"""The best linear estimate of a far pixel from a finite window of reference pixels.

The window's covariance is block-Toeplitz and the same from either end, so that the even and the
odd patterns of weights are systems of half the size; where the PSF is the same in the mirror of
either axis, there are four of a quarter.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from simulation.arrays import FloatArray, IntArray
from simulation.zoom_kernels.scene import SeenScene

_Block = tuple[slice, slice]
_Reflection = tuple[_Block, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Parity:
    """One symmetry class of patterns: its pixels, its reflections with their signs, its factor."""

    half: _Block
    reflections: tuple[_Reflection, ...]
    factor: tuple[FloatArray, bool]

    def solved(self, wanted: FloatArray) -> FloatArray:
        """Part of the solution that has this symmetry, shape ``(n, taps_y, taps_x)``."""
        folded = sum(sign * wanted[(slice(None), *mirror)] for mirror, sign in self.reflections)
        part = np.asarray(folded)[(slice(None), *self.half)]
        shape = part.shape
        flat = cho_solve(self.factor, part.reshape(len(part), -1).T, check_finite=False).T
        solution = np.zeros_like(wanted)
        quarter = flat.reshape(shape) / len(self.reflections)
        for mirror, sign in self.reflections:
            solution[(slice(None), *mirror)][(slice(None), *self.half)] = sign * quarter
        return solution


@dataclass(frozen=True, slots=True, eq=False)
class FiniteWindow:
    """The covariance of a window's pixels, factorised.

    Parameters
    ----------
    taps_y, taps_x
        Pixels of the window.
    parities
        Its symmetry classes.
    drifts
        A constant and, where there are pixels for it, a ramp along either axis, shape
        ``(3, taps_y, taps_x)`` or fewer; positions count from the window's centre.
    solved_drifts
        The drifts divided by the covariance.

    References
    ----------
    G. Matheron, "The intrinsic random functions and their applications", 1973 (kriging with a
    drift).
    """

    taps_y: int
    taps_x: int
    parities: tuple[_Parity, ...]
    drifts: FloatArray
    solved_drifts: FloatArray

    @classmethod
    def of(cls, scene: SeenScene, taps_y: int, taps_x: int, ridge: float) -> "FiniteWindow":
        """Factorise a window's covariance plus white noise of ``ridge`` times its variance."""
        parities = tuple(_parities(scene, taps_y, taps_x, ridge))
        y = (np.arange(taps_y) - (taps_y - 1) / 2)[:, None] * np.ones(taps_x)
        x = np.ones(taps_y)[:, None] * (np.arange(taps_x) - (taps_x - 1) / 2)
        ramps = [ramp for ramp, taps in ((y, taps_y), (x, taps_x)) if taps > 1]
        drifts = np.stack([np.ones_like(y), *ramps])
        solved = np.asarray(sum(parity.solved(drifts) for parity in parities))
        return cls(taps_y, taps_x, parities, drifts, solved)

    def weights(self, covariance: FloatArray, y_px: FloatArray, x_px: FloatArray) -> FloatArray:
        """Weights that estimate far pixels: least error of all that keep a constant and a ramp.

        Parameters
        ----------
        covariance
            Of each far pixel with the window's, shape ``(n, taps_y, taps_x)``.
        y_px, x_px
            Positions of the far pixels from the window's centre, shape ``(n,)``.

        Returns
        -------
        ndarray of shape ``(n, taps_y, taps_x)``
        """
        bare = np.asarray(sum(parity.solved(covariance) for parity in self.parities))
        places = [p for p, taps in ((y_px, self.taps_y), (x_px, self.taps_x)) if taps > 1]
        wanted = np.stack([np.ones(len(bare)), *places])
        axes = ([1, 2], [1, 2])
        missing = wanted - np.tensordot(self.drifts, bare, axes)
        gram = np.tensordot(self.drifts, self.solved_drifts, axes)
        factors = np.linalg.solve(gram, missing)
        return np.asarray(bare + np.tensordot(factors.T, self.solved_drifts, 1))


def _parities(scene: SeenScene, taps_y: int, taps_x: int, ridge: float) -> list[_Parity]:
    whole, turned = slice(None), slice(None, None, -1)
    y, x = np.arange(taps_y), np.arange(taps_x)
    half = (slice(taps_y // 2), whole)
    classes: list[tuple[_Reflection, ...]]
    if taps_y % 2 or taps_x % 2:
        # Images smaller than the window: no symmetry is worth the case of a middle pixel.
        half = (whole, whole)
        classes = [(((whole, whole), 1.0),)]
    elif scene.is_mirrored:
        half = (slice(taps_y // 2), slice(taps_x // 2))
        classes = [
            (
                ((whole, whole), 1.0),
                ((turned, whole), up),
                ((whole, turned), left),
                ((turned, turned), up * left),
            )
            for up in (1.0, -1.0)
            for left in (1.0, -1.0)
        ]
    else:
        classes = [(((whole, whole), 1.0), ((turned, turned), sign)) for sign in (1.0, -1.0)]
    pixels = y[half[0]], x[half[1]]
    blocks = [
        _covariances(scene, pixels, (y[mirror[0]][half[0]], x[mirror[1]][half[1]]))
        for mirror, _ in classes[0]
    ]
    parities = []
    for reflections in classes:
        matrix = blocks[0].copy()
        for block, (_, sign) in zip(blocks[1:], reflections[1:], strict=True):
            matrix += sign * block
        matrix[np.diag_indices_from(matrix)] += ridge * scene.variance
        factor = cho_factor(matrix.T, lower=False, overwrite_a=True, check_finite=False)
        parities.append(_Parity(half, reflections, factor))
    return parities


def _covariances(
    scene: SeenScene, one: tuple[IntArray, IntArray], other: tuple[IntArray, IntArray]
) -> FloatArray:
    """Covariance of all pixels of one block with all of another, by rows of the blocks."""
    down = (one[0][:, None] - other[0]) % scene.period_px
    right = (one[1][:, None] - other[1]) % scene.period_px
    values = scene.covariance[down[:, None, :, None], right[None, :, None, :]]
    return np.asarray(values.reshape(len(one[0]) * len(one[1]), -1))
