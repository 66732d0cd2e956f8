"""Measures curves of d' against zoom on many photographs, and draws them."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path

import numpy as np

from acquisition.session import file_sha256
from analysis.detectability import (
    ArtefactWork,
    DetectabilityCurve,
    DetectabilityCurves,
    DetectionTask,
    SceneImage,
    SweepSums,
    curves_of,
)
from analysis.errors import RefusedPhotographError
from analysis.reports import plot_detectability
from analysis.sweep import Manifest, SweepOptions, SweepSummary, run_sweep, sorted_lines
from simulation.capture_noise import CaptureNoise
from simulation.choices import PsfShape
from standoff.errors import ApplicationError, ImageFileError
from standoff.photographs import Inputs, ReadOptions, read_image
from standoff.terminal import progress_bar
from standoff.workflows.figure_files import write_figure
from standoff.workflows.psf_files import read_camera_psf

_MOST_INPUTS = 10_000
"""Of more photographs, provenance names the list alone."""

_LIST_NAME = "photographs.sha256"
_COPIES_NAME = "copies.txt"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurvesRequest:
    """The photographs, the change to detect in them, and who works.

    ``transfer`` says which PSF of the psf.json is used. ``noise`` is a camera's noise, instead of
    the task's; its value at the mean level of the photographs is used. ``inputs`` says how the
    photographs are read; its list of them is filled here.
    """

    images: Iterable[Path]
    psf: Path | None
    transfer: PsfShape
    task: DetectionTask
    noise: CaptureNoise | None
    sweep: SweepOptions
    inputs: Inputs


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredCurves:
    """Curves, and what became of the photographs.

    ``curves`` is None where only a part of the photographs was measured. ``copies_list`` names the
    file that lists photographs with the content of another one, if there are any.
    """

    curves: DetectabilityCurves | None
    photographs: SweepSummary
    copies: int = 0
    copies_list: Path | None = None


def measure_curves(request: CurvesRequest, state: Path) -> MeasuredCurves:
    """Measure the photographs and compute the curves, with progress bars on stderr.

    What is measured is kept in the folder ``state``; an interrupted run resumes from there. A
    photograph that cannot be measured is left out and listed.

    Raises
    ------
    ApplicationError, AnalysisError, CalibrationError
        If the PSF cannot be read, the state cannot be written, no worker is fit, or there is no
        photograph that can be measured.
    """
    state = state.absolute()
    task, inputs = request.task, request.inputs
    psf = None if request.psf is None else read_camera_psf(request.psf, request.transfer)
    with Manifest(request.images, state) as manifest:
        plan = replace(task.plan(psf, len(manifest)), reading=str(inputs.options))
        work = ArtefactWork(plan=plan, load=partial(_scene, inputs.options), folder=state)
        with progress_bar("measuring images", len(manifest)) as bar:
            summary = run_sweep(manifest, work, request.sweep, bar.advance_to)
        for sentence in summary.notes:
            inputs.announce(sentence)
        if request.sweep.part[1] > 1:
            return MeasuredCurves(curves=None, photographs=summary)
        if summary.images == 0:
            raise ApplicationError(f"{summary.refused_lines[0]}; no photograph could be measured")
        sums = SweepSums(manifest, work)
        sums.drop_others(state)
    _list_inputs(sums, inputs, state)
    copies = _list_copies(sums, state)
    if request.noise is not None:
        levels = np.fromiter((one.mean_dn for one in sums.photographs()), np.float64)
        noise_dn = math.sqrt(float(request.noise.variance_dn2(levels).mean()))
        task = replace(task, noises_dn=(noise_dn,))
    with progress_bar("computing d'", len(task.models)) as bar:
        curves = curves_of(sums.artefacts, sums.images, plan, task, bar.advance_to)
    return MeasuredCurves(
        curves=curves,
        photographs=summary,
        copies=copies,
        copies_list=state / _COPIES_NAME if copies else None,
    )


def _scene(options: ReadOptions, path: Path) -> SceneImage:
    try:
        photograph = read_image(path, options)
        grey_dn = photograph.grey_dn
    except ImageFileError as error:
        raise RefusedPhotographError(str(error)) from error
    return SceneImage(
        grey_dn=grey_dn,
        sha256=photograph.sha256 or "",
        encoding=photograph.encoding.name,
        notes=photograph.remarks,
    )


def _list_inputs(sums: SweepSums, inputs: Inputs, state: Path) -> None:
    """List the photographs, of very many a file that holds their hashes."""
    listed = state / _LIST_NAME
    if sums.images <= _MOST_INPUTS:
        listed.unlink(missing_ok=True)
        for one in sums.photographs():
            inputs.add_known(one.path, one.sha256, one.encoding)
        return
    encodings = set()
    with listed.open("w", encoding="utf-8") as file:
        for one in sums.photographs():
            encodings.add(one.encoding)
            file.write(f"{one.sha256}  {one.path}\n")
    for encoding in sorted(encodings):
        inputs.add_known(str(listed), file_sha256(listed), encoding)


def _list_copies(sums: SweepSums, state: Path) -> int:
    """List the photographs with the content of another one; each counts as often as it comes."""
    lines = (f"{one.sha256}  {one.path}\n".encode() for one in sums.photographs())
    copies = 0
    listed = state / _COPIES_NAME
    with listed.open("wb") as file:
        for same in _of_one_content(sorted_lines(lines, state)):
            copies += len(same) - 1
            file.writelines(same)
    if copies == 0:
        listed.unlink()
    return copies


def _of_one_content(lines: Iterable[bytes]) -> Iterator[list[bytes]]:
    for _, same in groupby(lines, lambda line: line.partition(b" ")[0]):
        found = list(same)
        if len(found) > 1:
            yield found


def curve_figure_paths(out: Path) -> list[Path]:
    """Paths of the figures beside the curves ``out``: by noise and by contrast, PNG and SVG."""
    return [
        out.with_name(f"{out.stem}-{name}{suffix}")
        for name in ("noise", "contrast")
        for suffix in (".png", ".svg")
    ]


def write_curve_figures(
    out: Path, curves: Sequence[DetectabilityCurve], contrast_dn: float
) -> None:
    """Draw the curves beside ``out``: by noise at one contrast, by contrast at the middle noise.

    Raises
    ------
    ApplicationError
        If a file cannot be written.
    """
    noises_dn = sorted({curve.noise_dn for curve in curves})
    middle_dn = noises_dn[len(noises_dn) // 2]
    by_noise = plot_detectability(
        [curve for curve in curves if curve.contrast_dn == contrast_dn], "noise_dn"
    )
    by_contrast = plot_detectability(
        [curve for curve in curves if curve.noise_dn == middle_dn], "contrast_dn"
    )
    figures = (by_noise, by_noise, by_contrast, by_contrast)
    for path, figure in zip(curve_figure_paths(out), figures, strict=True):
        write_figure(path, figure)
