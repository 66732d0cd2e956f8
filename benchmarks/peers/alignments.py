"""Poses of a follow-up in its reference as OpenCV and scikit-image find them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import feature, filters, measure, registration
from skimage.transform import ProjectiveTransform, warp_polar

from benchmarks.peers.program import AlignedPoints, PeerError, Program, Task
from simulation.arrays import FloatArray

_EVERYWHERE: Any = None
"""Of a mask that OpenCV's types ask for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Matching:
    """How features are matched and a homography is found.

    ``ratio`` is the most of the distances of a match and the next one (Lowe 2004), ``least`` the
    matches, and those that agree within the tolerance, below which a pair is refused.
    """

    ratio: float = 0.8
    tolerance_px: float = 1.0
    least: int = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matches:
    """Pairs of points (x, y), shape ``(n, 2)`` each."""

    followup_px: FloatArray
    reference_px: FloatArray


def detector_of(name: str) -> cv2.Feature2D:
    """One of OpenCV's, with settings for many features."""
    if name == "sift":
        return cv2.SIFT.create()
    if name == "orb":
        return cv2.ORB.create(nfeatures=5000)
    # These moved to the contributed modules in OpenCV 5.
    home: Any = cv2 if hasattr(cv2, "AKAZE") else cv2.xfeatures2d
    made: cv2.Feature2D = {"akaze": home.AKAZE, "brisk": home.BRISK}[name].create()
    return made


def matches_of(
    reference: NDArray[np.uint8],
    followup: NDArray[np.uint8],
    detector: cv2.Feature2D,
    matching: Matching,
) -> Matches:
    """Match features of two pictures by the ratio test; PeerError if there are too few."""
    (at_reference, of_reference), (at_followup, of_followup) = (
        detector.detectAndCompute(image, _EVERYWHERE) for image in (reference, followup)
    )
    if min(len(at_reference), len(at_followup)) < matching.least:
        raise PeerError("too few features")
    norm = cv2.NORM_L2 if of_followup.dtype == np.float32 else cv2.NORM_HAMMING
    pairs = cv2.BFMatcher(norm).knnMatch(of_followup, of_reference, k=2)
    kept = [
        two[0]
        for two in pairs
        if len(two) > 1 and two[0].distance < matching.ratio * two[1].distance
    ]
    if len(kept) < matching.least:
        raise PeerError(f"only {len(kept)} matches")
    return Matches(
        followup_px=np.array([at_followup[match.queryIdx].pt for match in kept]),
        reference_px=np.array([at_reference[match.trainIdx].pt for match in kept]),
    )


def magsac(matches: Matches, matching: Matching) -> FloatArray:
    """Homography from follow-up to reference by USAC_MAGSAC; PeerError if too few matches agree."""
    matrix, agreeing = cv2.findHomography(
        matches.followup_px,
        matches.reference_px,
        cv2.USAC_MAGSAC,
        matching.tolerance_px,
        maxIters=10_000,
        confidence=0.999,
    )
    if np.shape(matrix) != (3, 3):
        raise PeerError("no homography")
    if (count := int(np.count_nonzero(agreeing))) < matching.least:
        raise PeerError(f"only {count} matches agree")
    return np.asarray(matrix, dtype=np.float64)


# scikit-image states types of some functions only.
_feature: Any = feature
_filters: Any = filters
_measure: Any = measure
_registration: Any = registration

MATCHING = Matching(tolerance_px=2.0)
_ECC_LEVELS = 3
_ECC_STEPS = 200
_ECC_EPSILON = 1e-6
_ECC_SMOOTHING_PX = 5
_LEAST_CORRELATION = 0.6
"""Of the aligned pictures, below which those who align by correlation refuse."""

_LEAST_OVERLAP = 0.1
_LARGEST_ZOOM = 6.0
_POLAR_BAND_PX = (2.0, 16.0)
_UPSAMPLING = 20
_SEED = 1
_DEGENERATE = 1e-9
"""Ratio of a homography's singular values below which it maps the frame onto a line."""


def _by_features(task: Task, name: str) -> AlignedPoints:
    """OpenCV's features, the ratio test and USAC_MAGSAC."""
    return AlignedPoints(homography=_feature_matrix(task, name))


def _feature_matrix(task: Task, name: str) -> FloatArray:
    reference, followup = task.in_8_bits("reference"), task.in_8_bits("followup")
    matches = matches_of(reference, followup, detector_of(name), MATCHING)
    return _normalised(magsac(matches, MATCHING))


def _ecc(task: Task, *, from_features: bool) -> AlignedPoints:
    """Enhanced correlation from SIFT's homography, or from none over a pyramid.

    G. D. Evangelidis, E. Z. Psarakis, "Parametric image alignment using enhanced correlation
    coefficient maximization", IEEE Trans. PAMI 30 (2008) 1858-1865.
    """
    reference, followup = task.in_8_bits("reference"), task.in_8_bits("followup")
    start = _feature_matrix(task, "sift") if from_features else np.eye(3)
    levels = range(0 if from_features else _ECC_LEVELS, -1, -1)
    matrix, correlation = start, 0.0
    for level in levels:
        # Pixel centres of a coarser level are those of its blocks of pixels.
        coarser = np.diag([2.0**level, 2.0**level, 1.0])
        coarser[:2, 2] = (2.0**level - 1) / 2
        warp = np.linalg.inv(coarser) @ matrix @ coarser
        images = [_reduced(image, level) for image in (reference, followup)]
        try:
            correlation, found = _ecc_step(images[0], images[1], warp)
        except cv2.error as error:
            raise PeerError("ECC does not converge") from error
        matrix = coarser @ found @ np.linalg.inv(coarser)
    if correlation < _LEAST_CORRELATION:
        raise PeerError(f"correlation {correlation:.2f}")
    return AlignedPoints(homography=_normalised(matrix))


def _ecc_step(
    reference: NDArray[np.uint8], followup: NDArray[np.uint8], warp: FloatArray
) -> tuple[float, FloatArray]:
    criteria = (
        cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT,
        _ECC_STEPS,
        _ECC_EPSILON,
    )
    correlation, found = cv2.findTransformECC(
        followup,
        reference,
        (warp / warp[2, 2]).astype(np.float32),
        cv2.MOTION_HOMOGRAPHY,
        criteria,
        np.full(reference.shape, 255, np.uint8),
        _ECC_SMOOTHING_PX,
    )
    return float(correlation), np.asarray(found, dtype=np.float64)


def _reduced(image: NDArray[np.uint8], level: int) -> NDArray[np.uint8]:
    for _ in range(level):
        rows, cols = image.shape
        image = np.asarray(
            cv2.resize(image, (cols // 2, rows // 2), interpolation=cv2.INTER_AREA), np.uint8
        )
    return image


def _by_scikit_image(task: Task, name: str) -> AlignedPoints:
    """Features of scikit-image, its matches and its RANSAC of a projective transform."""
    keypoints, descriptors = [], []
    for key in ("followup", "reference"):
        extractor = _feature.SIFT() if name == "sift" else _feature.ORB(n_keypoints=2000)
        try:
            extractor.detect_and_extract(task.in_8_bits(key) / 255.0)
        except RuntimeError as error:
            raise PeerError("too few features") from error
        keypoints.append(extractor.keypoints[:, ::-1].astype(np.float64))
        descriptors.append(extractor.descriptors)
    if min(map(len, descriptors)) < MATCHING.least:
        raise PeerError("too few features")
    pairs = _feature.match_descriptors(*descriptors, max_ratio=MATCHING.ratio, cross_check=True)
    if len(pairs) < MATCHING.least:
        raise PeerError(f"only {len(pairs)} matches")
    matches = Matches(followup_px=keypoints[0][pairs[:, 0]], reference_px=keypoints[1][pairs[:, 1]])
    model, agreeing = _measure.ransac(
        (matches.followup_px, matches.reference_px),
        ProjectiveTransform,
        min_samples=4,
        residual_threshold=MATCHING.tolerance_px,
        max_trials=2000,
        rng=_SEED,
    )
    if model is None or np.count_nonzero(agreeing) < MATCHING.least:
        raise PeerError("too few matches agree")
    return AlignedPoints(homography=_normalised(np.asarray(model.params, dtype=np.float64)))


def _by_phase(task: Task) -> AlignedPoints:
    """Turn and zoom from log-polar spectra, then the shift, by phase correlation.

    B. S. Reddy, B. N. Chatterji, "An FFT-based technique for translation, rotation, and
    scale-invariant image registration", IEEE Trans. Image Processing 5 (1996) 1266-1271.
    """
    reference, followup = (
        task.in_8_bits(key).astype(np.float64) for key in ("reference", "followup")
    )
    rows, cols = followup.shape
    side = 2 ** int(np.ceil(np.log2(max(rows, cols))))
    radius = side // 2
    spectra = [_log_polar(image, side, radius) for image in (reference, followup)]
    shift = _registration.phase_cross_correlation(
        *spectra, upsample_factor=_UPSAMPLING, normalization=None
    )[0]
    turn_deg = float(shift[0]) * 180 / spectra[0].shape[0]
    zoom = float(np.exp(-shift[1] * np.log(radius) / spectra[0].shape[1]))
    tried = [
        _with_shift(reference, followup, zoom=by, turn_deg=turn)
        for by in (zoom, 1 / zoom)
        for turn in (turn_deg, turn_deg + 180, -turn_deg, 180 - turn_deg)
        if 1 / _LARGEST_ZOOM < by < _LARGEST_ZOOM
    ]
    if not tried:
        raise PeerError(f"zoom {zoom:.2g}")
    matrix, correlation = max(tried, key=lambda one: one[1])
    if correlation < _LEAST_CORRELATION:
        raise PeerError(f"correlation {correlation:.2f}")
    return AlignedPoints(homography=_normalised(matrix))


def _log_polar(image: FloatArray, side: int, radius: int) -> FloatArray:
    """Spectrum of an image, angle by logarithm of the frequency, from its half plane."""
    square = np.zeros((side, side))
    fine = _filters.difference_of_gaussians(image - image.mean(), *_POLAR_BAND_PX)
    square[: image.shape[0], : image.shape[1]] = fine * _filters.window("hann", image.shape)
    spectrum = np.fft.fftshift(np.abs(np.fft.fft2(square)))
    polar = warp_polar(
        spectrum, radius=radius, output_shape=(2 * side, side), scaling="log", order=1
    )
    return np.asarray(polar[:side])


def _with_shift(
    reference: FloatArray, followup: FloatArray, *, zoom: float, turn_deg: float
) -> tuple[FloatArray, float]:
    """Similarity of a zoom and a turn with the best shift, and the correlation that it has."""
    rows, cols = followup.shape
    middle = np.array([(cols - 1) / 2, (rows - 1) / 2])
    angle = np.deg2rad(turn_deg)
    turn = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = np.eye(3)
    matrix[:2, :2] = turn
    matrix[:2, 2] = middle - turn @ middle
    onto, seen = _onto_reference(followup, matrix, reference.shape)
    onto = np.where(seen, onto - followup.mean(), 0.0)
    plain = np.where(seen, reference - reference[seen].mean(), 0.0) if seen.any() else reference
    shift = _registration.phase_cross_correlation(
        plain, onto, upsample_factor=_UPSAMPLING, normalization=None
    )
    matrix[:2, 2] += shift[0][::-1]
    onto, seen = _onto_reference(followup, matrix, reference.shape)
    if seen.mean() < _LEAST_OVERLAP:
        return matrix, 0.0
    return matrix, float(np.corrcoef(reference[seen], onto[seen])[0, 1])


def _onto_reference(
    followup: FloatArray, matrix: FloatArray, shape: tuple[int, ...]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    size = (shape[1], shape[0])
    seen = cv2.warpPerspective(np.ones_like(followup), matrix, size) > 0.99
    return np.asarray(cv2.warpPerspective(followup, matrix, size)), seen


def _normalised(matrix: FloatArray) -> FloatArray:
    values = np.linalg.svd(matrix, compute_uv=False)
    if not (np.isfinite(matrix).all() and values[2] > _DEGENERATE * values[0]):
        raise PeerError("a degenerate homography")
    return np.asarray(matrix / matrix[2, 2], dtype=np.float64)


def _program(
    name: str, given: str, answer: Callable[[Task], AlignedPoints], package: str
) -> Program:
    return Program(name=name, given=given, answers={"alignment": answer}, packages=(package,))


_CV = "opencv-contrib-python-headless"
_REFUSAL = f"refused below {MATCHING.least} matches that agree"
PROGRAMS = (
    *(
        _program(
            f"opencv-{name}",
            f"OpenCV's {shown}, ratio test at {MATCHING.ratio}, USAC_MAGSAC within "
            f"{MATCHING.tolerance_px:g} px, {_REFUSAL}; 8-bit pictures",
            partial(_by_features, name=name),
            _CV,
        )
        for name, shown in (
            ("sift", "SIFT"),
            ("orb", "ORB (5,000 features)"),
            ("akaze", "AKAZE"),
            ("brisk", "BRISK"),
        )
    ),
    _program(
        "opencv-sift-ecc",
        "the homography of opencv-sift, refined by OpenCV's findTransformECC",
        partial(_ecc, from_features=True),
        _CV,
    ),
    _program(
        "opencv-ecc",
        "OpenCV's findTransformECC from no movement, over a pyramid of four levels; refused below "
        f"a correlation of {_LEAST_CORRELATION}",
        partial(_ecc, from_features=False),
        _CV,
    ),
    *(
        _program(
            f"skimage-{name}",
            f"scikit-image's {name.upper()}, ratio test at {MATCHING.ratio} with cross check, "
            f"ransac of a ProjectiveTransform within {MATCHING.tolerance_px:g} px, {_REFUSAL}",
            partial(_by_scikit_image, name=name),
            "scikit-image",
        )
        for name in ("sift", "orb")
    ),
    _program(
        "phase",
        "Fourier-Mellin by scikit-image's log-polar warp and phase correlation: a similarity; "
        f"refused below a correlation of {_LEAST_CORRELATION}",
        _by_phase,
        "scikit-image",
    ),
)
