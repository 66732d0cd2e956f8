"""The relative blur that a calibrated camera would show, as `relative_blur` would measure it.

Two transfer functions that are not Gaussian do not differ by a variance. So their ratio is held
against a Gaussian's over the spectrum of the photograph itself, as the measurement does.
"""

import cv2
import numpy as np

from analysis.changes.matching.relative_blur import Smoothing, smoothing_for
from analysis.changes.matching.smoothed_warp import PixelPositions
from simulation import Psf, PsfField
from simulation.arrays import BoolArray, Float32Array, FloatArray

_SIDE_PX = 256
_LEAST_TRANSFER = 1e-3
_HIGHEST_CY_PER_PX = 0.45
_ROUNDS = 5


def calibrated_blur_px2(
    psf: Psf | PsfField,
    seen: Float32Array,
    valid: BoolArray,
    smoothing: Smoothing,
    positions: PixelPositions,
) -> float:
    """Variance by which one camera's target is blurrier than its source, in the target's pixels.

    Parameters
    ----------
    psf
        Total PSF of the camera that took both; a field is taken where both show the middle of what
        they share.
    seen
        The source on the target's pixels, smoothed.
    valid
        Pixels that count.
    smoothing
        Of the two photographs.
    positions
        Where the target's pixels lie in the source.
    """
    rows, cols = np.nonzero(valid)
    row, col = float(rows.mean()), float(cols.mean())
    side = min(_SIDE_PX, *seen.shape)
    top, left = (
        int(np.clip(at - side / 2, 0, n - side))
        for at, n in zip((row, col), seen.shape, strict=True)
    )
    part = (slice(top, top + side), slice(left, left + side))
    level = np.where(valid[part], seen[part] - seen[part][valid[part]].mean(), np.float32(0))
    window = cv2.createHanningWindow((side, side), cv2.CV_32F)
    power = np.abs(np.fft.rfft2(level * window)) ** 2
    fy: FloatArray = np.fft.fftfreq(side)[:, None].astype(np.float64)
    fx: FloatArray = np.fft.rfftfreq(side)[None].astype(np.float64)
    source_row, source_col, slopes = positions.near(row, col)
    # A wave of frequency f in the target has the frequency A^-T f in the source.
    (xx, xy), (yx, yy) = np.linalg.inv(slopes).T.tolist()
    source_psf, target_psf = (
        of.at(x, y) if isinstance(of, PsfField) else of
        for of, x, y in ((psf, source_col, source_row), (psf, col, row))
    )
    source_fx, source_fy = xx * fx + xy * fy, yx * fx + yy * fy
    square = (2 * np.pi) ** 2 * (fx * fx + fy * fy)
    own = target_psf.otf(fx, fy)
    other = source_psf.otf(source_fx, source_fy)
    source_square = (2 * np.pi * positions.zoom) ** 2 * (source_fx**2 + source_fy**2)
    told = (other > _LEAST_TRANSFER) & (np.hypot(fx, fy) < _HIGHEST_CY_PER_PX)
    # Gain and Laplacian, as they are fitted to the photographs.
    columns = np.stack([np.ones_like(square), -square / 2])
    blur_px2 = 0.0
    for _ in range(_ROUNDS):
        made = smoothing_for(blur_px2)
        own_px2, other_px2 = made.target_px**2, made.source_px**2
        ratio = np.divide(own, other, out=np.ones_like(own), where=told)
        ratio *= np.exp((source_square * other_px2 - square * own_px2) / 2)
        # The spectrum is that of the source behind another Gaussian.
        seen_px2 = smoothing.source_px**2
        weight = np.where(told, power * np.exp(source_square * (seen_px2 - other_px2)), 0.0)
        normal = np.einsum("iyx,jyx,yx->ij", columns, columns, weight)
        share = np.einsum("iyx,yx->i", columns, ratio * weight)
        gain, step = np.linalg.lstsq(normal, share, rcond=None)[0].tolist()
        blur_px2 = other_px2 - own_px2 + step / gain
    return blur_px2
