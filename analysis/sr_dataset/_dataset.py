"""A folder of super-resolution pairs with its manifest, written by any number of runs."""

import hashlib
import json
import os
import stat
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from itertools import chain, groupby, islice
from pathlib import Path
from typing import Any, Protocol

from acquisition.files import InputFile, Provenance
from acquisition.printable import on_one_line
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.remote_files import is_url
from acquisition.session import clear_parts, part_of, whole_file
from acquisition.untrusted import parse_json
from analysis.errors import ResultsFileError, SrDatasetError
from analysis.sr_dataset._pairs import (
    SPLITS,
    STATE_NAME,
    PairReader,
    PairTar,
    PairWork,
    Split,
    SrDatasetSettings,
    tar_name,
    tar_padding,
    with_tar,
)
from analysis.sweep import (
    Manifest,
    Record,
    Records,
    SweepCall,
    SweepItem,
    SweepOptions,
    SweepSummary,
    announced_sweep,
    batch_number,
    sorted_lines,
)
from simulation.notebook import Shown

DATASET_NAME = "dataset.json"
MANIFEST_NAME = "manifest.jsonl"
_COPIES_NAME = "copies.txt"
_MOST_INPUTS = 10_000

_SAMPLE_BYTES = 4096
"""Of possible copies, read at the start, the middle and the end: a page each."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SrDatasetSummary(Shown):
    """Counts of a data set of training pairs, over this run and earlier ones.

    ``train`` and ``test`` are numbers of pairs. ``images`` is the number of all photographs given,
    ``images_found_done`` of those that an earlier run had done, ``copies`` of those with the same
    content as another one, ``refused_images`` of those without pairs. ``refused`` says for the
    first ten of these why they have none, ``refused_list`` is the file that says it for all.
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

    The manifest is written by a run that does all parts. An `SrDatasetError` says that ``out``
    holds pairs with other settings, or cannot be written; a `SweepError` that no worker is fit,
    or, when strict, an image is refused.
    """
    out, options = out.absolute(), options or SweepOptions()
    state = out / STATE_NAME
    provenance = call.provenance()
    document = settings.document()
    try:
        _prepare(out, document, provenance)
        with Manifest(images, state) as given:
            copies = _copies(call, given, state)
            rest = (item.path for item in given if item.hash not in copies)
            with Manifest(rest, state) as manifest:
                work = PairWork(out, settings, read)
                done, records = announced_sweep(call, "cutting pairs", manifest, work, options)
                pairs = dict.fromkeys(SPLITS, 0)
                for answer in records.answers():
                    if answer.refused is None:
                        pairs[answer.row["split"]] += len(answer.row["pairs"])
                if options.part[1] == 1:
                    listed = _list_pairs(records, work)
                    if len(listed.kinds) > 1:
                        call.note(_several_kinds(listed.kinds))
                    _describe(out, document, listed.in_provenance(provenance))
            return _summary(len(given), len(copies), done, pairs)
    except OSError as error:
        raise SrDatasetError(f"{error.filename or out}: {error.strerror}") from error
    except ResultsFileError as error:
        raise SrDatasetError(str(error)) from error


def pair_files_in(out: Path) -> Iterator[Path]:
    """Yield the files of a dataset that its readers need, but for dataset.json."""
    yield out / MANIFEST_NAME
    for split in SPLITS:
        yield from out.glob(f"{split}-*.tar")
        yield from (out / split).glob("*/*")


def _summary(
    images: int, copies: int, done: SweepSummary, pairs: dict[Split, int]
) -> SrDatasetSummary:
    return SrDatasetSummary(
        train=pairs["train"],
        test=pairs["test"],
        images=images,
        images_found_done=done.found_done,
        copies=copies,
        refused_images=done.refused,
        refused=done.refused_lines,
        refused_list=None if done.refused_list is None else os.fspath(done.refused_list),
    )


def _prepare(out: Path, document: dict[str, Any], provenance: Provenance) -> None:
    about = out / DATASET_NAME
    if about.is_file() and _holds_pairs(out):
        if _stored_settings(about) != document:
            raise SrDatasetError(
                f"{out} contains pairs made with other settings (see {about}); name another --out"
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


@dataclass(slots=True, kw_only=True)
class _Listed:
    """The images with pairs, of 10,000 at most their names and hashes; encodings and kinds."""

    manifest: Path
    encodings: set[str] = field(default_factory=set)
    kinds: Counter[str] = field(default_factory=Counter)
    images: list[InputFile] = field(default_factory=list)

    def in_provenance(self, provenance: Provenance) -> Provenance:
        """Add the images; of very many, the manifest that holds their hashes."""
        images = self.images
        if len(images) > _MOST_INPUTS:
            with self.manifest.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            images = [InputFile(path=os.fspath(self.manifest), sha256=digest)]
        encodings = sorted(self.encodings or {"linear"})
        return provenance.model_copy(
            update={
                "inputs": (*provenance.inputs, *images),
                "encoding": encodings[0] if len(encodings) == 1 else tuple(encodings),
            }
        )


def _several_kinds(kinds: Counter[str]) -> str:
    listed = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    return (
        f"pairs of {len(kinds)} kinds ({listed}): a loader cannot stack them into one batch; "
        "convert them as they are loaded, or make a dataset of each kind"
    )


def _list_pairs(records: Records, work: PairWork) -> _Listed:
    """Write the manifest of all pairs, in the order of the images' paths, and name tar files."""
    tars = _numbered_tars(records, work) if work.settings.format == "webdataset" else {}
    found = _Listed(manifest=work.out / MANIFEST_NAME)
    with whole_file(found.manifest) as file:
        for answer in records.answers(by_path=True):
            if answer.refused is not None:
                continue
            image = dict(answer.row)
            pairs, tar = image.pop("pairs"), tars.get(image.pop("tar", ""))
            if "kind" in image:  # not in records of earlier versions
                found.kinds[image["kind"]] += len(pairs)
            image = {name: image[name] for name in ("image", "image_sha256", "encoding", "split")}
            split = image.pop("split")
            found.encodings.add(image["encoding"])
            if len(found.images) <= _MOST_INPUTS:
                found.images.append(InputFile(path=image["image"], sha256=image["image_sha256"]))
            for pair in pairs:
                line = {
                    "split": split,
                    **({} if tar is None else {"tar": tar}),
                    **{side: pair[side] for side in ("high", "low")},
                    **image,
                    **{name: pair[name] for name in ("top_px", "left_px")},
                }
                file.write(json.dumps(line).encode("ascii") + b"\n")
    _name_tars(work, {name: tar for tar, name in tars.items()})
    for name in records.superseded_files() - {f"{STATE_NAME}/{tar}" for tar in tars}:
        if name.endswith(".tar"):
            (work.out / name).unlink(missing_ok=True)
    clear_parts(work.state)
    return found


def _numbered_tars(records: Records, work: PairWork) -> dict[str, str]:
    """Put the pairs of each batch into tar files of their own, and number these by split.

    Whatever came first: photographs that came later end as those of one run.
    """
    names: dict[str, str] = {}
    numbers = dict.fromkeys(SPLITS, 0)
    total = len(records.manifest)
    for number, run in groupby(
        records.answers(), lambda answer: batch_number(answer.item.hash, total)
    ):
        answers = [answer for answer in run if answer.refused is None]
        for split in SPLITS:
            own = [(one.item, one.row) for one in answers if one.row["split"] == split]
            if own:
                tar = _tar_of(number, split, own, records, work)
                names[tar] = f"{split}-{numbers[split]:06d}.tar"
                numbers[split] += 1
    return names


def _tar_of(
    number: int,
    split: Split,
    images: list[tuple[SweepItem, dict[str, Any]]],
    records: Records,
    work: PairWork,
) -> str:
    """Return the tar file of a batch's images in one split, made of others if there is none."""
    at, is_whole = 0, True
    for _, row in images:
        is_whole &= row["tar"] == images[0][1]["tar"] and row["at"] == at
        at += row["bytes"]
    first: str = images[0][1]["tar"]
    if is_whole and (work.state / first).stat().st_size == at + tar_padding(at):
        return first
    name = tar_name(number, split, [[row["tar"], row["at"]] for _, row in images])
    moved = []
    with PairTar(work.state, name) as tar:
        for item, row in images:
            with (work.state / row["tar"]).open("rb") as file:
                file.seek(row["at"])
                row = {**row, "tar": name, "at": tar.append(file.read(row["bytes"]))}
            moved.append(Record(items=(item,), rows=(row,)))
    records.commit([with_tar(record, work.state) for record in moved])
    return name


def _name_tars(work: PairWork, tars: dict[str, str]) -> None:
    """Give the tar files numbers without gaps, as further names of those of the batches."""
    for split in SPLITS:
        for old in work.out.glob(f"{split}-*.tar"):
            if old.name not in tars:
                old.unlink()
    for name, own in tars.items():
        path, target = work.out / name, work.state / own
        if path.exists() and path.samefile(target):
            continue
        part = part_of(path)
        try:
            part.hardlink_to(target)
        except OSError:  # a file system without hard links
            part.symlink_to(Path(STATE_NAME) / own)
        part.replace(path)


def _copies(call: SweepCall, manifest: Manifest, state: Path) -> set[int]:
    """Hashes of the paths of copies, which are listed beside the state."""
    found = set()
    listed = state / _COPIES_NAME
    with whole_file(listed) as file:
        for copy, first in _copies_in(manifest, state):
            found.add(SweepItem.on_disk(copy).hash)
            file.write(f"{on_one_line(copy)} = {on_one_line(first)}\n".encode())
    if found:
        are = "image has" if len(found) == 1 else "images have"
        call.note(
            f"{len(found)} {are} the same content as another, and no pairs are made from copies; "
            f"see {listed}"
        )
    else:
        listed.unlink(missing_ok=True)
    return found


def _copies_in(manifest: Manifest, folder: Path) -> Iterator[tuple[Path, Path]]:
    """Yield the photographs that are copies, each with the one that is used: the first by name.

    Only files of the same size are looked into, and only those that agree in a sample are read
    whole: of photographs that a camera compressed few share their size.
    """
    by_size = (
        f"{item.size_bytes:016x} {json.dumps(os.fspath(item.path))}\n".encode("ascii")
        for item in manifest
        if item.size_bytes > 0
    )
    samples = _lines_by_sample(sorted_lines(by_size, folder))
    for _, alike in _several(sorted_lines(samples, folder)):
        first: dict[bytes, Path] = {}
        for path in alike:
            try:
                content = _digest_of(path)
            except OSError:
                continue
            if content in first:
                yield path, first[content]
            else:
                first[content] = path


def _lines_by_sample(lines: Iterable[bytes]) -> Iterator[bytes]:
    for size, of_size in _several(lines):
        for path in of_size:
            try:
                sample = _sample_of(path, int(size, 16))
            except OSError:
                continue
            name = json.dumps(os.fspath(path)).encode("ascii")
            yield size + sample.hex().encode("ascii") + b" " + name + b"\n"


def _several(lines: Iterable[bytes]) -> Iterator[tuple[bytes, Iterator[Path]]]:
    """Yield the beginnings that several sorted lines share, each with the paths that follow it."""
    for beginning, alike in groupby(lines, lambda line: line.partition(b" ")[0]):
        paths = (Path(json.loads(line.partition(b" ")[2])) for line in alike)
        if len(some := list(islice(paths, 2))) > 1:
            yield beginning, chain(some, paths)


def _sample_of(path: Path, size_bytes: int) -> bytes:
    if is_url(path):
        return _digest_of(path)
    # Opening a device may set it going, and opening a pipe waits for its writer.
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(f"{path} is not a file")
    digest = hashlib.sha256()
    with path.open("rb") as file:
        for offset in (0, size_bytes // 2, max(size_bytes - _SAMPLE_BYTES, 0)):
            file.seek(offset)
            digest.update(file.read(_SAMPLE_BYTES))
    return digest.digest()


def _digest_of(path: Path) -> bytes:
    if is_url(path):
        return hashlib.sha256(read_regular_file(path, LARGEST_IMAGE_BYTES)).digest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()
