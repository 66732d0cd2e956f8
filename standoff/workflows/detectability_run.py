"""Measures curves of d' against zoom on many photographs, and draws them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from analysis.detectability import (
    DetectabilityCurve,
    DetectabilityCurves,
    DetectionTask,
    SweepWorkers,
    curves_of,
    sweep_images,
)
from analysis.reports import plot_detectability
from simulation.arrays import FloatArray
from simulation.capture_noise import CaptureNoise
from simulation.choices import PsfShape
from standoff.photographs import Inputs, ReadOptions, read_image
from standoff.terminal import progress_bar
from standoff.workflows.figure_files import write_figure
from standoff.workflows.psf_files import read_camera_psf


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurvesRequest:
    """The photographs, the change to detect in them, and the workers.

    ``transfer`` says which PSF of the psf.json is used. ``noise`` is a camera's noise, instead of
    the task's; its value at the mean level of the photographs is used. ``inputs`` reads the
    photographs; its list of them is filled here.
    """

    images: tuple[Path, ...]
    psf: Path | None
    transfer: PsfShape
    task: DetectionTask
    noise: CaptureNoise | None
    workers: SweepWorkers
    inputs: Inputs


def measure_curves(request: CurvesRequest, results: Path) -> DetectabilityCurves:
    """Measure the photographs and compute the curves, with progress bars on stderr.

    The measurements of each are written to ``results``; an interrupted run resumes from there.

    Raises
    ------
    ApplicationError, AnalysisError, CalibrationError
        If a photograph, the PSF or the results cannot be read.
    """
    task = request.task
    psf = None if request.psf is None else read_camera_psf(request.psf, request.transfer)
    plan = replace(task.plan(psf, len(request.images)), reading=str(request.inputs.options))
    for image in request.images:
        request.inputs.add_photograph(image)
    with progress_bar("measuring images", len(request.images)) as bar:
        cells = sweep_images(
            request.images,
            partial(_grey, request.inputs.options),
            plan,
            results=results,
            workers=request.workers,
            progress=bar.advance_to,
        )
    if request.noise is not None:
        levels = np.array([cell.mean_dn for cell in cells])
        noise_dn = math.sqrt(float(request.noise.variance_dn2(levels).mean()))
        task = replace(task, noises_dn=(noise_dn,))
    with progress_bar("computing d'", len(task.models)) as bar:
        return curves_of(cells, plan, task, bar.advance_to)


def _grey(options: ReadOptions, path: Path) -> FloatArray:
    return read_image(path, options).grey_dn


def curve_figures(
    out: Path, curves: Sequence[DetectabilityCurve], contrast_dn: float
) -> list[Path]:
    """Draw the curves beside ``out``: by noise at one contrast, by contrast at the middle noise.

    Raises
    ------
    ApplicationError
        If a file cannot be written.
    """
    noises_dn = sorted({curve.noise_dn for curve in curves})
    middle_dn = noises_dn[len(noises_dn) // 2]
    by_noise = [curve for curve in curves if curve.contrast_dn == contrast_dn]
    by_contrast = [curve for curve in curves if curve.noise_dn == middle_dn]
    written = []
    for name, figure in (
        ("noise", plot_detectability(by_noise, "noise_dn")),
        ("contrast", plot_detectability(by_contrast, "contrast_dn")),
    ):
        for suffix in (".png", ".svg"):
            path = out.with_name(f"{out.stem}-{name}{suffix}")
            write_figure(path, figure)
            written.append(path)
    return written
