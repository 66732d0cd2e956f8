"""Zoom-outs as other libraries make them, on the same pixels, with the blur that was measured.

pyBSM pins an older numba than this project needs, and is optional: ``pip install --no-deps pybsm``
installs what is used here.
"""

from importlib import import_module
from importlib.util import find_spec
from math import sqrt

import cv2
import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, zoom as enlarged

from benchmarks.truth.lenses import Camera
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
