"""Simulated follow-ups as other libraries make them, with the blur that was measured.

Frontal follow-ups are a box of the reference at another size. Of poses with a tilt, most of these
programs know nothing. pyBSM pins an older numba than this project needs, and is optional: ``pip
install --no-deps pybsm`` installs what is used here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from math import sqrt
from typing import Literal

import cv2
import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates, zoom as enlarged
from skimage.transform import rescale

from analysis.detectors import followup_view, sees_reference
from benchmarks.peers.edges import chart_width_px
from benchmarks.peers.program import PeerError, Program, Task
from benchmarks.truth.lenses import Camera, gaussian
from simulation import GaussianPsf, SamplingGrid, zoom_out_on_grid
from simulation.arrays import FloatArray

HAS_PYBSM = find_spec("pybsm") is not None

_RADIANS_PER_PX = 1e-6
"""Any small angle: pyBSM thinks in angles."""

FINENESS = 4
"""pyBSM asks for a reference sampled four times as finely as the optics' cut-off."""

_OTF_SAMPLES = 1025


def pillow_scipy(reference: FloatArray, zoom: float, sigma_px: float) -> FloatArray:
    """Pillow's antialiased bicubic, then a Gaussian at the follow-up's resolution."""
    size = (round(reference.shape[1] / zoom), round(reference.shape[0] / zoom))
    small = Image.fromarray(reference.astype(np.float32)).resize(size, Image.Resampling.BICUBIC)
    return np.asarray(
        gaussian_filter(np.asarray(small, dtype=np.float64), sigma_px * sqrt(1 - zoom**-2))
    )


def opencv(reference: FloatArray, zoom: float, sigma_px: float) -> FloatArray:
    """Blur by a Gaussian at the reference's resolution, then cubic samples."""
    size = (round(reference.shape[1] / zoom), round(reference.shape[0] / zoom))
    blurred = cv2.GaussianBlur(reference.astype(np.float32), (0, 0), sigma_px * sqrt(zoom**2 - 1))
    return np.asarray(cv2.resize(blurred, size, interpolation=cv2.INTER_CUBIC), dtype=np.float64)


def pybsm(reference: FloatArray, zoom: float, camera: Camera) -> FloatArray:
    """Blur and resample by pyBSM, with the true transfer function of the camera far away.

    It takes the reference as an ideal view of the scene, so its own blur counts twice.
    """
    fine = enlarged(reference, FINENESS, order=3, grid_mode=True, mode="nearest")
    return pybsm_of_fine(fine, 1 / FINENESS, zoom, camera)


def pybsm_of_fine(fine: FloatArray, step_px: float, zoom: float, camera: Camera) -> FloatArray:
    """The same of a reference that is sampled finely already, every ``step_px`` of its pixels."""
    freq = np.linspace(-1, 1, _OTF_SAMPLES) * FINENESS / 2
    made, _ = import_module("pybsm.otf").apply_otf_to_image(
        ref_img=fine,
        ref_gsd=_RADIANS_PER_PX * step_px,
        ref_range=1.0,
        otf=camera.otf(zoom * freq[None, :], zoom * freq[:, None]),
        df=(freq[1] - freq[0]) / _RADIANS_PER_PX,
        ifov=zoom * _RADIANS_PER_PX,
    )
    return np.asarray(made)


_SUBSAMPLES = 4
"""Of a follow-up pixel along each axis, where its area is averaged."""

_ROUNDING = 1e-9
"""Of a size that would be a whole number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frontal:
    """A follow-up that is a box of the reference at ``1 / zoom`` of its size.

    ``first_x_px`` and ``first_y_px`` are the centre of its first pixel in the reference.
    """

    zoom: float
    first_x_px: float
    first_y_px: float
    shape: tuple[int, int]

    @classmethod
    def of(cls, task: Task) -> "Frontal":
        """Read it from a task's homography; PeerError if the pose has a tilt or a turn."""
        if task.facts["kind"] != "frontal":
            raise PeerError("it knows no tilt")
        matrix = task.homography
        rows, cols = task.facts["followup_shape"]
        scale = float(task.facts["zoom"])
        plain = np.array([[scale, 0, matrix[0, 2]], [0, scale, matrix[1, 2]], [0, 0, 1]])
        if not np.allclose(plain, matrix, atol=1e-6):
            raise PeerError("it knows no turn")
        return cls(zoom=scale, first_x_px=matrix[0, 2], first_y_px=matrix[1, 2], shape=(rows, cols))

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom in the reference, from the first pixel's outer corner."""
        rows, cols = self.shape
        left, top = (at + 0.5 - self.zoom / 2 for at in (self.first_x_px, self.first_y_px))
        return left, top, left + cols * self.zoom, top + rows * self.zoom

    def sampled(self, image: FloatArray, zoom: float | None = None) -> FloatArray:
        """Cubic spline of an image at the pixels; ``zoom`` is what it was reduced by."""
        by = zoom or 1.0
        rows, cols = self.shape
        y = (self.first_y_px + self.zoom * np.arange(rows) + 0.5) / by - 0.5
        x = (self.first_x_px + self.zoom * np.arange(cols) + 0.5) / by - 0.5
        grid = np.meshgrid(y, x, indexing="ij")
        return np.asarray(map_coordinates(image, grid, order=3, mode="mirror"))


def _lacking_px(task: Task) -> float:
    """Width of the Gaussian by which the follow-up is softer, in its own pixels."""
    return chart_width_px(task) * sqrt(1 - float(task.facts["zoom"]) ** -2)


def _pillow(task: Task) -> FloatArray:
    """Antialiased bicubic of the box."""
    frontal = Frontal.of(task)
    image = Image.fromarray(task.linear("reference").astype(np.float32))
    rows, cols = frontal.shape
    left, top, right, bottom = frontal.box
    box = (max(left, 0.0), max(top, 0.0), min(right, image.width), min(bottom, image.height))
    return np.asarray(
        image.resize((cols, rows), Image.Resampling.BICUBIC, box=box), dtype=np.float64
    )


def _pillow_and_blur(task: Task) -> FloatArray:
    """Pillow's, then a Gaussian with what the PSF of the chart lacks."""
    return np.asarray(gaussian_filter(_pillow(task), _lacking_px(task)))


def _area(task: Task) -> FloatArray:
    """Mean of each follow-up pixel's area: fine cubic samples, reduced by INTER_AREA."""
    rows, cols = task.facts["followup_shape"]
    finer = np.eye(3) / _SUBSAMPLES
    finer[:2, 2] = 0.5 / _SUBSAMPLES - 0.5
    finer[2, 2] = 1.0
    fine = _warped(
        task.linear("reference"), task.homography @ finer, (rows * _SUBSAMPLES, cols * _SUBSAMPLES)
    )
    small = cv2.resize(fine, (cols, rows), interpolation=cv2.INTER_AREA)
    return _seen(task, np.asarray(small, dtype=np.float64))


def _cubic(task: Task) -> FloatArray:
    """OpenCV's cubic warp without any blur."""
    warped = _warped(task.linear("reference"), task.homography, task.facts["followup_shape"])
    return _seen(task, np.asarray(warped, dtype=np.float64))


def _blur_and_cubic(task: Task) -> FloatArray:
    """A Gaussian of what the PSF of the chart lacks, before OpenCV's cubic warp."""
    sigma, zoom = chart_width_px(task), float(task.facts["zoom"])
    blurred = cv2.GaussianBlur(task.linear("reference"), (0, 0), sigma * sqrt(zoom**2 - 1))
    warped = _warped(np.asarray(blurred), task.homography, task.facts["followup_shape"])
    return _seen(task, np.asarray(warped, dtype=np.float64))


def _blur_and_spline(task: Task) -> FloatArray:
    """The same with scipy's filter and its cubic spline."""
    sigma, zoom = chart_width_px(task), float(task.facts["zoom"])
    blurred = gaussian_filter(task.linear("reference"), sigma * sqrt(zoom**2 - 1))
    seen = followup_view(blurred, tuple(task.facts["followup_shape"]), task.homography)
    return _seen(task, seen.levels)


def _by_paper(task: Task, model: Literal["bicubic", "paper"]) -> FloatArray:
    """Bicubic of the paper that this project follows, without or with its blur (equation 1)."""
    frontal = Frontal.of(task)
    rows, cols = frontal.shape
    grid = SamplingGrid(
        zoom_y=frontal.zoom,
        zoom_x=frontal.zoom,
        origin_y_px=frontal.first_y_px,
        origin_x_px=frontal.first_x_px,
        rows=rows,
        cols=cols,
    )
    psf = GaussianPsf(sigma_px=chart_width_px(task))
    return np.asarray(zoom_out_on_grid(task.linear("reference"), grid, psf, model))


def _scikit_image(task: Task) -> FloatArray:
    """Rescale with anti_aliasing, and a cubic spline at the follow-up's pixels."""
    frontal = Frontal.of(task)
    reference = task.linear("reference")
    small = rescale(reference, 1 / frontal.zoom, order=3, anti_aliasing=True, preserve_range=True)
    # The size is rounded, so that the scale is not quite the one that was asked for.
    reduced = reference.shape[1] / small.shape[1]
    return frontal.sampled(np.asarray(small, dtype=np.float64), reduced)


def _by_pybsm(task: Task) -> FloatArray:
    """PyBSM with the Gaussian that the follow-up lacks as the system's transfer function.

    It takes the reference for an ideal view of the scene, and would count its blur twice.
    """
    frontal = Frontal.of(task)
    lacking = gaussian(_lacking_px(task), has_pixel=False)
    rows, cols = frontal.shape
    # It makes whole pixels of what it is given: the box, in whole fine pixels.
    count = round(FINENESS * frontal.zoom * max(rows, cols)) / max(rows, cols)
    step = frontal.zoom / count
    left, top, *_ = frontal.box
    y, x = ((np.arange(round(size * count)) + 0.5) * step - 0.5 for size in frontal.shape)
    grid = np.meshgrid(y + top, x + left, indexing="ij")
    fine = map_coordinates(task.linear("reference"), grid, order=3, mode="mirror")
    made = pybsm_of_fine(np.asarray(fine), step * (1 + _ROUNDING), frontal.zoom, lacking)
    if made.shape != frontal.shape:
        raise PeerError(f"pyBSM returns {made.shape} pixels")
    return made


def _warped(image: FloatArray, matrix: FloatArray, shape: tuple[int, int]) -> FloatArray:
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpPerspective(
            image,
            matrix,
            (shape[1], shape[0]),
            flags=flags,
            borderMode=cv2.BORDER_REFLECT_101,
        )
    )


def _seen(task: Task, image: FloatArray) -> FloatArray:
    """Without pixels that the reference does not show."""
    rows, cols = task.stored("reference").shape
    inside = sees_reference((rows, cols), (image.shape[0], image.shape[1]), task.homography)
    return np.where(inside, image, np.nan)


def _program(
    name: str, given: str, answer: Callable[[Task], FloatArray], *packages: str
) -> Program:
    return Program(name=name, given=given, answers={"simulation": answer}, packages=packages)


_CV = "opencv-contrib-python-headless"
PROGRAMS = (
    _program("pillow", "Pillow's antialiased bicubic of the box", _pillow, "Pillow"),
    _program(
        "pillow-blur",
        "the same, then a Gaussian of the width that erf-fit finds on the chart, less the share "
        "that the reference has",
        _pillow_and_blur,
        "Pillow",
        "scipy",
    ),
    _program("opencv-cubic", "OpenCV's cubic warp by the homography, no blur", _cubic, _CV),
    _program(
        "opencv-area",
        "OpenCV's INTER_AREA of 4 x 4 cubic samples a pixel, at the homography",
        _area,
        _CV,
    ),
    _program(
        "opencv-gaussian",
        "OpenCV's GaussianBlur of the width that erf-fit finds on the chart, then its cubic warp "
        "by the homography",
        _blur_and_cubic,
        _CV,
    ),
    _program(
        "scipy-gaussian",
        "scipy's gaussian_filter of the same width, then its cubic spline at the homography",
        _blur_and_spline,
        "scipy",
    ),
    _program(
        "paper-bicubic",
        "model bicubic of standoff: Pillow's kernel on the task's grid",
        partial(_by_paper, model="bicubic"),
    ),
    _program(
        "paper",
        "model paper of standoff: bicubic, then a Gaussian by equation (1), of the width that "
        "erf-fit finds on the chart",
        partial(_by_paper, model="paper"),
    ),
    _program(
        "skimage",
        "scikit-image's rescale with anti_aliasing, order 3",
        _scikit_image,
        "scikit-image",
    ),
    _program(
        "pybsm",
        "pyBSM's image simulation with a Gaussian of the same width, less the share that the "
        "reference has, as the system's transfer",
        _by_pybsm,
        "pybsm",
    ),
)
