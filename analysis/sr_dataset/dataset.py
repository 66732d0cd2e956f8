"""A folder of super-resolution pairs with its manifest, written shard by shard and resumable."""

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol
from uuid import uuid4

from acquisition.files import Provenance
from acquisition.printable import on_one_line
from acquisition.regular_files import read_regular_file
from acquisition.session import whole_file
from acquisition.untrusted import parse_json
from analysis.errors import SrDatasetError
from analysis.sr_dataset.copies import copies_in
from analysis.sr_dataset.listing import COMMITTED_NAMES, MANIFEST_NAME, Listing, list_pairs
from analysis.sr_dataset.photograph import PairReader
from analysis.sr_dataset.settings import SPLITS, SrDatasetSettings
from analysis.sr_dataset.shard_work import STATE_NAME, PairShards
from analysis.sweep import (
    Manifest,
    SweepCall,
    SweepItem,
    SweepOptions,
    SweepSummary,
    announced_sweep,
)
from simulation.notebook import Shown

DATASET_NAME = "dataset.json"
_COPIES_NAME = "copies.txt"


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SrDatasetSummary(Shown):
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


class DatasetCall(SweepCall, Protocol):
    """The call that a dataset is written by."""

    def provenance(self) -> Provenance:
        """Return the provenance of the dataset, but for its photographs."""
        ...


def write_sr_dataset(
    call: DatasetCall,
    out: Path,
    images: Iterable[Path],
    settings: SrDatasetSettings,
    read: PairReader,
    options: SweepOptions | None = None,
) -> SrDatasetSummary:
    """Write the pairs of every image below ``out``; a second run writes what is missing.

    The manifest is written by a run that does all parts.

    Raises
    ------
    SrDatasetError
        If ``out`` holds pairs with other settings, or cannot be written.
    SweepError
        If no worker is fit, or, when strict, an image is refused.
    """
    out, options = out.absolute(), options or SweepOptions()
    state = out / STATE_NAME
    provenance = call.provenance()
    document = settings.document()
    committed = state / COMMITTED_NAMES.replace("*", uuid4().hex)
    try:
        _prepare(out, document, provenance)
        with Manifest(images, state) as given:
            copies = _copies(call, given, state)
            work = PairShards(out, settings, read, committed)
            with Manifest(_without(copies, given), state) as manifest:
                done = announced_sweep(call, "cutting pairs", manifest, work, options)
            listing = list_pairs(out, state, committed, is_whole=options.part[1] == 1)
            if options.part[1] == 1:
                _describe(out, document, listing.in_provenance(provenance))
            return _summary(len(given), len(copies), done, listing)
    except OSError as error:
        raise SrDatasetError(f"{error.filename or out}: {error.strerror}") from error
    finally:
        with suppress(OSError):
            committed.unlink(missing_ok=True)


def pair_files_in(out: Path) -> Iterator[Path]:
    """Yield the files of a dataset that its readers need, but for dataset.json."""
    yield out / MANIFEST_NAME
    for split in SPLITS:
        yield from out.glob(f"{split}-*.tar")
        yield from (out / split).glob("*/*")


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


def _copies(call: SweepCall, manifest: Manifest, state: Path) -> set[int]:
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
            raise SrDatasetError(
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
