"""A folder of super-resolution pairs with its manifest, written shard by shard and resumable."""

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any
from uuid import uuid4

from acquisition.printable import on_one_line
from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_json
from analysis.sweep import (
    Manifest,
    SweepItem,
    SweepOptions as SweepOptions,
    SweepSummary,
    run_sweep,
    whole_file,
)
from calibration.provenance import Provenance
from simulation.choices import DEFAULT_MODEL, Model, PsfShape
from standoff.errors import ApplicationError
from standoff.library.call import Call, Progress
from standoff.library.files import each_image
from standoff.library.inputs import FilePath, PsfLike, path_of
from standoff.library.psf import psf_and_field
from standoff.library.sr_pairs.choices import PairFormat
from standoff.library.sr_pairs.copies import copies_in
from standoff.library.sr_pairs.listing import COMMITTED_NAMES, Listing, list_pairs
from standoff.library.sr_pairs.settings import SPLITS, SrDatasetSettings
from standoff.library.sr_pairs.shard_work import STATE_NAME, PairShards
from standoff.photographs import ReadOptions

DATASET_NAME = "dataset.json"
_COPIES_NAME = "copies.txt"


@dataclass(frozen=True, slots=True, kw_only=True)
class SrDatasetSummary:
    """What a run made, or found done by earlier ones.

    ``images`` are all that were given, ``copies`` those with the content of another one.
    ``refused`` says for the first ten images without pairs why they have none, ``refused_list``
    names the file that says it for all ``refused_images``.
    """

    train: int
    test: int
    images: int
    images_found_done: int
    copies: int
    refused_images: int
    refused: tuple[str, ...] = ()
    refused_list: str | None = None
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the counts as ``standoff sr-pairs --json`` prints them, without the folder."""
        facts = asdict(self)
        del facts["notes"]
        return facts


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
    """Cut photographs into crops, each paired with its image from ``zoom`` times further away.

    A second call writes what is missing. A photograph that cannot be read, or is too small for a
    crop, is left out and named in the summary; of several with the same content one is taken.

    Parameters
    ----------
    images
        Photographs, or folders of them.
    out
        Folder for the pairs.
    psf
        Of the camera.
    zoom
        Ratio of the distances, at least 1.
    model, transfer
        Capture model, and which PSF of a calibration; as in ``simulate``.
    crop_px, stride_px
        Side of the high-resolution crops, and the distance between them, by default their side.
    test_fraction, seed
        Share of the photographs kept for testing, and the seed of that choice.
    is_float
        Write float32 TIFFs instead of rounded PNGs.
    format
        ``folder``, or ``webdataset`` for tar files.
    threads
        Threads that share the rows of an image.
    sweep
        Who works, and on what part; by default this process, on all.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Who watches.

    Raises
    ------
    ApplicationError
        If ``out`` holds pairs with other settings, or cannot be written.
    SweepError
        If no worker is fit, or, when strict, an image is refused.

    Examples
    --------
    >>> standoff.training_pairs("photographs", "pairs", psf="psf.json", zoom=2).train
    """
    call = Call("training_pairs", progress, reading, (psf,))
    known, field = psf_and_field(call, psf, model, transfer)
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
        format=format,
    )
    listed = [images] if isinstance(images, str | PathLike) else images
    paths = each_image(path_of(image, "images") for image in listed)
    found = write_sr_dataset(call, path_of(out, "out"), paths, settings, sweep)
    return replace(found, notes=call.notes)


def write_sr_dataset(
    call: Call,
    out: Path,
    images: Iterable[Path],
    settings: SrDatasetSettings,
    options: SweepOptions | None = None,
) -> SrDatasetSummary:
    """Write the pairs of every image below ``out``; a second run writes what is missing.

    The manifest is written by a run that does all parts.
    """
    out, options = out.absolute(), options or SweepOptions()
    state = out / STATE_NAME
    provenance = call.provenance()
    document = settings.document(call.inputs.options)
    committed = state / COMMITTED_NAMES.replace("*", uuid4().hex)
    try:
        _prepare(out, document, provenance)
        with Manifest(images, state) as given:
            copies = _copies(call, given, state)
            work = PairShards(out, settings, call.inputs.options, committed)
            with Manifest(_without(copies, given), state) as manifest:
                done = _swept(call, manifest, work, options)
            for sentence in done.notes:
                call.announce(sentence)
            listing = list_pairs(out, state, committed, is_whole=options.part[1] == 1)
            if options.part[1] == 1:
                _describe(out, document, listing.in_provenance(provenance))
            return _summary(len(given), len(copies), done, listing)
    except OSError as error:
        raise ApplicationError(f"{error.filename or out}: {error.strerror}") from error
    finally:
        with suppress(OSError):
            committed.unlink(missing_ok=True)


def _swept(call: Call, manifest: Manifest, work: PairShards, options: SweepOptions) -> SweepSummary:
    with call.bar("cutting pairs", len(manifest)) as advance_to:
        return run_sweep(manifest, work, options, advance_to)


def _summary(images: int, copies: int, done: SweepSummary, listing: Listing) -> SrDatasetSummary:
    return SrDatasetSummary(
        train=listing.pairs["train"],
        test=listing.pairs["test"],
        images=images,
        images_found_done=done.found_done,
        copies=copies,
        refused_images=done.refused,
        refused=done.refused_lines,
        refused_list=None if done.refused_list is None else os.fspath(done.refused_list),
    )


def _copies(call: Call, manifest: Manifest, state: Path) -> set[int]:
    """Hashes of the paths of copies, which are listed beside the state."""
    found = set()
    listed = state / _COPIES_NAME
    with whole_file(listed) as file:
        for copy, kept in copies_in(manifest, state):
            found.add(SweepItem.on_disk(copy).hash)
            file.write(f"{on_one_line(copy)} = {on_one_line(kept)}\n".encode())
    if found:
        are = "image has" if len(found) == 1 else "images have"
        call.note(
            f"{len(found)} {are} the content of another, and no pairs of their own; see {listed}"
        )
    else:
        listed.unlink(missing_ok=True)
    return found


def _without(copies: set[int], manifest: Manifest) -> Iterator[Path]:
    return (item.path for item in manifest if item.hash not in copies)


def _prepare(out: Path, document: dict[str, Any], provenance: Provenance) -> None:
    about = out / DATASET_NAME
    if about.is_file() and _holds_pairs(out):
        if _stored_settings(about) != document:
            raise ApplicationError(
                f"{out} holds pairs made with other settings (see {about}); name another --out"
            )
        return
    (out / STATE_NAME).mkdir(parents=True, exist_ok=True)
    if document["format"] == "folder":
        for folder in _image_folders(out):
            folder.mkdir(parents=True, exist_ok=True)
    _describe(out, document, provenance)


def _holds_pairs(out: Path) -> bool:
    folders = [folder for folder in _image_folders(out) if folder.is_dir()]
    if any(next(folder.iterdir(), None) for folder in folders):
        return True
    return next((out / STATE_NAME).glob("*.tar"), None) is not None


def _image_folders(out: Path) -> list[Path]:
    return [out / split / side for split in SPLITS for side in ("high", "low")]


def _stored_settings(about: Path) -> object:
    try:
        stored = parse_json(read_regular_file(about), has_file_names=True)
    except ValueError:
        return None
    if isinstance(stored, dict):
        stored.pop("provenance", None)
        stored.setdefault("format", "folder")  # of before there was another
    return stored


def _describe(out: Path, document: dict[str, Any], provenance: Provenance) -> None:
    whole = document | {"provenance": provenance.model_dump(mode="json")}
    with whole_file(out / DATASET_NAME) as file:
        file.write((json.dumps(whole, indent=1) + "\n").encode("utf-8"))
