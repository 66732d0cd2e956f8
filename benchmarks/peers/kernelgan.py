"""KernelGAN as this project has written it from its publication, on the further photograph alone.

S. Bell-Kligler, A. Shocher, M. Irani, "Blind Super-Resolution Kernel Estimation using an
Internal-GAN", NeurIPS 2019, arXiv 1909.06581.
"""

from dataclasses import replace

import cv2
import numpy as np

from benchmarks.peers.blind import along_both, of_photographs
from benchmarks.peers.program import EdgeContrast, PeerError, Program, Task
from benchmarks.peers.zoom_outs import Frontal
from simulation.arrays import FloatArray
from simulation.choices import TRAINING_STEPS
from simulation.kernelgan import (
    EstimatedKernel,
    KernelGanError,
    KernelGanSettings,
    estimate_kernel,
)

_ZOOM = 2.0
"""The publication's smaller scale."""


def _contrasts(task: Task) -> list[EdgeContrast]:
    """The PSF whose kernel between two distances at zoom 2 is the one that is learned."""
    return along_both(_learned(task.linear("file"), _ZOOM).weights, _ZOOM)


def _simulated(task: Task) -> FloatArray:
    """Blur by the kernel that is learned at the task's zoom, then a cubic spline."""
    frontal = Frontal.of(task)
    reference = task.linear("reference")
    kernel = _learned(reference, frontal.zoom)
    # Patches look the same wherever they are: the kernel's own shift means nothing.
    centre_y, centre_x = kernel.centre_px
    blurred = cv2.filter2D(reference, cv2.CV_64F, kernel.weights, borderType=cv2.BORDER_REFLECT_101)
    moved = replace(
        frontal,
        first_x_px=frontal.first_x_px - centre_x,
        first_y_px=frontal.first_y_px - centre_y,
    )
    return moved.sampled(np.asarray(blurred))


def _learned(image: FloatArray, zoom: float) -> EstimatedKernel:
    try:
        return estimate_kernel(image, KernelGanSettings(zoom=zoom, steps=TRAINING_STEPS))
    except KernelGanError as error:
        raise PeerError(str(error)) from error


PROGRAMS = (
    Program(
        name="kernelgan",
        given=f"KernelGAN (Bell-Kligler and others 2019), written out here, {TRAINING_STEPS} steps "
        "a picture: the further photograph, or the reference and the zoom",
        answers={"psf": of_photographs(_contrasts), "simulation": _simulated},
        packages=("torch",),
        is_slow=True,
    ),
)
