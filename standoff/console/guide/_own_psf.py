"""The PSF of a phone's own frames, and the d' that follows from it where no curves are given.

An approach shows the scene at two distances: two sharp frames of it give the PSF as two photographs
do (`calibrate_from_distances`). Until there are two, it is that of the edges that the scene has, if
it has enough (`calibrate_from_scene`).
"""

from contextlib import suppress
from dataclasses import dataclass, field
from math import hypot, sqrt
from threading import Lock
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.photographs import Encoding
from analysis.detectability import DetectabilityCurve, DetectionTask, curves_of_images
from analysis.errors import AnalysisError
from analysis.pose import PoseQuality, pose_quality
from calibration.blind import calibrate_from_distances, calibrate_from_scene
from calibration.edges import EdgeImage, Region
from calibration.errors import CalibrationError
from calibration.noise import LevelNoise
from calibration.psf import PsfCalibration
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from standoff.console.guide._reference import FRAME_PX, GuideReference, scaled_matrix
from standoff.library import known_errors

ByteImage = NDArray[np.uint8]

LEAST_RATIO: Final = 1.2
"""Ratio of the distances of two frames from which the PSF is measured."""

_STEP: Final = 1.1
"""Ratio of the distances from which another frame says more."""

_MEASURED_PX: Final = (400, 300)
"""Middle of the nearer frame that is measured: all of it takes twice as long."""

_COMPRESSED_PX2: Final = 0.08
"""Variance that compression and noise add to the blur between two frames; the study of them is in
benchmarks/studies/guided_psf.py."""

_WHITE_DN: Final = 255.0
_LEAST_NOISE_DN: Final = 1.0
_NOISE_PER_LAPLACIAN = 1 / sqrt(20.0)
_ZOOMS: Final = (1.0, 1.1, 1.25, 1.5, 2.0)
_TWICE: Final = 2
"""Of the frame's resolution: the scene that the curve is computed on."""

_AT_WORK = Lock()
"""One measurement at a time, whatever the number of phones: frames are judged meanwhile."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FineFrame:
    """A frame of little compression that was held still; ``zoom``: its distance, relatively."""

    levels: ByteImage = field(repr=False)
    zoom: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameCurve:
    """The PSF of a phone's own frames, and the d' that they allow.

    Parameters
    ----------
    psf
        In px of a frame whose longer side has 640.
    sigma_err_px
        Standard error of its width, that of compression included.
    ratio
        Ratio of the distances of the two frames; None for a PSF from the edges of one.
    noise_dn
        Noise of the frames, of 255.
    curve
        d' of a spot against zoom, at the frames' resolution.
    """

    psf: PsfCalibration = field(repr=False)
    sigma_err_px: float
    ratio: float | None
    noise_dn: float
    curve: DetectabilityCurve = field(repr=False)

    @property
    def sigma_px(self) -> float:
        """Width of the PSF, the mean of both axes."""
        return _mean_sigma_px(self.psf)

    @property
    def words(self) -> str:
        """How it was measured, and what d' is of."""
        how = "from the edges that this scene has, in one of this phone's own pictures"
        if self.ratio is not None:
            how = f"from this phone's own pictures at two distances (1 : {self.ratio:.2f})"
        return (
            f"Its PSF was measured {how}: σ {self.sigma_px:.2f} ± {self.sigma_err_px:.2f} px of a "
            f"frame of {FRAME_PX} px. d′ is of a spot of {self.curve.contrast_dn:g} of 255 grey "
            f"levels and σ {self.curve.signal_sigma_px:g} px, at a noise of {self.noise_dn:.1f}."
        )

    def quality(
        self,
        matrix: FloatArray,
        size: tuple[int, int],
        reference_size: tuple[int, int],
        min_d_prime: float,
    ) -> PoseQuality | None:
        """Judge a pose; sizes are ``(width, height)`` of the pictures between which it maps."""
        full = _frame_size(reference_size)
        factor = FRAME_PX / max(size)
        own = round(factor * size[0]), round(factor * size[1])
        scaled = scaled_matrix(matrix, (size, reference_size), (own, full))
        try:
            return pose_quality(scaled, own, full, self.curve, min_d_prime)
        except AnalysisError:
            return None


class OwnPsf:
    """Collects fine frames of one phone, and measures its PSF once they allow it."""

    def __init__(self, reference: GuideReference) -> None:
        self._reference = reference
        self._near: FineFrame | None = None
        self._far: FineFrame | None = None
        self._is_new = False
        self.found: FrameCurve | None = None

    @property
    def is_due(self) -> bool:
        """Whether there is a frame that was not measured yet, and nothing else is measured."""
        return self._is_new and not _AT_WORK.locked()

    def wants(self, zoom: float) -> bool:
        """Whether a fine frame from this distance would say more than those that are here."""
        if self._near is None or self._far is None:
            return True
        return zoom < self._near.zoom / _STEP or zoom > self._far.zoom * _STEP

    def add(self, frame: FineFrame) -> None:
        """Keep a frame that was held still, if it was taken from nearer or further away."""
        if not self.wants(frame.zoom):
            return
        if self._near is None or frame.zoom < self._near.zoom:
            self._near = frame
        if self._far is None or frame.zoom > self._far.zoom:
            self._far = frame
        self._is_new = True

    def measure(self) -> None:
        """Measure what is due, which takes seconds, unless another one is measured."""
        if not _AT_WORK.acquire(blocking=False):
            return
        try:
            self._is_new = False
            near, far = self._near, self._far
            if near is not None and far is not None:
                self.found = _measured(self._reference, near, far) or self.found
        finally:
            _AT_WORK.release()


def _measured(reference: GuideReference, near: FineFrame, far: FineFrame) -> FrameCurve | None:
    """By two frames if they are from two distances, else by one; None if neither tells it."""
    noise_dn = _noise_dn(near)
    images = [_edge_image(one, noise_dn) for one in (near, far)]
    ratio = far.zoom / near.zoom
    with suppress(CalibrationError, AnalysisError, ValueError):
        if ratio >= LEAST_RATIO:
            psf = calibrate_from_distances([images], region=lambda _: _middle(near.levels))
            return _curve(reference, psf, noise_dn, ratio)
    with suppress(CalibrationError, AnalysisError, ValueError):
        return _curve(reference, calibrate_from_scene(images[:1]), noise_dn, None)
    return None


def _middle(levels: ByteImage) -> Region:
    rows, cols = levels.shape
    width, height = min(_MEASURED_PX[0], cols), min(_MEASURED_PX[1], rows)
    left_px, top_px = (cols - width) // 2, (rows - height) // 2
    return Region(x_px=left_px, y_px=top_px, width_px=width, height_px=height)


def _curve(
    reference: GuideReference, psf: PsfCalibration, noise_dn: float, ratio: float | None
) -> FrameCurve:
    """What can be found on the reference's scene through this PSF."""
    sigma = _mean_sigma_px(psf)
    added_px2 = 0.0 if ratio is None else _COMPRESSED_PX2 / (ratio**2 - 1)
    sources = known_errors(psf)
    variance_err_px2 = hypot(sources.psf_variance_err_px2 or 0.0, added_px2)
    task = DetectionTask(
        zooms=_ZOOMS,
        models=("matched",),
        observers=("hotelling",),
        noises_dn=(max(noise_dn, _LEAST_NOISE_DN),),
        reference_zoom=float(_TWICE),
        sources=sources.model_copy(update={"psf_variance_err_px2": variance_err_px2}),
    )
    width, height = (_TWICE * side for side in _frame_size(reference.size))
    levels = cv2.imdecode(np.frombuffer(reference.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert levels is not None  # drawn by the reference
    scene = cv2.resize(levels, (width, height), interpolation=cv2.INTER_AREA)
    found = curves_of_images([_linear_dn(np.asarray(scene, np.uint8))], _gaussian(psf), task)
    return FrameCurve(
        psf=psf,
        sigma_err_px=variance_err_px2 / (2 * sigma),
        ratio=ratio,
        noise_dn=task.noises_dn[0],
        curve=found.curves[0],
    )


def _gaussian(psf: PsfCalibration) -> GaussianPsf:
    sigma_x_px, sigma_y_px = psf.sigma_x_px, psf.sigma_y_px
    assert sigma_x_px is not None
    assert sigma_y_px is not None
    return GaussianPsf(sigma_x_px, sigma_y_px, psf.rho or 0.0)


def _mean_sigma_px(psf: PsfCalibration) -> float:
    """Root of the mean variance along both axes."""
    found = _gaussian(psf)
    return hypot(found.sigma_x_px, found.sigma_y_px) / sqrt(2)


def _frame_size(size: tuple[int, int]) -> tuple[int, int]:
    """``(width, height)`` with a longer side as that of the frames."""
    factor = FRAME_PX / max(size)
    return round(factor * size[0]), round(factor * size[1])


def _linear_dn(levels: ByteImage) -> FloatArray:
    return Encoding(name="srgb").decode(levels, _WHITE_DN)


def _edge_image(frame: FineFrame, noise_dn: float) -> EdgeImage:
    noise = LevelNoise(offset_dn2=noise_dn**2, slope_dn=0.0, floor_dn2=noise_dn**2)
    return EdgeImage(
        name="a frame",
        image_dn=_linear_dn(frame.levels),
        noise=noise,
        saturation_dn=_WHITE_DN,
        is_jpeg=True,
    )


def _noise_dn(frame: FineFrame) -> float:
    """Noise of a frame, linear in light, by J. Immerkaer, Fast noise variance estimation, 1996."""
    fine = cv2.Laplacian(_linear_dn(frame.levels).astype(np.float32), cv2.CV_32F)
    return max(float(np.median(np.abs(np.asarray(fine)))) / 0.6745 * _NOISE_PER_LAPLACIAN, 0.05)
