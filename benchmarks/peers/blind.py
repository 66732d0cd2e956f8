"""The camera's PSF from photographs of scenes without an edge target.

The blur between a photograph and the same scene ``zoom`` times further away, in pixels of the
nearer one, has the transfer function ``K(f) = H(zoom f) / H(f)``, so that in pixels of the camera
``H(f)`` is the product of ``K(f / zoom^n)`` over n from 1 on.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls

import standoff
from benchmarks.peers.edges import Curve, GaussianEdge
from benchmarks.peers.kernel_between import estimate_kernel
from benchmarks.peers.program import EdgeContrast, PeerError, Program, Task
from calibration.blind.two_distance import align_smoothly
from calibration.errors import CalibrationError, PairError
from calibration.psf import PsfCalibration
from simulation.arrays import FloatArray

_FREQ = np.linspace(0.0, 1.0, 401)
_FACTORS = 12
_KERNEL_SIGMAS = 3.5
_WIDEST_SIGMA_PX = 1.2
_BLOCK_PX = 64
_FIT_CY_PER_PX = (0.05, 0.45)


def curve_of_kernel(weights: FloatArray, zoom: float, axis: int) -> Curve:
    """Curve of the PSF along x (axis 0) or y (1) from the square kernel between two distances."""
    spread = weights.sum(axis=axis)
    place = np.arange(spread.size) - spread.size // 2
    powers = zoom ** np.arange(1.0, _FACTORS + 1)
    phases = np.exp(-2j * np.pi * np.multiply.outer(_FREQ / powers[:, None], place))
    contrast = np.prod(np.abs(phases @ spread / spread.sum()), axis=0)
    return Curve(freq=_FREQ, contrast=contrast)


def delbracio(task: Task) -> list[EdgeContrast]:
    """Kernel between the two photographs by non-negative least squares, without any model of it.

    M. Delbracio, A. Almansa, P. Musé, J.-M. Morel, "Subpixel point spread function estimation from
    two photographs at different distances", SIAM J. Imaging Sciences 5 (2012) 1234-1260.
    """
    near, far = task.linear("nearer_file"), task.linear("file")
    matrix = np.array(task.facts["homography_to_nearer"], dtype=np.float64)
    zoom = float(task.facts["zoom"])
    reach = _KERNEL_SIGMAS * _WIDEST_SIGMA_PX * np.sqrt(zoom**2 - 1)
    radius = int(np.clip(np.ceil(reach), 4, 12))
    try:
        found = estimate_kernel(near, far, align_smoothly(near, far, matrix), radius_px=radius)
    except PairError as error:
        raise PeerError(str(error)) from error
    # The offset is free: it is eliminated, so that the weights alone are not negative.
    normal, right = found.noisy_normal, found.right
    to_offset = normal[:-1, -1] / normal[-1, -1]
    system = normal[:-1, :-1] - np.outer(to_offset, normal[-1, :-1])
    target = right[:-1] - to_offset * right[-1]
    values, vectors = np.linalg.eigh(system)
    root = np.sqrt(np.maximum(values, 1e-9 * values.max()))
    weights, _ = nnls(root[:, None] * vectors.T, (vectors.T @ target) / root, maxiter=5000)
    return along_both(weights.reshape(2 * radius + 1, -1), zoom)


def _single_image(task: Task) -> list[EdgeContrast]:
    """The sharpest edges of the further photograph, after Luxen and Förstner (2002)."""
    try:
        psf = standoff.calibrate_psf(task.path("file"), method="single-image")
    except CalibrationError as error:
        raise PeerError(str(error)) from error
    return gaussian_answers(psf)


def gaussian_answers(psf: PsfCalibration) -> list[EdgeContrast]:
    """Contrasts along x and y of a calibration that knows the covariance alone."""
    widths = (psf.sigma_x_px, psf.sigma_x_err_px), (psf.sigma_y_px, psf.sigma_y_err_px)
    return [
        GaussianEdge(sigma_px=sigma, sigma_err_px=error or np.nan).answer(axis)
        for axis, (sigma, error) in zip("xy", widths, strict=True)
        if sigma is not None
    ]


def _spectrum(task: Task) -> list[EdgeContrast]:
    """A Gaussian PSF before which the scene's power falls as 1 / f^2, with white noise.

    D. J. Field, "Relations between the statistics of natural images and the response properties of
    cortical cells", J. Opt. Soc. Am. A 4 (1987) 2379-2394: the power of natural scenes.
    """
    image = task.linear("file")
    window = np.hanning(_BLOCK_PX)
    step = _BLOCK_PX // 2
    blocks = np.lib.stride_tricks.sliding_window_view(image, (_BLOCK_PX, _BLOCK_PX))[::step, ::step]
    noise = task.noise_dn(float(image.mean())) ** 2 * (window**2).sum()
    freq = np.fft.rfftfreq(_BLOCK_PX)
    used = (freq >= _FIT_CY_PER_PX[0]) & (freq <= _FIT_CY_PER_PX[1])
    answers = []
    for axis, name in enumerate("yx"):
        lines = np.moveaxis(blocks, 2 + axis, 3)
        lines = (lines - lines.mean(axis=-1, keepdims=True)) * window
        power = (np.abs(np.fft.rfft(lines, axis=-1)) ** 2).mean(axis=(0, 1, 2)) - noise
        kept = used & (power > 0.1 * noise)
        if np.count_nonzero(kept) < 4:
            continue
        slope, _ = np.polyfit(freq[kept] ** 2, np.log(power[kept] * freq[kept] ** 2), 1)
        if slope < 0:
            sigma = float(np.sqrt(-slope / (4 * np.pi**2)))
            answers.append(GaussianEdge(sigma_px=sigma, sigma_err_px=np.nan).answer(name))
    if not answers:
        raise PeerError("its spectrum does not fall")
    return answers


def along_both(weights: FloatArray, zoom: float) -> list[EdgeContrast]:
    """Contrasts along x and y of the PSF behind a kernel between two distances."""
    return [curve_of_kernel(weights, zoom, axis).answer(name) for axis, name in enumerate("xy")]


def of_photographs(
    measure: Callable[[Task], list[EdgeContrast]],
) -> Callable[[Task], list[EdgeContrast]]:
    """Answer tasks of photographs alone."""

    def answered(task: Task) -> list[EdgeContrast]:
        if task.facts["kind"] != "photographs":
            raise PeerError("it is for photographs without edges")
        return measure(task)

    return answered


PROGRAMS = (
    Program(
        name="delbracio",
        given="the two-distance method of Delbracio and others (2012), written out here: both "
        "photographs, their zoom and homography",
        answers={"psf": of_photographs(delbracio)},
    ),
    Program(
        name="single-image",
        given="the method of Luxen and Förstner (2002) as standoff has it: the further photograph",
        answers={"psf": of_photographs(_single_image)},
    ),
    Program(
        name="spectrum",
        given="a Gaussian fitted to the power spectrum, the scene's falling as 1/f²: the further "
        "photograph and its noise",
        answers={"psf": of_photographs(_spectrum)},
    ),
)
