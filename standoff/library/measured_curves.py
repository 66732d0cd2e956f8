"""Measures curves of d' against zoom on many photographs, and draws them."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from heapq import nsmallest
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from acquisition.files import written_together
from acquisition.photographs import ReadOptions, each_image
from acquisition.printable import on_one_line
from acquisition.remote_files import is_url
from analysis.detectability import (
    MOST_SCENES,
    ArtefactWork,
    DetectabilityCurve,
    DetectabilityCurves,
    DetectionTask,
    PatchSignal,
    SweepSums,
    curves_of,
    read_curves,
)
from analysis.errors import ResultsFileError
from analysis.parquet_table import write_parquet
from analysis.reports import plot_detectability, write_figure
from analysis.results_file import write_results
from analysis.sweep import Manifest, SweepOptions, SweepSummary, announced_sweep
from simulation import Psf
from simulation.arguments import checked
from simulation.arrays import FloatArray
from simulation.choices import PsfShape
from simulation.notebook import Shown
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import (
    Call,
    FilePath,
    ImageLike,
    NoiseLike,
    Progress,
    PsfLike,
    camera_noise,
    listed_paths,
    output_path,
    path_of,
)
from standoff.library.detectability import known_errors, noise_relative_err
from standoff.library.psf import camera_psf
from standoff.library.swept_photographs import list_inputs, scene_image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

_COPIES_NAME = "copies.txt"

_TEXT = ("model", "observer")
_NUMBERS = ("noise_dn", "contrast_dn", "signal_sigma_px", "zoom")
_FOUND = ("dprime", "dprime_low", "dprime_high", "auc")
_COLUMNS = dict.fromkeys(_TEXT, str) | dict.fromkeys((*_NUMBERS, *_FOUND), float)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class MeasuredCurves(Shown):
    """Curves of d', and how many photographs could be used.

    ``curves`` is None if only a part of the photographs was measured. ``copies_list`` is the file
    that lists photographs with the same content as another one, None if there are no such ones.
    """

    curves: DetectabilityCurves | None
    photographs: SweepSummary
    copies: int = 0
    copies_list: Path | None = None
    notes: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        return Shown._repr_html_(self) if self.curves is None else self.curves._repr_html_()

    def to_dataframe(self) -> "DataFrame":
        """Return the curves as a pandas table, one row per curve and zoom."""
        return self._whole.to_dataframe()

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of d' against zoom."""
        return self._whole.plot(ax)

    @property
    def _whole(self) -> DetectabilityCurves:
        if self.curves is None:
            raise ArgumentError(
                "one part of the photographs alone gives no curves; measure the other parts"
            )
        return self.curves

    def write(self, path: FilePath, *, parquet: bool = False) -> list[Path]:
        """Write curves.json, and the figures beside it, all or none; return the figures' paths.

        With ``parquet``, the curves are also written as a Parquet table, one row per curve and
        zoom.

        Raises
        ------
        ArgumentError
            If there are no curves.
        ApplicationError, ResultsFileError
            If a file cannot be written.
        """
        out, found = output_path(path, "path", {".json"}), self._whole
        with written_together(out) as folder:
            write_results(folder / out.name, found)
            _write_curve_figures(folder / out.name, found.curves, found.curves[0].contrast_dn)
            if parquet:
                write_parquet(folder / curve_table_path(out).name, _COLUMNS, found.rows())
        return curve_figure_paths(out)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Asked:
    """What is measured: ``noise`` is a camera's, instead of the task's."""

    task: DetectionTask
    psf: Psf | None
    noise: NoiseLike | None

    def task_on(self, sums: SweepSums) -> DetectionTask:
        """Return the task with the noise that the camera has at the photographs' mean level."""
        known = camera_noise(self.noise)
        if self.noise is None or known is None:
            return self.task
        levels = np.fromiter((one.mean_dn for one in sums.photographs()), np.float64)
        noise_dn = math.sqrt(float(known.variance_dn2(levels).mean()))
        relative_err = noise_relative_err(self.noise, levels)
        return replace(
            self.task,
            noises_dn=(noise_dn,),
            sources=self.task.sources.model_copy(update={"noise_relative_err": relative_err}),
        )


@checked
def measure_curves(
    images: FilePath | Iterable[FilePath],
    state: FilePath,
    psf: PsfLike | None = None,
    task: DetectionTask | None = None,
    *,
    transfer: PsfShape = "best",
    signal: ImageLike | None = None,
    noise: NoiseLike | None = None,
    focus_scatter_px2: float | None = None,
    registration_err_px: float | None = None,
    sweep: SweepOptions | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> MeasuredCurves:
    """Measure how well a change can be detected, at best, on any number of photographs.

    An interrupted measurement is resumed from ``state`` by the same call. A photograph that cannot
    be measured is left out and listed.

    Parameters
    ----------
    images
        Photographs of the scene, or folders of them.
    state
        Folder that keeps the results of each photograph, so that the measurement can be resumed.
    psf
        The camera's PSF; only model ``bicubic`` works without it.
    task
        Zooms, noises, contrasts, models and observers; the defaults of ``DetectionTask`` if None.
    transfer
        Which PSF of a calibration to use: ``measured``, ``gaussian``, or ``best``: the measured
        one if the calibration has it, else the Gaussian.
    signal
        Image patch to use as the change, instead of the task's.
    noise
        Noise of a capture, or the path of a noise.json, instead of the task's noises.
    focus_scatter_px2
        Standard deviation of the PSF's variance from capture to capture, for the intervals; by
        default that of the calibration, if it states one.
    registration_err_px
        Standard deviation of a pair's registration error along either axis.
    sweep
        Number of worker processes, and which part of the work to do, see `SweepOptions`; by
        default this process does all of it.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    MeasuredCurves
        ``curves``, unless only a part of the photographs was measured, and their counts.

    Raises
    ------
    ArgumentError
        If the change does not fit into the window.
    ApplicationError, AnalysisError, CalibrationError
        If the PSF cannot be read, ``state`` cannot be written, no usable worker is available, or no
        photograph can be measured.

    Examples
    --------
    >>> task = standoff.DetectionTask(
    ...     zooms=(1.0, 1.5), models=("matched",), observers=("npw",), noises_dn=(12.0,)
    ... )
    >>> measured = standoff.measure_curves("photographs", "sweep", "psf.json", task)
    >>> len(measured.curves.curves)
    1
    """
    call = Call("measure_curves", progress, reading, (psf, noise))
    asked = _Asked(
        task=replace(
            _with_signal(call, task or DetectionTask(), signal),
            sources=known_errors(
                psf,
                focus_scatter_px2=focus_scatter_px2,
                registration_err_px=registration_err_px,
            ),
        ),
        psf=None if psf is None else camera_psf(call, psf, transfer),
        noise=noise,
    )
    camera_noise(noise)  # a wrong file is refused before the work
    paths = each_image(listed_paths(images, "images"))
    folder = path_of(state, "state").absolute()
    measured = _measured(call, paths, folder, asked, sweep or SweepOptions())
    if measured.curves is None:
        return replace(measured, notes=call.notes)
    named = path_of(signal, "signal").name if isinstance(signal, str | PathLike) else None
    curves = measured.curves.model_copy(
        update={"signal": named or measured.curves.signal, "provenance": call.provenance()}
    )
    if measured.copies:
        have = "photograph has" if measured.copies == 1 else "photographs have"
        call.note(
            f"{measured.copies} {have} the same content as another; every copy is counted; "
            f"see {measured.copies_list}"
        )
    return replace(measured, curves=curves, notes=call.notes)


def _with_signal(call: Call, task: DetectionTask, signal: ImageLike | None) -> DetectionTask:
    if signal is not None:
        patch = call.photograph(signal, "signal")
        try:
            task = replace(task, signal=PatchSignal(levels_dn=patch.grey_dn))
        except ValueError as error:
            raise ApplicationError(f"{patch.name}: {error}") from error
    if 2 * task.signal.reach_px / task.reference_zoom > task.window_px:
        raise ArgumentError(f"the change exceeds the window of {task.window_px} px; widen it")
    return task


def _measured(
    call: Call,
    images: Iterable[Path],
    state: Path,
    asked: _Asked,
    options: SweepOptions,
) -> MeasuredCurves:
    inputs = call.inputs
    with Manifest(images, state) as manifest:
        plan = replace(asked.task.plan(asked.psf, len(manifest)), reading=str(inputs.options))
        work = ArtefactWork(plan=plan, load=partial(scene_image, inputs.options), folder=state)
        summary, records = announced_sweep(call, "measuring images", manifest, work, options)
        if options.part[1] > 1:
            return MeasuredCurves(curves=None, photographs=summary)
        if summary.images == 0:
            raise ApplicationError(f"{summary.refused_lines[0]}; no photograph could be measured")
        records.tidy()
        sums = SweepSums(records)
        some = _some_photographs(sums, manifest, inputs.options)
        list_inputs(inputs, sums.images, sums.photographs(), state)
        copies = sums.list_copies(state / _COPIES_NAME)
        task = asked.task_on(sums)
        with call.bar("computing d'", len(task.models)) as advance_to:
            curves = curves_of(sums.artefacts, sums.images, plan, task, advance_to, some)
    return MeasuredCurves(
        curves=curves,
        photographs=summary,
        copies=copies,
        copies_list=state / _COPIES_NAME if copies else None,
    )


def _some_photographs(
    sums: SweepSums, manifest: Manifest, options: ReadOptions
) -> list[FloatArray]:
    """Read a few photographs again, those of the least hashes, whatever the order of the paths."""
    least = nsmallest(MOST_SCENES, sums.photographs(), key=lambda one: (one.sha256, one.path))
    # What is kept of a photograph has its path as it is printed.
    wanted = {one.path for one in least}
    found = {
        printed: item.path for item in manifest if (printed := on_one_line(item.path)) in wanted
    }
    return [scene_image(options, found[one.path]).grey_dn for one in least]


def curves_made_by(path: Path) -> str | None:
    """Return what made a curves.json; None if there is no such file, or it is not known."""
    try:
        stored = read_curves(path).provenance if not is_url(path) and path.is_file() else None
    except ResultsFileError:
        return None
    return None if stored is None else stored.command


def state_of_curves(out: FilePath) -> Path:
    """Folder of the results per photograph: beside the curves; for a URL, in the working folder."""
    path = path_of(out, "out")
    return (Path(path.name) if is_url(path) else path).with_suffix(".sweep")


def curve_table_path(out: Path) -> Path:
    """Path of the table beside the curves ``out``."""
    return out.with_suffix(".parquet")


def curve_figure_paths(out: Path) -> list[Path]:
    """Paths of the figures beside the curves ``out``: by noise and by contrast, PNG and SVG."""
    return [
        out.with_name(f"{out.stem}-{name}{suffix}")
        for name in ("noise", "contrast")
        for suffix in (".png", ".svg")
    ]


def _write_curve_figures(
    out: Path, curves: Sequence[DetectabilityCurve], contrast_dn: float
) -> None:
    """Draw the curves beside ``out``: by noise at one contrast, by contrast at the middle noise."""
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
