"""Pairs of crops for super-resolution, made from photographs one by one, in any process.

A commit is the one thing of a batch that is synchronised with the disk. The files of its pairs are
written before and left to the operating system: after a power cut some that were written in the
last half minute may be missing, empty or short. Their sizes are in the records, so that the next
run makes such pairs again; whoever reads pairs after a power cut runs the command once more first.
"""

import hashlib
import json
import struct
import tarfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, get_args

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from acquisition.photographs import tiff_bytes
from acquisition.printable import beginning_of, on_one_line
from acquisition.session import whole_file
from analysis.choices import PairFormat
from analysis.sweep import Batch, Commit, Record, SweepItem, SweepWork
from simulation import Model, Psf, PsfField
from simulation.arrays import AnyArray, FloatArray
from simulation.zoom import SrPair, sr_pairs

STATE_NAME = "shards"
_DATASET_SCHEMA = "standoff.sr-pairs/1"

Split = Literal["train", "test"]
SPLITS: tuple[Split, ...] = get_args(Split)

_LONGEST_STEM_BYTES = 180
"""With the digest, the number and what a file has until it is whole, a name has 255 at most."""

_PNG_BYTES_MOST = 2
"""Of a sample; PNG specification, third edition, 11.2.1."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY, _RGB = 0, 2
_SUB_FILTER = 1
_LEVEL = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairPhotograph:
    """A photograph that was read from a file, as pairs are cut from it.

    Parameters
    ----------
    stored
        Levels as the file has them, shape ``(rows, cols)`` or ``(rows, cols, 3)``.
    linear
        The same, linear in light.
    encode
        From linear levels to those that the file stores.
    marked
        Makes a PNG file state the encoding.
    encoding
        Name of the encoding.
    sha256
        Of the file.
    notes
        What is worth saying of how it was read, by kind.
    """

    path: Path
    stored: NDArray[Any] = field(repr=False)
    linear: AnyArray = field(repr=False)
    encode: Callable[[AnyArray], FloatArray]
    marked: Callable[[bytes], bytes]
    encoding: str
    sha256: str
    notes: Mapping[str, str] = field(default_factory=dict)


PairReader = Callable[[Path], PairPhotograph]
"""Reads a photograph or raises a `RefusedPhotographError`; a worker can import it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SrDatasetSettings:
    """Settings common to all pairs of a dataset.

    ``test_fraction`` of the *images*, chosen by content and ``seed``, is the test split: crops
    of one image are never in both splits. With ``is_float`` both images are float32 TIFFs;
    otherwise low resolution is rounded to the type of the photograph and both are PNGs. A crop of
    an image of the size of ``field`` gets the PSF of its position. ``threads`` changes no pixel.
    ``reading`` says how the photographs are read, as plain values.
    """

    zoom: float
    model: Model
    psf: Psf
    crop_px: int
    stride_px: int
    test_fraction: float
    seed: int
    is_float: bool
    reading: Mapping[str, Any]
    field: PsfField | None = None
    threads: int = 1
    format: PairFormat = "folder"

    def psf_of(self, image: NDArray[Any]) -> Psf | PsfField:
        """Return the field for a whole frame of the camera, one PSF for any other image."""
        field = self.field
        if field is None or image.shape[:2] != (field.height_px, field.width_px):
            return self.psf
        return field

    def document(self) -> dict[str, Any]:
        """Return the settings as plain numbers."""
        own = asdict(replace(self, field=None))
        del own["field"], own["threads"], own["reading"]
        if self.field is not None:
            own["psf_field"] = {
                "size": [self.field.width_px, self.field.height_px],
                "coefficients_px2": self.field.coefficients_px2.tolist(),
            }
        return {"schema": _DATASET_SCHEMA, **own, "reading": dict(self.reading)}


def split_of(digest: str, seed: int, test_fraction: float) -> Split:
    """Split of an image, from its content, so that adding images does not move others."""
    draw = hashlib.sha256(f"{seed}:{digest}".encode()).digest()
    share = int.from_bytes(draw[:8], "big") / 2**64
    return "test" if share < test_fraction else "train"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _EncodedPair:
    """Both images of a pair as files, in the photograph's own encoding.

    ``key`` is unique in a dataset: the digest distinguishes photographs with the same name from
    different folders. ``suffix`` is that of both files: ``.png`` or ``.tif``.
    """

    key: str
    suffix: str
    pair: SrPair
    high: bytes
    low: bytes


@dataclass(frozen=True)
class PairWork(SweepWork):
    """Makes the pairs of a dataset.

    Pairs are two image files each, ``split/high/key.png`` and ``split/low/key.png``, or members of
    a tar file for each split of a batch: ``key.high.png``, ``key.json`` and ``key.low.png``, as the
    library webdataset reads them. ``out`` is the folder of the dataset, absolute.
    """

    out: Path
    settings: SrDatasetSettings
    read: PairReader

    @property
    def key(self) -> str:
        """The dataset's settings as text."""
        return json.dumps(self.settings.document(), sort_keys=True)

    @property
    def state(self) -> Path:
        """Folder of the records and tar files."""
        return self.out / STATE_NAME

    @property
    def root(self) -> Path:
        """Folder of the dataset."""
        return self.out

    def answer(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        """Make the pairs of a photograph: all of them, or none; for a tar file they are bytes."""
        photograph = self.read(item.path)
        settings = self.settings
        split = split_of(photograph.sha256, settings.seed, settings.test_fraction)
        row: dict[str, Any] = {
            "split": split,
            "image": photograph.path.name,
            "image_sha256": photograph.sha256,
            "encoding": photograph.encoding,
        }
        members, files, places = [], {}, []
        for pair in list(_encoded_pairs(photograph, settings)):
            place = {"top_px": pair.pair.top_px, "left_px": pair.pair.left_px}
            if settings.format == "webdataset":
                # What follows the first dot of a member's name is its extension.
                key = pair.key.replace(".", "_")
                high, low = (f"{key}.{side}{pair.suffix}" for side in ("high", "low"))
                facts = json.dumps({**row, **place}).encode("ascii")
                members += [(high, pair.high), (f"{key}.json", facts), (low, pair.low)]
            else:
                high, low = (f"{split}/{side}/{pair.key}{pair.suffix}" for side in ("high", "low"))
                for name, data in ((high, pair.high), (low, pair.low)):
                    # In place: no manifest lists one before it is committed.
                    (self.out / name).write_bytes(data)
                    files[name] = len(data)
            places.append({"high": high, "low": low, **place})
        return Record(
            items=(item,),
            rows=({**row, "kind": _kind_of(photograph, settings), "pairs": places},),
            notes={**photograph.notes, **self._note_on_field(photograph)},
            files=files,
            data=b"".join(_tar_member(name, data) for name, data in members),
        )

    def do(self, batch: Batch, commit: Commit) -> None:
        """Make the pairs of a batch, and commit them at once."""
        if self.settings.format == "folder":
            super().do(batch, commit)
            return
        records = []
        with ExitStack() as opened:
            tars: dict[str, PairTar] = {}
            for item in batch.items:
                record = self.answer_or_refusal(item, batch, commit)
                if record.data:
                    (row,) = record.rows
                    name = tar_name(batch.number, row["split"], batch.digests.values())
                    if name not in tars:
                        tars[name] = opened.enter_context(PairTar(self.state, name))
                    at = tars[name].append(record.data)
                    row = {**row, "tar": name, "at": at, "bytes": len(record.data)}
                    record = replace(record, rows=(row,), data=b"")
                records.append(record)
        commit([with_tar(record, self.state) for record in records])

    def _note_on_field(self, photograph: PairPhotograph) -> dict[str, str]:
        field = self.settings.field
        if field is None or self.settings.psf_of(photograph.stored) is field:
            return {}
        sentence = (
            f"{on_one_line(photograph.path)}: the PSF's field belongs to frames of "
            f"{field.width_px} x {field.height_px} px; one PSF is used"
        )
        return {"field": sentence}


class PairTar(AbstractContextManager["PairTar"]):
    """A tar file that is there whole or not at all.

    The headers hold neither time nor owner, so that the same pairs are the same bytes.
    """

    def __init__(self, state: Path, name: str) -> None:
        self._opened = ExitStack()
        self._file = self._opened.enter_context(whole_file(state / name))

    def append(self, members: bytes) -> int:
        """Append members with their headers; return their first byte."""
        at = self._file.tell()
        self._file.write(members)
        return at

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self._file.write(bytes(tar_padding(self._file.tell())))
        self._opened.__exit__(kind, error, trace)


def tar_padding(size_bytes: int) -> int:
    """Zeros that end a tar file of so many bytes: two blocks, and what fills the last record."""
    return 2 * tarfile.BLOCKSIZE + -(size_bytes + 2 * tarfile.BLOCKSIZE) % tarfile.RECORDSIZE


def tar_name(number: int, split: str, content: object) -> str:
    """Name of a tar file of a batch, another one for other content."""
    text = json.dumps(list(content), default=str)  # type: ignore[call-overload]
    return f"{number:016x}-{hashlib.sha256(text.encode()).hexdigest()[:16]}-{split}.tar"


def with_tar(record: Record, state: Path) -> Record:
    """State the size of the tar file that a record's pairs are in."""
    name = record.rows[0].get("tar")
    if name is None:
        return record
    return replace(record, files={f"{STATE_NAME}/{name}": (state / name).stat().st_size})


def _tar_member(name: str, data: bytes) -> bytes:
    member = tarfile.TarInfo(name)
    member.size = len(data)
    padding = bytes(-len(data) % tarfile.BLOCKSIZE)
    return member.tobuf(tarfile.GNU_FORMAT) + data + padding


def _kind_of(photograph: PairPhotograph, settings: SrDatasetSettings) -> str:
    """What an array of a pair's file is like, in words: arrays of two kinds make no batch."""
    colours = "grey" if photograph.stored.ndim == 2 else "RGB"
    stored: np.dtype[Any] = photograph.stored.dtype
    return f"{colours} {'float32' if _is_float(stored, settings) else stored.name}"


def _is_float(stored: np.dtype[Any], settings: SrDatasetSettings) -> bool:
    return settings.is_float or stored.kind != "u" or stored.itemsize > _PNG_BYTES_MOST


def _encoded_pairs(
    photograph: PairPhotograph, settings: SrDatasetSettings
) -> Iterator[_EncodedPair]:
    """Yield the pairs of a photograph, row by row; a ValueError says that it is too small."""
    pairs = sr_pairs(
        photograph.linear,
        settings.zoom,
        settings.psf_of(photograph.linear),
        crop_px=settings.crop_px,
        stride_px=settings.stride_px,
        model=settings.model,
        threads=settings.threads,
    )
    stored: np.dtype[Any] = photograph.stored.dtype
    is_float = _is_float(stored, settings)
    stem = beginning_of(photograph.path.stem, _LONGEST_STEM_BYTES)
    for number, pair in enumerate(pairs):
        # The levels of the crop as the file has them: to light and back they would be the same.
        top_px, left_px, side_px = pair.top_px, pair.left_px, settings.crop_px
        high = photograph.stored[top_px : top_px + side_px, left_px : left_px + side_px]
        low = photograph.encode(pair.low)
        if is_float:
            files = tuple(tiff_bytes(image.astype(np.float32), "") for image in (high, low))
        else:
            levels = np.clip(np.rint(low), 0, np.iinfo(stored).max).astype(stored)
            files = tuple(photograph.marked(png_bytes(image)) for image in (high, levels))
        yield _EncodedPair(
            key=f"{stem}_{photograph.sha256[:8]}_{number:05d}",
            suffix=".tif" if is_float else ".png",
            pair=pair,
            high=files[0],
            low=files[1],
        )


def png_bytes(levels: NDArray[Any]) -> bytes:
    """Return the bytes of a PNG file, without a mark of the encoding.

    One filter for all rows, and the fastest compressor at hand: compression is the largest part of
    making a pair. libdeflate takes 55-85 % of the time of OpenCV's fastest setting, for files of
    95-108 % of the size (``benchmarks/speed/sr_pairs.py``).

    Parameters
    ----------
    levels
        Shape ``(rows, cols)`` or, red first, ``(rows, cols, 3)``; uint8 or uint16.

    Raises
    ------
    ValueError
        If it is of another kind.

    References
    ----------
    Portable Network Graphics (PNG) Specification, third edition, W3C 2025, sections 5, 9, 11.
    """
    is_colour = levels.ndim == 3 and levels.shape[2] == 3
    if levels.dtype not in (np.uint8, np.uint16) or not (is_colour or levels.ndim == 2):
        raise ValueError(f"no PNG holds {levels.dtype} of shape {levels.shape}")
    rows, cols = levels.shape[:2]
    big_endian = np.ascontiguousarray(levels, dtype=levels.dtype.newbyteorder(">"))
    samples = big_endian.view(np.uint8).reshape(rows, -1)
    pixel_bytes = samples.shape[1] // cols
    filtered = np.empty((rows, 1 + samples.shape[1]), np.uint8)
    filtered[:, 0] = _SUB_FILTER
    filtered[:, 1 : 1 + pixel_bytes] = samples[:, :pixel_bytes]
    np.subtract(
        samples[:, pixel_bytes:], samples[:, :-pixel_bytes], out=filtered[:, 1 + pixel_bytes :]
    )
    depth, kind = 8 * levels.dtype.itemsize, _RGB if is_colour else _GREY
    return b"".join(
        (
            _SIGNATURE,
            _chunk(b"IHDR", struct.pack(">IIBBBBB", cols, rows, depth, kind, 0, 0, 0)),
            _chunk(b"IDAT", bytes(imagecodecs.deflate_encode(filtered.tobytes(), level=_LEVEL))),
            _chunk(b"IEND", b""),
        )
    )


def _chunk(kind: bytes, content: bytes) -> bytes:
    checked = kind + content
    return struct.pack(">I", len(content)) + checked + struct.pack(">I", zlib.crc32(checked))
