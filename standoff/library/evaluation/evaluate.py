"""Evaluates a change detector on pairs that the capture model makes from photographs.

Changes are those of the task, a picture with alpha, or photographs of later with masks.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from heapq import nsmallest
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import cv2
import numpy as np

from acquisition.files import PAGES, write_page, written_together
from acquisition.photographs import ReadOptions, each_image, read_photograph
from acquisition.printable import on_one_line
from analysis.choices import WINDOW_PX
from analysis.detectability import (
    MOST_SCENES,
    DetectabilityCurve,
    DetectionTask,
    curves_of_images,
)
from analysis.detectors import Detector, DetectorSpec
from analysis.errors import RefusedPhotographError, ResultsFileError
from analysis.evaluation import (
    Evaluation,
    EvaluationTask as EvaluationTask,
    EvaluationWork,
    FailedPair,
    LaterScene,
    Patch as Patch,
    PhotographScores,
    Spot as Spot,
    evaluation_curves,
    read_evaluation,
    scores_of,
)
from analysis.reports import evaluation_figures, evaluation_report, write_figure
from analysis.results_file import write_results
from analysis.sweep import Manifest, SweepOptions, SweepSummary, announced_sweep
from simulation.arguments import ArgumentTypeError, checked, kind_of
from simulation.arrays import FloatArray
from simulation.choices import PsfShape
from simulation.notebook import Shown
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import (
    Call,
    FilePath,
    Progress,
    PsfLike,
    listed_paths,
    output_path,
    path_of,
)
from standoff.library.psf import camera_psf
from standoff.library.swept_photographs import (
    colour_scene_image,
    list_inputs,
    named_as,
    photograph_depth,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

_FAILED_LISTED = 100
_WIDEST_WINDOW_PX = 61
"""Of the bound: its time grows with the sixth power."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class EvaluatedDetector(Shown):
    """How well a detector does, and how many photographs could be used.

    ``evaluation`` is None if only a part of the photographs was processed.
    """

    evaluation: Evaluation | None
    photographs: SweepSummary
    notes: tuple[str, ...] = ()

    def write(self, path: FilePath, *, report: FilePath | None = None) -> list[Path]:
        """Write evaluation.json and its figures, all or none, and a report page if asked for.

        Returns
        -------
        list of Path
            The figures.

        Raises
        ------
        ArgumentError
            If only a part of the photographs was processed.
        ApplicationError, ResultsFileError
            If a file cannot be written.
        """
        out, found = output_path(path, "path", {".json"}), self._whole
        page = None if report is None else output_path(report, "report", PAGES)
        figures = evaluation_figures(found)
        with written_together(out) as folder:
            write_results(folder / out.name, found)
            for name, figure in zip(evaluation_figure_paths(out), figures, strict=True):
                write_figure(folder / name.name, figure)
        if page is not None:
            write_page(page, evaluation_report(found).html())
        return evaluation_figure_paths(out)

    def _repr_html_(self) -> str:
        return Shown._repr_html_(self) if self.evaluation is None else self.evaluation._repr_html_()

    def to_dataframe(self) -> "DataFrame":
        """Return the curves as a pandas table, one row per curve and zoom."""
        return self._whole.to_dataframe()

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return the figure of the AUC against zoom.

        Raises
        ------
        ArgumentError
            If only a part of the photographs was processed.
        """
        return self._whole.plot(ax)

    @property
    def _whole(self) -> Evaluation:
        if self.evaluation is None:
            raise ArgumentError("part of the photographs gives no curves; run the other parts")
        return self.evaluation


@checked
def evaluate(
    detector: Detector | str,
    photographs: FilePath | Iterable[FilePath],
    psf: PsfLike | None = None,
    task: EvaluationTask | None = None,
    *,
    state: FilePath | None = None,
    after: FilePath | None = None,
    masks: FilePath | None = None,
    depth: FilePath | None = None,
    transfer: PsfShape = "best",
    timeout_s: float = 60.0,
    sweep: SweepOptions | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> EvaluatedDetector:
    """Measure how well a change detector does on follow-ups from other poses of the camera.

    Pairs are cut from each photograph and simulated, with a change and without one; the detector
    gives each pair a score. Pairs to which it gives none are left out and listed.

    Parameters
    ----------
    detector
        A function that takes a reference, a follow-up and the homography from follow-up to
        reference pixels, and returns a number, or a map of the follow-up's shape: the higher, the
        more has changed. If it has an attribute ``colour = True`` it is given red, green and blue,
        otherwise grey levels; see `Detector`. Or a text: ``module:function``, a command line with
        ``{reference}``, ``{followup}``, ``{homography}`` and ``{out}``, the path of an ONNX file,
        or the name of a built-in detector.
    photographs
        Photographs of the scene, or folders of them.
    psf
        The camera's PSF; only model ``bicubic`` works without it.
    task
        Poses, noise, changes and the number of pairs; the defaults of ``EvaluationTask`` if None.
    state
        Folder that keeps the scores, from which the same call resumes after an interruption.
    after, masks
        Real changes instead of the task's: a folder of later photographs from the same pose, and a
        folder of masks of what changed, each file named like its photograph.
    depth
        Folder of depth maps or lists of planes, as ``read_depth`` reads them, each named like its
        photograph: then nearer things are displaced and hide others, while detectors are told the
        homography of the plane at the depth of a pair's middle. By default scenes are flat.
    transfer
        Which PSF of a calibration to use: ``measured``, ``gaussian``, or ``best``: the measured
        one if the calibration has it, else the Gaussian.
    timeout_s
        Longest time in s that the detector may take for one pair. There is no such limit for a
        detector that is passed as a Python function.
    sweep
        Number of worker processes, and which part of the work to do, see `SweepOptions`; with
        ``strict``, the first pair without a score ends the evaluation.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    EvaluatedDetector
        ``evaluation``, and counts of the photographs.

    Raises
    ------
    ArgumentError
        If the detector cannot be understood, or one of ``after`` and ``masks`` is missing.
    ApplicationError, AnalysisError, CalibrationError
        If the PSF cannot be read, no photograph can be used, or the detector gives no score.

    Examples
    --------
    >>> task = standoff.EvaluationTask(zooms=(1.0, 1.5), crop_px=64, crops=4, contrasts_dn=(900.0,))
    >>> found = standoff.evaluate("my_module:detector", "photographs", "psf.json", task)
    >>> found.evaluation.curves[0].zoom
    [1.0, 1.5]
    """
    call = Call("evaluate", progress, reading, (psf,))
    task = task or EvaluationTask()
    known = None if psf is None else camera_psf(call, psf, transfer)
    if known is None and task.model != "bicubic":
        raise ArgumentError(f"model {task.model} needs a PSF", argument="psf")
    if (after is None) != (masks is None):
        raise ArgumentError("give after and masks together, or neither of them")
    options = call.inputs.options
    later = None
    if after is not None and masks is not None:
        folders = [path_of(one, "folder").absolute() for one in (after, masks)]
        later = partial(later_scene, folders[0], folders[1], options)
    if depth is not None:
        depth = path_of(depth, "depth").absolute()
    sweep = sweep or SweepOptions()
    with ExitStack() as temporary:
        if state is None:
            state = temporary.enter_context(TemporaryDirectory(prefix="standoff-evaluation-"))
        work = EvaluationWork(
            detector=_spec(detector),
            task=task,
            psf=known,
            load=partial(colour_scene_image, options),
            later=later,
            depth=None if depth is None else partial(photograph_depth, depth),
            reading=_reading(options, *(() if later is None else later.args[:2]), depth),
            folder=path_of(state, "state").absolute(),
            timeout_s=timeout_s,
            is_strict=sweep.strict,
        )
        paths = each_image(listed_paths(photographs, "photographs"))
        return _evaluated(call, paths, work, sweep)


def _reading(options: ReadOptions, *folders: Path | None) -> str:
    """How photographs and what goes with them are read, as text."""
    return str((str(options), *(str(one) for one in folders if one is not None)))


def _spec(detector: Detector | str) -> DetectorSpec:
    if isinstance(detector, str):
        return DetectorSpec.parse(detector)
    if not callable(detector):
        raise ArgumentTypeError(
            f"expected a function or what names one, got {kind_of(detector)}", argument="detector"
        )
    return DetectorSpec.of_callable(detector)


def _evaluated(
    call: Call, paths: Iterable[Path], work: EvaluationWork, options: SweepOptions
) -> EvaluatedDetector:
    with Manifest(paths, work.folder) as manifest:
        summary, records = announced_sweep(call, "running the detector", manifest, work, options)
        if options.part[1] > 1:
            return EvaluatedDetector(evaluation=None, photographs=summary, notes=call.notes)
        if summary.images == 0:
            raise ApplicationError(f"{summary.refused_lines[0]}; no photograph could be used")
        records.tidy()

        def scores() -> Iterator[PhotographScores]:
            return (scores_of(one.data.read()) for one in records.answers() if one.refused is None)

        list_inputs(call.inputs, summary.images, scores(), work.folder)
        failed: list[FailedPair] = []
        colour_photographs = 0
        for one in scores():
            failed += one.failed
            colour_photographs += one.is_colour
        if failed and not any(np.isfinite(one.scores).any() for one in scores()):
            first = failed[0]
            raise ApplicationError(
                f"the detector gave no score for any pair; {first.photograph}, {first.pair}: "
                f"{first.message}"
            )
        bounds = _bounds(call, work, scores, manifest, is_colour=colour_photographs > 0)
        with call.bar("computing curves", len(work.task.conditions)) as advance_to:
            curves = evaluation_curves(work.task, work.detector.name, scores, bounds, advance_to)
    found = Evaluation(
        detector=work.detector.name,
        photographs=summary.images,
        colour_photographs=colour_photographs,
        crops=work.task.crops,
        crop_px=work.task.crop_px,
        reference_zoom=work.task.reference_zoom,
        change="later photographs" if work.later is not None else work.task.change.name,
        focus_scatter_px2=work.task.focus_scatter_px2,
        light_scatter=work.task.light_scatter,
        failed_pairs=len(failed),
        failed=failed[:_FAILED_LISTED],
        curves=curves,
        provenance=call.provenance(),
    )
    return EvaluatedDetector(evaluation=found, photographs=summary, notes=call.notes)


def _bounds(
    call: Call,
    work: EvaluationWork,
    scores: Callable[[], Iterator[PhotographScores]],
    manifest: Manifest,
    *,
    is_colour: bool,
) -> dict[tuple[float, float], DetectabilityCurve]:
    """D' of Hotelling's observer on a few photographs, by noise and contrast; of spots alone."""
    task = work.task
    noises = tuple(noise for noise in task.noises_dn if noise > 0)
    if not isinstance(task.change, Spot) or work.later is not None or not noises:
        return {}
    window_px = 2 * ceil(task.change.reach_px / task.reference_zoom) + 1
    if window_px > _WIDEST_WINDOW_PX:
        call.announce(
            f"no bound is given: for changes wider than {_WIDEST_WINDOW_PX // 12} px (sigma on the "
            "reference) it would take too long"
        )
        return {}
    if work.depth is not None:
        call.announce("no bound is given: it applies to flat scenes")
        return {}
    if is_colour:
        call.announce("no bound is given: it applies to grey levels, and these pairs are in colour")
        return {}
    least = nsmallest(MOST_SCENES, ((one.sha256, one.path) for one in scores()))
    wanted = {path for _, path in least}
    found = [item.path for item in manifest if on_one_line(item.path) in wanted]
    widest = task.zooms[-1] / np.cos(np.radians(max(map(abs, task.tilts_deg))))
    zooms = {*task.zooms, float(widest), 1.0}
    with call.bar("computing the bound", 1) as advance_to:
        curves = curves_of_images(
            [work.load(path).grey_dn for path in found],
            work.psf,
            DetectionTask(
                signal=task.change,
                noises_dn=noises,
                contrasts_dn=tuple(abs(one) for one in task.contrasts_dn),
                zooms=tuple(sorted(zooms)),
                models=(task.model,),
                observers=("hotelling",),
                reference_zoom=task.reference_zoom,
                window_px=max(window_px, WINDOW_PX),
            ),
        )
        advance_to(1)
    known = {(one.noise_dn, one.contrast_dn): one for one in curves.curves}
    return {
        (noise, contrast): known[noise, abs(contrast)]
        for noise in noises
        for contrast in task.contrasts_dn
    }


def evaluation_figure_paths(out: Path) -> list[Path]:
    """Paths of the figures beside the evaluation ``out``: AUC against zoom, and ROC."""
    return [
        out.with_name(f"{out.stem}-{name}{suffix}")
        for name in ("auc", "roc")
        for suffix in (".png", ".svg")
    ]


def evaluation_made_by(path: Path) -> str | None:
    """Return what made an evaluation.json; None if there is no such file, or it is not known."""
    try:
        stored = read_evaluation(path).provenance if path.is_file() else None
    except ResultsFileError:
        return None
    return None if stored is None else stored.command


@checked
def patch_of(path: FilePath, reading: ReadOptions | None = None) -> Patch:
    """Return a picture as a change; the alpha channel of a PNG or TIFF says what it covers.

    Its levels are read like those of photographs. Without an alpha channel, the whole picture
    covers the scene.

    Parameters
    ----------
    path
        The picture.
    reading
        How its levels are read; see ``standoff.reading``.

    Returns
    -------
    Patch
        For ``EvaluationTask(change=...)``.

    Raises
    ------
    ApplicationError
        If the picture cannot be used as a change.
    ImageFileError
        If it cannot be read.

    Examples
    --------
    >>> crack = standoff.patch_of("crack.png")
    >>> task = standoff.EvaluationTask(change=crack, contrasts_dn=(1.0,))
    """
    file = Path(path)
    levels = np.asarray(read_photograph(file, reading or ReadOptions()).shown_dn, np.float64)
    stored = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    alpha: FloatArray = np.ones(levels.shape[:2])
    if stored is not None and stored.ndim == 3 and stored.shape[2] == 4:
        full = {"uint8": 255.0, "uint16": 65535.0}.get(stored.dtype.name, 1.0)
        alpha = np.asarray(stored[:, :, 3] / full, np.float64)
    try:
        return Patch(levels_dn=levels, alpha=alpha, name=on_one_line(file.name))
    except ValueError as error:
        raise ApplicationError(f"{on_one_line(file)}: {error}") from error


def later_scene(after: Path, masks: Path, options: ReadOptions, photograph: Path) -> LaterScene:
    """Read the later photograph and the mask of a photograph's name; refuse it without them."""
    later = colour_scene_image(options, named_as(photograph, after, "photograph of later"))
    mask = colour_scene_image(options, named_as(photograph, masks, "mask"))
    try:
        after_dn = later.grey_dn if later.colours is None else later.colours()
        return LaterScene(after_dn=after_dn, mask=mask.grey_dn > 0)
    except ValueError as error:
        raise RefusedPhotographError(str(error)) from error
