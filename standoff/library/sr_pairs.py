"""Pairs of crops that train super-resolution, cut from any number of photographs."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path

from acquisition.files import is_there, write_file
from acquisition.photographs import ReadOptions, each_image, marked_png, read_photograph
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.remote_files import is_url, remote_status, url_of
from analysis.choices import PairFormat
from analysis.errors import SrDatasetError
from analysis.sr_dataset import (
    DATASET_NAME,
    PairPhotograph,
    SrDatasetSettings,
    SrDatasetSummary as SrDatasetSummary,
    pair_files_in,
    write_sr_dataset,
)
from analysis.sweep import SweepOptions as SweepOptions
from simulation.arguments import checked
from simulation.choices import DEFAULT_MODEL, Model, PsfShape
from standoff.errors import ApplicationError
from standoff.library.call import Call, FilePath, Progress, PsfLike, listed_paths, path_of
from standoff.library.psf import psf_and_field
from standoff.library.swept_photographs import refusing


@checked
def training_pairs(
    images: FilePath | Iterable[FilePath],
    out: FilePath,
    *,
    psf: PsfLike,
    zoom: float,
    model: Model = DEFAULT_MODEL,
    transfer: PsfShape = "best",
    crop_px: int = 192,
    stride_px: int | None = None,
    test_fraction: float = 0.1,
    seed: int = 0,
    is_float: bool = False,
    format: PairFormat = "folder",  # noqa: A002 - the word of the command line
    threads: int = 1,
    sweep: SweepOptions | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> SrDatasetSummary:
    """Cut photographs into crops, and pair each with its image from ``zoom`` times further away.

    A second call writes what is missing. A photograph that cannot be read, or is too small for a
    crop, is left out and named in the summary; of several with the same content, one is used.

    Parameters
    ----------
    images
        Photographs, or folders of them; URLs as well.
    out
        Folder for the pairs. For a URL such as ``s3://bucket/pairs``, they are made in the folder
        ``pairs`` of the working directory; once all are done, what the URL lacks is copied to it.
    psf
        The camera's PSF.
    zoom
        Ratio of the distances, at least 1.
    model, transfer
        Capture model, and which PSF of a calibration to use; as in ``simulate``.
    crop_px, stride_px
        Side of the high-resolution crops, and the distance from one to the next; the latter is by
        default the side.
    test_fraction, seed
        Share of the photographs kept for testing, and the seed of that choice.
    is_float
        Whether to write float32 TIFFs instead of rounded PNGs.
    format
        ``folder``, or ``webdataset`` for tar files.
    threads
        Number of threads that share the rows of an image.
    sweep
        Number of worker processes, and which part of the work to do, see `SweepOptions`; by
        default this process does all of it.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    SrDatasetSummary
        How many pairs there are for training and for testing, and which photographs were left out.

    Raises
    ------
    ApplicationError
        If ``out`` holds pairs with other settings, or cannot be written.
    SweepError
        If no usable worker is available, or, with ``strict``, an image cannot be used.

    Examples
    --------
    >>> made = standoff.training_pairs(
    ...     "photographs", "sr-pairs", psf="psf.json", zoom=2, crop_px=96, test_fraction=0
    ... )
    >>> made.train
    24
    """
    call = Call("training_pairs", progress, reading, (psf,))
    known, field = psf_and_field(call, psf, model, transfer)
    options = call.inputs.options
    settings = SrDatasetSettings(
        zoom=zoom,
        model=model,
        psf=known,
        field=field,
        threads=threads,
        crop_px=crop_px,
        stride_px=stride_px or crop_px,
        test_fraction=test_fraction,
        seed=seed,
        is_float=is_float,
        reading={
            "encoding": "auto" if options.encoding is None else options.encoding.name,
            "page": options.page,
            "is_mean": options.is_mean,
        },
        format=format,
    )
    paths = each_image(listed_paths(images, "images"))
    source = partial(pair_photograph, options)
    target = path_of(out, "out")
    folder = _made_in(target)
    try:
        found = write_sr_dataset(call, folder, paths, settings, source, sweep)
    except SrDatasetError as error:
        raise ApplicationError(str(error)) from error
    if folder != target and (sweep or SweepOptions()).part[1] == 1:
        count = _copied(folder, target, pair_files_in(folder), folder / DATASET_NAME)
        call.announce(f"{count} files were copied from {folder} to {url_of(target)}")
    return replace(found, notes=call.notes)


def pair_photograph(options: ReadOptions, path: Path) -> PairPhotograph:
    """Read a photograph that pairs are cut from."""
    with refusing():
        photograph = read_photograph(path, options)
        return PairPhotograph(
            path=path,
            stored=photograph.stored,
            linear=photograph.colour_planes,
            encode=lambda linear: photograph.encoding.encode(linear, photograph.white_dn),
            marked=lambda png: marked_png(png, photograph.encoding),
            encoding=photograph.encoding.name,
            sha256=photograph.sha256 or "",
            notes=photograph.remarks,
        )


_NAMED_BY_CONTENT = frozenset({".png", ".tif"})


def _made_in(out: Path) -> Path:
    """Return where a folder of results is made: for a URL, its last part in the working folder."""
    if not is_url(out):
        return out
    is_there(out)
    return Path(out.name)


def _copied(folder: Path, out: Path, files: Iterable[Path], last: Path) -> int:
    """Copy files of a folder to a URL; return how many were copied.

    Images that the URL already holds, in the same size, are not copied again. ``last`` is copied
    after all others.
    """
    count = 0
    for file in (*sorted(files), last):
        target = out / file.relative_to(folder)
        try:
            size_bytes = file.stat().st_size
            if file.suffix in _NAMED_BY_CONTENT and _size_bytes(target) == size_bytes:
                continue
            data = read_regular_file(file, max(size_bytes, LARGEST_IMAGE_BYTES))
        except OSError as error:
            raise ApplicationError(
                f"cannot copy {file} to {url_of(out)}: {error.strerror}"
            ) from error
        write_file(target, data)
        count += 1
    return count


def _size_bytes(path: Path) -> int:
    try:
        return remote_status(path).size_bytes
    except FileNotFoundError:
        return -1
