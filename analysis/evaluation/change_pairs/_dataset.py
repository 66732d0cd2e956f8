"""A folder of change pairs: dataset.json, and a file of pairs for each photograph."""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field, PrivateAttr

from acquisition.files import InputFile, Provenance
from acquisition.printable import on_one_line
from acquisition.session import commit_file
from analysis.detectability import SceneImage
from analysis.errors import ResultsFileError
from analysis.evaluation.change_pairs._pairs import (
    ChangePairsTask,
    LabelledPair,
    labelled_pairs,
    pairs_bytes,
    read_pairs,
)
from analysis.results_file import ResultsDocument, StoredValues, write_results
from analysis.sr_dataset import SPLITS, DatasetCall, Split, split_of
from analysis.sweep import (
    Batch,
    Commit,
    Manifest,
    Record,
    Records,
    SweepItem,
    SweepOptions,
    SweepSummary,
    SweepWork,
    announced_sweep,
)
from calibration.documents import read_document
from simulation import Psf
from simulation.arrays import FloatArray

STATE_NAME = "shards"
_NAME_LETTERS = 24
_VERSION = 2
"""Of the pairs; files of others are made again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangePairsWork(SweepWork):
    """Makes pairs, in any process.

    Parameters
    ----------
    out
        Folder of the data set, absolute.
    task, psf
        What pairs, and the camera's total PSF.
    load
        Photograph of a file, or a RefusedPhotographError; a function that a worker can import.
    reading
        How ``load`` reads, as text.
    depth
        Depth of a photograph's scene, or a RefusedPhotographError; None for flat scenes.
    """

    out: Path
    task: ChangePairsTask
    psf: Psf | None
    load: Callable[[Path], SceneImage]
    reading: str
    depth: Callable[[Path], FloatArray] | None = None

    @property
    def key(self) -> str:
        """See `SweepWork.key`."""
        return json.dumps([_VERSION, self.task.model_dump(), repr(self.psf), self.reading])

    @property
    def state(self) -> Path:
        """See `SweepWork.state`."""
        return self.out / STATE_NAME

    @property
    def root(self) -> Path:
        """See `SweepWork.root`."""
        return self.out

    def answer(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        """Write the pairs of a photograph; copies of one share its file."""
        scene = self.load(item.path)
        levels_dn = scene.grey_dn if scene.colours is None else scene.colours()
        depth = None if self.depth is None else self.depth(item.path)
        made = list(labelled_pairs(levels_dn, scene.sha256, self.task, self.psf, depth))
        split = split_of(scene.sha256, self.task.seed, self.task.test_fraction)
        settings = hashlib.sha256(self.key.encode()).hexdigest()
        file = f"{split}/{scene.sha256[:_NAME_LETTERS]}-{settings[:8]}.npz"
        content = pairs_bytes(made)
        commit_file(self.out / file, content)
        row = {
            "file": file,
            "split": split,
            "photograph": on_one_line(item.path.name),
            "sha256": scene.sha256,
            "encoding": scene.encoding,
            "pairs": len(made),
        }
        return Record(
            items=(item,), rows=(row,), notes=dict(scene.notes), files={file: len(content)}
        )


_CHANGE_PAIRS_SCHEMA: Final = "standoff.change-pairs/1"
DATASET_NAME: Final = "dataset.json"
_SETTINGS = ("task", "psf", "reading")


class ChangePairsFile(StoredValues):
    """A file of pairs, and the photograph that they were made from.

    ``pairs`` is the number of pairs, of which half have a change. ``sha256`` is the photograph's.
    """

    file: str
    split: Split
    photograph: str
    sha256: str
    encoding: str
    pairs: int


class ChangePairsDataset(ResultsDocument):
    """Description of a data set of change pairs: the document of its dataset.json.

    ``is_complete`` is false until all photographs have been tried; ``files`` then names the file of
    each. ``refused_photographs`` is the number of photographs that could not be used, ``refused``
    names the first of them.
    """

    schema_name: Literal["standoff.change-pairs/1"] = Field(
        default=_CHANGE_PAIRS_SCHEMA, alias="schema"
    )
    is_complete: bool = False
    task: ChangePairsTask
    psf: dict[str, Any] | None
    reading: str
    train: int = 0
    test: int = 0
    refused_photographs: int = 0
    refused: tuple[str, ...] = ()
    files: tuple[ChangePairsFile, ...] = Field(default=(), repr=False)

    _folder: Path = PrivateAttr(default=Path())

    def __repr__(self) -> str:
        return (
            f"<{self.train} pairs for training, {self.test} for testing, "
            f"of {len(self.files)} photographs>"
        )

    def pairs(self, split: Split) -> Iterator[LabelledPair]:
        """Read the pairs of one split, file by file.

        Raises
        ------
        ResultsFileError
            If a file is missing or damaged.
        """
        for one in self.files:
            if one.split == split:
                yield from read_pairs(self._folder / one.file)


def read_dataset(folder: Path) -> ChangePairsDataset:
    """Read the dataset.json of a folder of change pairs.

    Raises
    ------
    ResultsFileError
        If it cannot be read, or is of another schema.
    """
    found = read_document(
        folder / DATASET_NAME,
        ChangePairsDataset,
        ResultsFileError,
        "write it with standoff change-pairs",
    )
    found._folder = folder
    return found


def write_change_pairs(
    call: DatasetCall,
    paths: Iterable[Path],
    work: ChangePairsWork,
    options: SweepOptions | None = None,
) -> tuple[ChangePairsDataset, SweepSummary]:
    """Write the pairs of every photograph that an earlier run did not do.

    dataset.json lists them once a run has done all parts.

    Raises
    ------
    ResultsFileError
        If the folder holds pairs with other settings, or cannot be written.
    SweepError
        If no usable worker is available, or, with ``strict``, a photograph cannot be used.
    """
    options = options or SweepOptions()
    head: dict[str, Any] = {
        "task": work.task,
        "psf": _plain(work.psf),
        "reading": work.reading,
    }
    _prepare(work.out, ChangePairsDataset(**head))
    with Manifest(paths, work.state) as manifest:
        summary, records = announced_sweep(call, "cutting pairs", manifest, work, options)
        if options.part[1] > 1:
            return ChangePairsDataset(**head), summary
        files = _files(records)
    made = {one.file for one in files}
    for split in SPLITS:
        for path in (work.out / split).glob("*.npz"):
            if f"{split}/{path.name}" not in made:
                path.unlink(missing_ok=True)  # of photographs that are no longer among them
    document = ChangePairsDataset(
        **head,
        train=sum(one.pairs for one in files if one.split == "train"),
        test=sum(one.pairs for one in files if one.split == "test"),
        is_complete=True,
        refused_photographs=summary.refused,
        refused=summary.refused_lines,
        files=files,
        provenance=_with_photographs(call.provenance(), files),
    )
    write_results(work.out / DATASET_NAME, document)
    document._folder = work.out
    return document, summary


def _plain(psf: Psf | None) -> dict[str, Any] | None:
    """Return a PSF as it is read back from a file."""
    if psf is None:
        return None
    assert is_dataclass(psf)
    assert not isinstance(psf, type)
    plain: dict[str, Any] = json.loads(json.dumps(asdict(psf)))
    return plain


def _prepare(out: Path, document: ChangePairsDataset) -> None:
    about = out / DATASET_NAME
    try:
        for folder in (*SPLITS, STATE_NAME):
            (out / folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultsFileError(
            f"cannot write {error.filename or out}: {error.strerror}", source=str(out)
        ) from error
    if about.is_file():
        stored = read_dataset(out)
        if any(getattr(stored, name) != getattr(document, name) for name in _SETTINGS):
            raise ResultsFileError(
                f"{out} holds pairs made with other settings (see {about}); name another folder",
                source=str(about),
            )
        return
    write_results(about, document)


def _files(records: Records) -> tuple[ChangePairsFile, ...]:
    """The files by their photographs' paths, of copies the first."""
    files: dict[str, ChangePairsFile] = {}
    for answer in records.answers(by_path=True):
        if answer.refused is None:
            files.setdefault(answer.row["file"], ChangePairsFile.model_validate(answer.row))
    return tuple(files.values())


def _with_photographs(provenance: Provenance, files: tuple[ChangePairsFile, ...]) -> Provenance:
    encodings = sorted({one.encoding for one in files}) or ["linear"]
    listed = tuple(InputFile(path=one.photograph, sha256=one.sha256) for one in files)
    return provenance.model_copy(
        update={
            "inputs": provenance.inputs + listed,
            "encoding": encodings[0] if len(encodings) == 1 else tuple(encodings),
        }
    )
