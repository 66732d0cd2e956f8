"""Measures curves of d' against zoom on many photographs, and draws them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.detectability import (
    ArtefactTiles,
    ChangeSignal,
    DetectabilityCurve,
    Observer,
    Scenario,
    SceneStatistics,
    SweepPlan,
    d_prime_curves,
    sweep_images,
    tiles_per_side,
)
from analysis.reports import plot_detectability
from simulation import Model
from simulation.capture_noise import CaptureNoise
from standoff.terminal import progress_bar
from standoff.workflows.figure_files import write_figure
from standoff.workflows.image_files import read_grey
from standoff.workflows.psf_files import read_total_psf

__all__ = ["CurvesRequest", "curve_figures", "measure_curves"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurvesRequest:
    """The photographs, the change to be found in them, which curves, and who does the work.

    ``noise_dn`` are standard deviations, or the noise of a camera: then the one at the mean level
    of the photographs. ``scheduler`` is Dask's, in place of ``workers`` processes.
    """

    images: tuple[Path, ...]
    psf: Path | None
    models: tuple[Model, ...]
    zooms: tuple[float, ...]
    change: ChangeSignal
    noise_dn: tuple[float, ...] | CaptureNoise
    contrasts_dn: tuple[float, ...]
    observers: tuple[Observer, ...]
    reference_zoom: float
    window_px: int
    workers: int
    scheduler: str | None


def measure_curves(request: CurvesRequest, results: Path) -> list[DetectabilityCurve]:
    """Measure the photographs and work out the curves, with bars on stderr.

    ``results`` takes what was measured on each; an interrupted run goes on from it.

    Raises
    ------
    ApplicationError, AnalysisError, CalibrationError
        If a photograph, the PSF or the results cannot be read.
    """
    scenario = Scenario(
        psf=None if request.psf is None else read_total_psf(request.psf),
        reference_zoom=request.reference_zoom,
        window_px=request.window_px,
    )
    plan = SweepPlan(
        scenario=scenario,
        models=request.models,
        zooms=request.zooms,
        tiles_per_side=tiles_per_side(len(request.images)),
    )
    with progress_bar("measuring images", len(request.images)) as bar:
        cells = sweep_images(
            request.images,
            read_grey,
            plan,
            results=results,
            workers=request.workers,
            scheduler=request.scheduler,
            progress=bar.advance_to,
        )
    noises_dn = request.noise_dn
    if isinstance(noises_dn, CaptureNoise):
        levels = np.array([cell.mean_dn for cell in cells])
        noises_dn = (math.sqrt(float(noises_dn.variance_dn2(levels).mean())),)
    curves = []
    with progress_bar("working out d'", len(request.models)) as bar:
        for number, model in enumerate(request.models):
            curves += d_prime_curves(
                _artefacts(cells, number, len(request.zooms)),
                request.zooms,
                request.change,
                scenario,
                model,
                noises_dn=noises_dn,
                contrasts_dn=request.contrasts_dn,
                observers=request.observers,
            )
            bar.advance_to(number + 1)
    return curves


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


def _artefacts(cells: Sequence[SceneStatistics], model: int, zooms: int) -> list[ArtefactTiles]:
    return [
        ArtefactTiles.joined([cell.artefact(model, zoom) for cell in cells])
        for zoom in range(zooms)
    ]
