"""Change detectors of other fields on the same pair: a score of every follow-up pixel.

All but one get the true alignment, by a cubic warp; differences are smoothed by 1 px as ours is.
"""

import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from math import pi
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from analysis import detectors
from benchmarks.peers.features import Matching, detector_of, magsac, matches_of
from benchmarks.peers.program import PeerError
from benchmarks.peers.tasks import stretched
from simulation.arrays import BoolArray, FloatArray

WORKER = Path(__file__).with_name("change_worker.py")

SMOOTHING_PX = 1.0
_TIME_LIMIT_S = 300


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AlignedPair:
    """Two photographs with the truth that some peers are given.

    ``warped`` is the reference on the follow-up's pixels by the true pose and in its light, and the
    follow-up itself outside the ``overlap``; noise and width of the PSF are of the warped reference
    and of the follow-up, in follow-up pixels.
    """

    reference: FloatArray = field(repr=False)
    followup: FloatArray = field(repr=False)
    warped: FloatArray = field(repr=False)
    overlap: BoolArray = field(repr=False)
    noise_dn: tuple[float, float]
    blur_px: tuple[float, float]


Peer = Callable[[AlignedPair], FloatArray]
"""Score of every follow-up pixel, the larger the likelier changed."""


def cubic_warp(
    reference: FloatArray, followup: FloatArray, y_px: FloatArray, x_px: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The reference at these places in the follow-up's light, the follow-up beyond; where it is."""
    rows, cols = reference.shape
    inside = (y_px >= 0) & (y_px <= rows - 1) & (x_px >= 0) & (x_px <= cols - 1)
    warped = map_coordinates(reference, [y_px, x_px], order=3, mode="mirror")
    return _in_light(warped, followup, inside), inside


def absolute_difference(pair: AlignedPair) -> FloatArray:
    """Absolute difference behind OpenCV's SIFT and MAGSAC, as it is done everywhere."""
    reference, followup = (stretched(image) for image in (pair.reference, pair.followup))
    matching = Matching()
    matrix = magsac(matches_of(reference, followup, detector_of("sift"), matching), matching)
    size = (pair.followup.shape[1], pair.followup.shape[0])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(
        pair.reference, matrix, size, flags=flags, borderMode=cv2.BORDER_REFLECT_101
    )
    inside = cv2.warpPerspective(np.ones_like(pair.reference), matrix, size, flags=flags) > 0.99
    seen = _in_light(np.asarray(warped, dtype=np.float64), pair.followup, inside)
    return np.abs(gaussian_filter(pair.followup - seen, SMOOTHING_PX))


def _in_light(warped: FloatArray, followup: FloatArray, inside: BoolArray) -> FloatArray:
    """The reference with a gain and an offset by least squares; the follow-up where not inside."""
    if not inside.any():
        raise PeerError("the alignment leaves nothing in common")
    return detectors.in_light_of(followup, warped, inside)


def structural_dissimilarity(pair: AlignedPair) -> FloatArray:
    """One minus the map of SSIM, as scikit-image does it."""
    return detectors.structural_dissimilarity(pair.warped, pair.followup)


def ir_mad(pair: AlignedPair) -> FloatArray:
    """Iteratively reweighted multivariate alteration detection."""
    return detectors.ir_mad_statistic(pair.warped, pair.followup, pair.overlap)


def zogy(pair: AlignedPair) -> FloatArray:
    """Proper subtraction with the true PSFs and noise, Gaussian both.

    B. Zackay, E. O. Ofek, A. Gal-Yam, "Proper image subtraction", ApJ 830 (2016) 27, equation (13).
    """
    freq_y = np.fft.fftfreq(pair.followup.shape[0])[:, None]
    freq_x = np.fft.fftfreq(pair.followup.shape[1])[None]
    square = freq_x**2 + freq_y**2
    before, after = (np.exp(-2 * pi**2 * blur**2 * square) for blur in pair.blur_px)
    sigma_before, sigma_after = pair.noise_dn
    images = (pair.warped, pair.followup)
    reference, followup = (np.fft.fft2(image - pair.followup.mean()) for image in images)
    below = np.sqrt(sigma_after**2 * before**2 + sigma_before**2 * after**2 + 1e-12)
    difference = np.fft.ifft2((before * followup - after * reference) / below).real
    return np.abs(gaussian_filter(difference, SMOOTHING_PX))


def elsewhere(name: str, python: Path) -> Peer:
    """A peer that has an environment of its own, whose interpreter is ``python``."""

    def score(pair: AlignedPair) -> FloatArray:
        with tempfile.TemporaryDirectory() as folder:
            source, target = Path(folder) / "pair.npz", Path(folder) / "difference.npz"
            np.savez(source, reference=pair.warped, followup=pair.followup)
            command = [str(python), "-P", str(WORKER), name, str(source), str(target)]
            try:
                subprocess.run(command, check=True, capture_output=True, timeout=_TIME_LIMIT_S)
            except FileNotFoundError as error:
                raise PeerError(f"no interpreter {python}") from error
            except subprocess.TimeoutExpired as error:
                raise PeerError(f"not done in {_TIME_LIMIT_S} s") from error
            except subprocess.CalledProcessError as error:
                said = error.stderr.decode(errors="replace").strip().splitlines()
                raise PeerError(said[-1] if said else f"exit {error.returncode}") from error
            difference = np.load(target)["difference"]
        return np.abs(gaussian_filter(np.asarray(difference, np.float64), SMOOTHING_PX))

    return score
