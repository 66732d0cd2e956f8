"""Pairs of photographs with and without a change, for training a detector."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

from acquisition.photographs import ReadOptions, each_image
from analysis.errors import ResultsFileError
from analysis.evaluation.change_pairs import (
    ChangePairsDataset,
    ChangePairsTask as ChangePairsTask,
    ChangePairsWork,
    read_dataset,
    write_change_pairs,
)
from analysis.sweep import SweepOptions, SweepSummary
from simulation.arguments import checked
from simulation.choices import PsfShape
from simulation.notebook import Shown
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import Call, FilePath, Progress, PsfLike, listed_paths, path_of
from standoff.library.psf import camera_psf
from standoff.library.swept_photographs import colour_scene_image, photograph_depth


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ChangePairs(Shown):
    """A data set of change pairs, and how many photographs could be used.

    ``dataset`` is complete unless only a part of the photographs was processed.
    """

    dataset: ChangePairsDataset
    photographs: SweepSummary
    notes: tuple[str, ...] = ()


@checked
def change_pairs(
    photographs: FilePath | Iterable[FilePath],
    out: FilePath,
    psf: PsfLike | None,
    task: ChangePairsTask | None = None,
    *,
    depth: FilePath | None = None,
    transfer: PsfShape = "best",
    sweep: SweepOptions | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> ChangePairs:
    """Write pairs of photographs with and without a change, for training a detector.

    For each photograph, ``out`` receives one compressed ``.npz`` file of numpy, in ``train`` or
    ``test``, with references, follow-ups from another pose, homographies, labels and masks of the
    change; dataset.json describes them all. A second call writes what is missing. A photograph that
    cannot be read, or is too small, is left out and listed; photographs with the same content share
    a file.

    Parameters
    ----------
    photographs
        Photographs of the scene, or folders of them.
    out
        Folder for the pairs.
    psf
        The camera's PSF; only model ``bicubic`` works without it.
    task
        Ranges of poses, noise and changes, and the number of pairs; the defaults of
        ``ChangePairsTask`` if None.
    depth
        Folder of depth maps or lists of planes, as in `evaluate`. A change that is hidden is
        labelled as none. By default scenes are flat.
    transfer
        Which PSF of a calibration to use: ``measured``, ``gaussian``, or ``best``: the measured
        one if the calibration has it, else the Gaussian.
    sweep
        Number of worker processes, and which part of the work to do, see `SweepOptions`; by
        default this process does all of it.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    ChangePairs
        ``dataset``, whose ``pairs("train")`` reads the pairs, and counts of the photographs.

    Raises
    ------
    ArgumentError
        If the model needs a PSF.
    ApplicationError, CalibrationError, ResultsFileError
        If the PSF cannot be read, no photograph can be used, or ``out`` holds pairs with other
        settings or cannot be written.
    SweepError
        If no usable worker is available, or, with ``strict``, a photograph cannot be used.

    Examples
    --------
    >>> task = standoff.ChangePairsTask(zooms=(1, 1.5), crop_px=64, pairs=2, test_fraction=0)
    >>> made = standoff.change_pairs("photographs", "pairs", "psf.json", task)
    >>> len(list(made.dataset.pairs("train")))
    8
    """
    call = Call("change_pairs", progress, reading, (psf,))
    task = task or ChangePairsTask()
    known = None if psf is None else camera_psf(call, psf, transfer)
    if known is None and task.model != "bicubic":
        raise ArgumentError(f"model {task.model} needs a PSF", argument="psf")
    options = call.inputs.options
    if depth is not None:
        depth = path_of(depth, "depth").absolute()
    work = ChangePairsWork(
        out=path_of(out, "out").absolute(),
        task=task,
        psf=known,
        load=partial(colour_scene_image, options),
        reading=str(options) if depth is None else str((str(options), str(depth))),
        depth=None if depth is None else partial(photograph_depth, depth),
    )
    paths = each_image(listed_paths(photographs, "photographs"))
    try:
        dataset, summary = write_change_pairs(call, paths, work, sweep)
    except ResultsFileError as error:
        raise ApplicationError(str(error)) from error
    if summary.images == 0 and summary.refused:
        raise ApplicationError(f"{summary.refused_lines[0]}; no photograph could be used")
    return ChangePairs(dataset=dataset, photographs=summary, notes=call.notes)


@checked
def read_change_pairs(folder: FilePath) -> ChangePairsDataset:
    """Return the data set in a folder that ``change_pairs`` wrote.

    Parameters
    ----------
    folder
        The folder, with its dataset.json.

    Returns
    -------
    ChangePairsDataset
        Description of the data set; ``pairs("train")`` and ``pairs("test")`` read the pairs.

    Raises
    ------
    ResultsFileError
        If its dataset.json cannot be read.

    Examples
    --------
    >>> task = standoff.ChangePairsTask(zooms=(1, 1.5), crop_px=64, pairs=2, test_fraction=0)
    >>> made = standoff.change_pairs("photographs", "pairs", "psf.json", task)
    >>> pairs = list(standoff.read_change_pairs("pairs").pairs("train"))
    >>> len(pairs)
    8
    """
    return read_dataset(path_of(folder, "folder"))
