"""The lists of a finished dataset: its manifest, and the numbered names of its tar files."""

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from acquisition.files import InputFile, Provenance
from acquisition.session import clear_parts, part_of, whole_file
from analysis.errors import SrDatasetError
from analysis.sr_dataset.record import ImageRecord, PairRecord, ShardRecord
from analysis.sr_dataset.settings import SPLITS, Split
from analysis.sr_dataset.shard_work import RECORD_SUFFIX, record_path
from analysis.sweep import overlaps, sorted_lines

MANIFEST_NAME = "manifest.jsonl"
COMMITTED_NAMES = "committed-*.txt"
_MOST_INPUTS = 10_000


@dataclass(slots=True, kw_only=True)
class Listing:
    """What the shards of a sweep hold, counted while they are read one by one.

    ``images`` has the path, hash and name of each image with pairs, of 10,000 at most. ``tars``
    has the file of each numbered name.
    """

    manifest: Path
    pairs: dict[Split, int] = field(default_factory=lambda: dict.fromkeys(SPLITS, 0))
    encodings: set[str] = field(default_factory=set)
    images: list[tuple[str, str, str]] = field(default_factory=list)
    tars: dict[str, str] = field(default_factory=dict)

    def lines(self, records: Iterator[ShardRecord]) -> Iterator[bytes]:
        """Yield the lines of the manifest, each after what sorts it: the path and the number."""
        numbers = dict.fromkeys(SPLITS, 0)
        for record in records:
            names: dict[Split, str] = {}
            for tar in record.tars:
                names[tar.split] = f"{tar.split}-{numbers[tar.split]:06d}.tar"
                numbers[tar.split] += 1
                self.tars[names[tar.split]] = tar.name
            for image in record.images:
                self._count(image)
                for number, pair in enumerate(image.pairs):
                    text = json.dumps(_line(image, pair, names.get(image.split)))
                    yield f"{image.order}\t{number:08d}\t{text}\n".encode("ascii")

    def in_provenance(self, provenance: Provenance) -> Provenance:
        """Add the images; of very many, the manifest that holds their hashes."""
        images = sorted(self.images)
        if len(images) > _MOST_INPUTS:
            with self.manifest.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            images = [("", digest, os.fspath(self.manifest))]
        encodings = sorted(self.encodings or {"linear"})
        return provenance.model_copy(
            update={
                "inputs": provenance.inputs
                + tuple(InputFile(path=name, sha256=digest) for _, digest, name in images),
                "encoding": encodings[0] if len(encodings) == 1 else tuple(encodings),
            }
        )

    def _count(self, image: ImageRecord) -> None:
        if not image.pairs:
            return
        self.pairs[image.split] += len(image.pairs)
        self.encodings.add(image.encoding or "linear")
        if len(self.images) <= _MOST_INPUTS:
            self.images.append((image.order, image.sha256 or "", image.name))


def list_pairs(out: Path, state: Path, committed: Path, *, is_whole: bool) -> Listing:
    """Count the pairs of a sweep and, of a whole one, write the manifest and name the tar files.

    Parameters
    ----------
    out, state
        Folders of the dataset, and of its shards.
    committed
        The names of the sweep's shards, one a line, in any order.
    is_whole
        Whether all parts of the sweep are done.

    Raises
    ------
    SrDatasetError
        If a shard vanished since it was committed.
    OSError
        If the folders cannot be written.
    """
    listing = Listing(manifest=out / MANIFEST_NAME)
    lines = listing.lines(_records(state, committed))
    if not is_whole:
        for _ in lines:
            pass
        return listing
    with whole_file(listing.manifest) as file:
        for line in sorted_lines(lines, state):
            file.write(line.split(b"\t", 2)[2])
    _name_tars(out, state, listing.tars)
    _drop_superseded(state, _names(committed))
    clear_parts(state)
    for killed in state.glob(COMMITTED_NAMES):
        if killed != committed:
            killed.unlink(missing_ok=True)
    return listing


def _line(image: ImageRecord, pair: PairRecord, tar: str | None) -> dict[str, Any]:
    return {
        "split": image.split,
        **({} if tar is None else {"tar": tar}),
        "high": pair.high,
        "low": pair.low,
        "image": image.name,
        "image_sha256": image.sha256,
        "encoding": image.encoding,
        "top_px": pair.top_px,
        "left_px": pair.left_px,
    }


def _records(state: Path, committed: Path) -> Iterator[ShardRecord]:
    for name in _names(committed):
        path = record_path(state, name)
        record = ShardRecord.read(path)
        if record is None:
            raise SrDatasetError(f"{path} vanished; run the same command again")
        yield record


def _names(committed: Path) -> list[str]:
    return sorted(set(committed.read_text("ascii").split())) if committed.is_file() else []


def _drop_superseded(state: Path, names: list[str]) -> None:
    """Delete earlier commits all of whose photographs are in those of the sweep."""
    others = sorted({path.stem for path in state.glob(f"*{RECORD_SUFFIX}")}.difference(names))
    for name, overlapping in overlaps(others, names):
        record = ShardRecord.read(record_path(state, name))
        if record is None or not overlapping:
            continue
        found = (ShardRecord.read(record_path(state, one)) for one in overlapping)
        kept = {image.item for one in found if one is not None for image in one.images}
        if kept.issuperset(image.item for image in record.images):
            record_path(state, name).unlink(missing_ok=True)
            for tar in record.tars:
                (state / tar.name).unlink(missing_ok=True)


def _name_tars(out: Path, state: Path, tars: dict[str, str]) -> None:
    """Give the tar files numbers without gaps, as further names of the files of the shards."""
    for split in SPLITS:
        for old in out.glob(f"{split}-*.tar"):
            if old.name not in tars:
                old.unlink()
    for name, of_shard in tars.items():
        path, target = out / name, state / of_shard
        if path.exists() and path.samefile(target):
            continue
        part = part_of(path)
        try:
            part.hardlink_to(target)
        except OSError:  # a file system without hard links
            part.symlink_to(Path(state.name) / of_shard)
        part.replace(path)
