"""Changes between two photographs, as other programs and other fields score them.

All but one get the true alignment, by a cubic warp; differences are smoothed by 1 px as ours is.
"""

import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from math import pi, sqrt
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import center_of_mass, gaussian_filter, label, map_coordinates, uniform_filter

from analysis import detectors
from analysis.detectors import followup_view, in_light_of
from benchmarks.peers.alignments import Matching, detector_of, magsac, matches_of
from benchmarks.peers.change_worker import sfft
from benchmarks.peers.edges import chart_width_px
from benchmarks.peers.program import ChangeScore, PeerError, Program, Task, stretched
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


_THRESHOLD_SD = 5.0
"""At which detectors with a noise of their own declare a change."""

_LOCAL_PX = 9
_BLOCK_PX = 4
_COMPONENTS_SHARE = 0.9
_KMEANS_ROUNDS = 100

WARP = "cubic warp by the true homography in the follow-up's light"
_DECLARED = f"declared beyond {_THRESHOLD_SD:g} robust deviations"


def _pair(task: Task) -> AlignedPair:
    """The pair on the follow-up's pixels by the task's homography, with chart's width and noise."""
    reference, followup = task.linear("reference"), task.linear("followup")
    rows, cols = followup.shape
    seen = followup_view(reference, (rows, cols), task.homography)
    if not seen.inside.any():
        raise PeerError("the reference shows nothing of the follow-up")
    sigma = chart_width_px(task)
    # Reference pixels by follow-up pixel, at the middle of the follow-up.
    zoom = _zoom_at(task.homography, (cols - 1) / 2, (rows - 1) / 2)
    noise = task.noise_dn(float(followup.mean()))
    return AlignedPair(
        reference=reference,
        followup=followup,
        warped=in_light_of(followup, seen.levels, seen.inside),
        overlap=seen.inside,
        noise_dn=(noise, noise),
        blur_px=(sigma / zoom, sigma),
    )


def _zoom_at(matrix: FloatArray, x_px: float, y_px: float) -> float:
    corners = matrix @ np.array([[x_px, x_px + 1, x_px], [y_px, y_px, y_px + 1], [1.0, 1.0, 1.0]])
    x, y = corners[:2] / corners[2]
    return float(sqrt(abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]))))


def _score(task: Task, peer: Peer, *, has_threshold: bool) -> ChangeScore:
    pair = _pair(task)
    score = np.where(pair.overlap, peer(pair), np.nan)
    return ChangeScore(score=score, places=_outstanding(score) if has_threshold else None)


def _outstanding(score: FloatArray) -> FloatArray:
    """Middles of what exceeds five robust standard deviations of a score without sign."""
    known = np.isfinite(score)
    # Of the absolute value of a normal variable the median is 0.6745 standard deviations.
    sigma = float(np.median(score[known])) / 0.6745
    return _middles(known & (np.nan_to_num(score) > _THRESHOLD_SD * sigma))


def _middles(changed: BoolArray) -> FloatArray:
    """Centres (x, y) of connected pixels, shape ``(n, 2)``."""
    numbers, count = label(changed, np.ones((3, 3)))
    middles = center_of_mass(changed, numbers, range(1, count + 1)) if count else []
    return np.array(middles, dtype=np.float64).reshape(-1, 2)[:, ::-1]


def _difference(pair: AlignedPair) -> FloatArray:
    """Absolute difference of the cubic warp, smoothed by 1 px."""
    return np.abs(gaussian_filter(pair.followup - pair.warped, SMOOTHING_PX))


def _matched_difference(pair: AlignedPair) -> FloatArray:
    """The same, after a Gaussian that gives both the same width; over its local scatter."""
    before, after = pair.blur_px
    lacking = sqrt(max(after**2 - before**2, 0.0))
    seen = pair.warped if lacking == 0 else gaussian_filter(pair.warped, lacking)
    made = gaussian_filter(pair.followup - seen, SMOOTHING_PX)
    scatter = np.sqrt(uniform_filter(made**2, 5 * _LOCAL_PX))
    return np.abs(made) / np.maximum(scatter, 1e-9)


def _local_correlation(pair: AlignedPair) -> FloatArray:
    """One minus the correlation in windows of 9 x 9 px."""
    x, y = pair.warped - pair.warped.mean(), pair.followup - pair.followup.mean()
    mean_x, mean_y = uniform_filter(x, _LOCAL_PX), uniform_filter(y, _LOCAL_PX)
    xx, yy, xy = (uniform_filter(product, _LOCAL_PX) for product in (x * x, y * y, x * y))
    power = np.maximum((xx - mean_x**2) * (yy - mean_y**2), 1e-12)
    return np.asarray(1 - (xy - mean_x * mean_y) / np.sqrt(power))


def pca_kmeans(task: Task) -> ChangeScore:
    """Principal components of blocks of the difference image, in two clusters.

    The score is the distance from the unchanged cluster over that from the changed one. After
    T. Celik, "Unsupervised change detection in satellite images using principal component analysis
    and k-means clustering", IEEE Geosci. Remote Sens. Lett. 6 (2009) 772-776: blocks of 4 x 4 px,
    components with 0.9 of the variance.
    """
    pair = _pair(task)
    made = np.where(pair.overlap, np.abs(pair.followup - pair.warped), 0.0)
    rows, cols = (_BLOCK_PX * (size // _BLOCK_PX) for size in made.shape)
    apart = made[:rows, :cols].reshape(rows // _BLOCK_PX, _BLOCK_PX, cols // _BLOCK_PX, _BLOCK_PX)
    blocks = apart.transpose(0, 2, 1, 3).reshape(-1, _BLOCK_PX**2)
    mean = blocks.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov(blocks.T))
    shares = np.cumsum(values[::-1]) / values.sum()
    count = int(np.searchsorted(shares, _COMPONENTS_SHARE)) + 1
    padded = np.pad(made, ((_BLOCK_PX // 2, _BLOCK_PX // 2 - 1),) * 2, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (_BLOCK_PX, _BLOCK_PX))
    features = (windows.reshape(*made.shape, -1) - mean) @ vectors[:, ::-1][:, :count]
    unchanged, changed = _two_clusters(features[pair.overlap], made[pair.overlap])
    away, near = (np.linalg.norm(features - middle, axis=-1) for middle in (unchanged, changed))
    score = np.where(pair.overlap, away / np.maximum(near, 1e-9), np.nan)
    return ChangeScore(score=score, places=_middles(np.nan_to_num(score) > 1))


def _two_clusters(features: FloatArray, difference_dn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Middles by Lloyd's k-means, that of the smaller mean difference first."""
    far = np.argsort(difference_dn)
    tenth = max(len(far) // 10, 1)
    middles = [features[far[:-tenth]].mean(axis=0), features[far[-tenth:]].mean(axis=0)]
    for _ in range(_KMEANS_ROUNDS):
        distances = [np.linalg.norm(features - middle, axis=1) for middle in middles]
        second = distances[1] < distances[0]
        if second.all() or not second.any():
            raise PeerError("k-means finds one cluster")
        moved = [features[~second].mean(axis=0), features[second].mean(axis=0)]
        settled = all(np.allclose(a, b) for a, b in zip(moved, middles, strict=True))
        middles = moved
        if settled:
            break
    means = [difference_dn[~second].mean(), difference_dn[second].mean()]
    return (middles[0], middles[1]) if means[0] < means[1] else (middles[1], middles[0])


def _subtraction(
    name: str, given: str, subtract: Callable[[FloatArray, FloatArray], FloatArray]
) -> Program:
    """An image subtraction of astronomy."""

    def peer(pair: AlignedPair) -> FloatArray:
        return np.abs(gaussian_filter(subtract(pair.warped, pair.followup), SMOOTHING_PX))

    return Program(
        name=name,
        given=f"{given}, {WARP}; {_DECLARED}",
        answers={"changes": lambda task: _score(task, peer, has_threshold=True)},
        packages=(name,),
    )


def program(
    name: str, given: str, peer: Peer, *packages: str, has_threshold: bool = False
) -> Program:
    def answer(task: Task) -> ChangeScore:
        return _score(task, peer, has_threshold=has_threshold)

    return Program(name=name, given=given, answers={"changes": answer}, packages=packages)


PROGRAMS = (
    program(
        "difference",
        f"absolute difference of the {WARP}, smoothed by 1 px; {_DECLARED}",
        _difference,
        "scipy",
        has_threshold=True,
    ),
    program(
        "difference-matched",
        "the same behind a Gaussian for the lacking blur by the chart's erf-fit, over its scatter "
        f"in windows of {5 * _LOCAL_PX} px; {_DECLARED}",
        _matched_difference,
        "scipy",
        has_threshold=True,
    ),
    program(
        "difference-sift",
        "absolute difference behind OpenCV's own SIFT and USAC_MAGSAC",
        absolute_difference,
        "opencv-contrib-python-headless",
    ),
    program("ssim", f"scikit-image's SSIM, {WARP}", structural_dissimilarity, "scikit-image"),
    program("ncc", f"local correlation in 9 x 9 px, {WARP}", _local_correlation, "scipy"),
    program("ir-mad", f"IR-MAD (Nielsen 2007), written out here, {WARP}", ir_mad),
    program(
        "zogy",
        "proper subtraction (Zackay and others 2016), written out here: Gaussian PSFs of the "
        f"chart's erf-fit, the noise, {WARP}; {_DECLARED}",
        zogy,
        has_threshold=True,
    ),
    Program(
        name="pca-kmeans",
        given=f"PCA and k-means (Celik 2009), written out here, {WARP}; declared by its clusters",
        answers={"changes": pca_kmeans},
    ),
    _subtraction("sfft", "SFFT (Hu and others 2022), kernel and light of order 2", sfft),
)
