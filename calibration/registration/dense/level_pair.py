"""Two photographs at one resolution near a pose: samples of the coarser one and what it sees.

Both are smoothed to one resolution, so that neither has to be the sharper one.
"""

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from calibration.registration.dense.photograph import AlignedPhotograph, blur_variance_px2
from calibration.registration.distorted_pose import DistortedPose
from simulation import GaussianPsf
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray

ASSUMED_SIGMA_PX = 0.65
"""Total PSF if none is given: a wrong width blurs every detail symmetrically and moves nothing."""

BLOCK_PX = 24
"""Side of the blocks between which, but not within which, residuals count as independent."""

_SMOOTHING_PX = 1.0
"""Of both photographs, in pixels of the coarser one: it suppresses what the coarser one aliases."""

_BORDER_PX = 3.0
_STRIDE_PX = 6.0
"""Pixels to a sample, beyond which a small overlap is sampled more closely: correlated noise leaves
about 4 pi smoothing^2 pixels to one that is independent, and detail more."""

_FLAT = 1e-3
"""Of the rms slope, below which samples of a drawing are flat: 9 of 10 of all agree to the bit, and
say nothing of the scatter of the others."""

_AROUND = 0.25
"""Of the source's size: how far outside it samples may lie, as the pose is approximate."""


class LevelPair:
    """Two photographs brought to one resolution near a pose.

    Parameters
    ----------
    photographs
        The finer one, the source, and the coarser one, the target.
    pose
        Approximate, target to source.
    psf
        Total PSF of the camera.
    factor
        Pixels of the target that are averaged along each axis.
    samples
        Most pixels to compare; with the smoothing, neighbours tell hardly anything new.

    ``scatters`` are the samples whose residuals tell how large residuals are.
    """

    def __init__(
        self,
        photographs: tuple[AlignedPhotograph, AlignedPhotograph],
        pose: DistortedPose,
        psf: GaussianPsf | None,
        factor: int,
        samples: int,
    ) -> None:
        source, target = photographs
        self.factor = factor
        self.target_shape = target.shape
        self._source_factor = factor * 2 ** int(np.log2(max(pose.zoom, 1.0) + 1e-9))
        far = target.reduced(factor).smoothed(_SMOOTHING_PX, _SMOOTHING_PX)
        near = source.reduced(self._source_factor)
        near = near.smoothed(*_missing_blur_px(pose, psf, factor, self._source_factor))
        self._coefficients = spline_filter(near.levels, order=3, output=np.float32, mode="reflect")
        self._near_usable = near.usable
        y, x = _samples(far, samples, pose.overlap)
        places = ((at.astype(np.float64) + 0.5) * factor - 0.5 for at in (y, x))
        near_source = pose.shows(*pose.to_reference_px(*places), margin=_AROUND)
        y, x = y[near_source], x[near_source]
        self.measured = far.levels[y, x].astype(np.float64)
        self.slope_y, self.slope_x = (_slopes(far.levels, axis)[y, x] / factor for axis in (0, 1))
        square = self.slope_y**2 + self.slope_x**2
        self.scatters: BoolArray = np.ones(len(square), dtype=np.bool_)
        if target.is_drawing and len(square):
            self.scatters = square > _FLAT**2 * square.mean()
        self.y_px, self.x_px = ((at.astype(np.float64) + 0.5) * factor - 0.5 for at in (y, x))
        v, u = (
            (at - (n - 1) / 2) / (max(target.shape) / 2)
            for at, n in zip((self.y_px, self.x_px), target.shape, strict=True)
        )
        self._shades = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v])
        self.block: IntArray = (y // BLOCK_PX) * (far.shape[1] // BLOCK_PX + 1) + x // BLOCK_PX
        self.is_odd_block: BoolArray = (y // BLOCK_PX + x // BLOCK_PX) % 2 == 1

    def seen(self, pose: DistortedPose) -> tuple[FloatArray, BoolArray]:
        """The source's levels at the samples by a pose, and which samples it shows."""
        return self._seen_at(*pose.to_reference_px(self.y_px, self.x_px))

    def _seen_at(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, BoolArray]:
        y, x = ((at + 0.5) / self._source_factor - 0.5 for at in (y_px, x_px))
        rows, cols = self._coefficients.shape
        inside = (
            (y >= _BORDER_PX)
            & (y <= rows - 1 - _BORDER_PX)
            & (x >= _BORDER_PX)
            & (x <= cols - 1 - _BORDER_PX)
        )
        if self._near_usable is not None:
            nearest = (np.rint(y[inside]).astype(int), np.rint(x[inside]).astype(int))
            inside[inside] = self._near_usable[nearest]
        levels = np.zeros(len(y))
        levels[inside] = map_coordinates(
            self._coefficients, [y[inside], x[inside]], order=3, mode="reflect", prefilter=False
        )
        return levels, inside

    def predicted_slopes(self, pose: DistortedPose, gain: float) -> tuple[FloatArray, FloatArray]:
        """Slopes of the prediction along x and y, per target px, shape (n,) each.

        ``gain`` is the first coefficient of ``light_columns``.
        """
        levels, inside = self.seen(pose)
        gain /= float(levels[inside].std()) + 1e-12
        half = self.factor / 2
        made = []
        for dy, dx in ((0.0, half), (half, 0.0)):
            ahead, _ = self._seen_at(*pose.to_reference_px(self.y_px + dy, self.x_px + dx))
            behind, _ = self._seen_at(*pose.to_reference_px(self.y_px - dy, self.x_px - dx))
            made.append(gain * (ahead - behind) / self.factor)
        return made[0], made[1]

    def light_columns(self, levels: FloatArray, inside: BoolArray) -> FloatArray:
        """What the source's levels become in the target's light, shape (n, 14).

        Gain and offset that vary as quadratics over the frame, gain first, and a cubic tone curve.
        Each column is contiguous.
        """
        seen = levels[inside]
        centred = (levels - seen.mean()) / (seen.std() + 1e-12)
        count = len(self._shades)
        columns = np.empty((2 * count + 2, len(levels)))
        np.multiply(self._shades, centred, out=columns[:count])
        columns[count:-2] = self._shades
        np.square(centred, out=columns[-2])
        # numpy's third power takes twenty times as long.
        np.multiply(columns[-2], centred, out=columns[-1])
        return columns.T


def _samples(far: AlignedPhotograph, most: int, overlap: float) -> tuple[IntArray, IntArray]:
    """Rows and columns of usable pixels, evenly over the frame; more where less is in common."""
    rows, cols = far.shape
    stride = max(rows * cols / most, 1.0)
    stride = max(stride * overlap, min(stride, _STRIDE_PX))
    # Every so many pixels in reading order; a stride that is no divisor of the width spreads them.
    chosen = np.floor(np.arange(int(rows * cols / stride)) * stride).astype(np.int64)
    y, x = np.divmod(chosen, cols)
    kept = (y >= 2) & (y < rows - 2) & (x >= 2) & (x < cols - 2)
    if far.usable is not None:
        kept &= far.usable[y, x]
    return y[kept], x[kept]


def _slopes(levels: Float32Array, axis: int) -> Float32Array:
    kernel = np.array([[-0.5, 0.0, 0.5]], dtype=np.float32)
    return np.asarray(
        cv2.filter2D(levels, cv2.CV_32F, kernel if axis == 1 else kernel.T), dtype=np.float32
    )


def _missing_blur_px(
    pose: DistortedPose, psf: GaussianPsf | None, factor: int, source_factor: int
) -> tuple[float, float]:
    """Blur along x and y that gives the reduced source the smoothed target's resolution."""
    sigmas = (ASSUMED_SIGMA_PX,) * 2 if psf is None else (psf.sigma_x_px, psf.sigma_y_px)
    far = np.diag([blur_variance_px2(one, factor) + _SMOOTHING_PX**2 for one in sigmas])
    own = np.array([blur_variance_px2(one, source_factor) for one in sigmas])
    rows, cols = pose.followup_shape
    y, x = (
        np.array([rows - 1.0, rows, rows - 1.0]) / 2,
        np.array([cols - 1.0, cols - 1.0, cols]) / 2,
    )
    to_y, to_x = pose.to_reference_px(y, x)
    slopes = 2 * np.array(
        [[to_x[2] - to_x[0], to_x[1] - to_x[0]], [to_y[2] - to_y[0], to_y[1] - to_y[0]]]
    )
    slopes *= factor / source_factor
    missing = np.diag(slopes @ far @ slopes.T) - own
    sigma_x, sigma_y = np.sqrt(np.maximum(missing, 0.0)).tolist()
    return sigma_x, sigma_y
