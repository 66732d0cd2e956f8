"""A folder of super-resolution pairs with its manifest, written image by image and resumable."""

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.printable import on_one_line
from acquisition.session import atomic_write
from acquisition.untrusted import parse_json
from calibration.provenance import InputFile, Provenance
from simulation import Model, Psf, PsfField
from simulation.sr_pairs import SrPair, sr_pairs
from standoff.errors import ApplicationError, ImageFileError
from standoff.photographs import Inputs, Photograph, ReadOptions, marked_png, read_file
from standoff.terminal import command_line, note
from standoff.workflows.image_files import tiff_bytes

DATASET_SCHEMA = "standoff.sr-pairs/1"
DATASET_NAME = "dataset.json"
MANIFEST_NAME = "manifest.jsonl"
_MOST_INPUTS = 10_000

Split = Literal["train", "test"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SrDatasetSettings:
    """Settings common to all pairs of a dataset.

    ``test_fraction`` of the *images*, chosen by content and ``seed``, is the test split: crops
    of one image are never in both splits. With ``is_float`` both images are float32 TIFFs;
    otherwise low resolution is rounded to the type of the photograph and both are PNGs. A crop of
    an image of the size of ``field`` gets the PSF of its position. ``threads`` changes no pixel.
    """

    zoom: float
    model: Model
    psf: Psf
    crop_px: int
    stride_px: int
    test_fraction: float
    seed: int
    is_float: bool
    field: PsfField | None = None
    threads: int = 1

    def psf_of(self, image: NDArray[Any]) -> Psf | PsfField:
        """Return the field for a whole frame of the camera, one PSF for any other image."""
        field = self.field
        if field is None or image.shape[:2] != (field.height_px, field.width_px):
            return self.psf
        return field

    def document(self, reading: ReadOptions) -> dict[str, Any]:
        """Return the settings, and how the images are read, as plain numbers."""
        encoding = reading.encoding
        own = asdict(replace(self, field=None))
        del own["field"], own["threads"]
        if self.field is not None:
            own["psf_field"] = {
                "size": [self.field.width_px, self.field.height_px],
                "coefficients_px2": self.field.coefficients_px2.tolist(),
            }
        return {
            "schema": DATASET_SCHEMA,
            **own,
            "reading": {
                "encoding": "auto" if encoding is None else encoding.name,
                "page": reading.page,
                "is_mean": reading.is_mean,
            },
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class SrDatasetSummary:
    """How many pairs a dataset holds, and how many images an earlier run had done.

    ``refused`` says for each image without pairs why it has none.
    """

    train: int
    test: int
    images_found_done: int
    refused: tuple[str, ...] = ()


def write_sr_dataset(
    out: Path,
    images: Sequence[Path],
    settings: SrDatasetSettings,
    inputs: Inputs,
    progress: Callable[[int], None] = lambda _: None,
) -> SrDatasetSummary:
    """Write the pairs of every image below ``out``; a second run writes what is missing.

    An image that cannot be read, or is too small for a crop, is left out and named in the
    summary. ``inputs`` reads the images.

    Raises
    ------
    ApplicationError
        If ``out`` holds pairs with other settings, or cannot be written.
    """
    provenance = inputs.provenance(command_line())
    document = settings.document(inputs.options)
    try:
        lines = manifest_lines(out)
        _prepare(out, document, provenance, is_empty=not lines)
        done = {line["image_sha256"] for line in lines}
        refused = []
        found = 0
        for count, path in enumerate(images, start=1):
            try:
                digest = hashlib.sha256(read_file(path)).hexdigest()
                if digest in done:
                    found += 1
                else:
                    new = _write_image(out, inputs.photograph(path), digest, settings)
                    _append(out / MANIFEST_NAME, new)
                    lines += new
                    done.add(digest)
            except (ImageFileError, ValueError) as error:
                text, name = str(error), on_one_line(path)
                refused.append(text if name in text else f"{name}: {text}")
            progress(count)
        _describe(out, document, _with_images(provenance, out, lines))
    except OSError as error:
        raise ApplicationError(f"{error.filename or out}: {error.strerror}") from error
    return SrDatasetSummary(
        train=sum(line["split"] == "train" for line in lines),
        test=sum(line["split"] == "test" for line in lines),
        images_found_done=found,
        refused=tuple(refused),
    )


def split_of(digest: str, settings: SrDatasetSettings) -> Split:
    """Split of an image, from its content, so that adding images does not move others."""
    draw = hashlib.sha256(f"{settings.seed}:{digest}".encode()).digest()
    share = int.from_bytes(draw[:8], "big") / 2**64
    return "test" if share < settings.test_fraction else "train"


def _prepare(
    out: Path, document: dict[str, Any], provenance: Provenance, *, is_empty: bool
) -> None:
    about = out / DATASET_NAME
    if about.is_file() and not is_empty:
        if _stored_settings(about) != document:
            raise ApplicationError(
                f"{out} holds pairs made with other settings (see {about}); name another --out"
            )
        return
    for split in ("train", "test"):
        for side in ("high", "low"):
            (out / split / side).mkdir(parents=True, exist_ok=True)
    _describe(out, document, provenance)


def _stored_settings(about: Path) -> object:
    try:
        stored = parse_json(about.read_bytes())
    except ValueError:
        return None
    if isinstance(stored, dict):
        stored.pop("provenance", None)
    return stored


def _describe(out: Path, document: dict[str, Any], provenance: Provenance) -> None:
    whole = document | {"provenance": provenance.model_dump(mode="json")}
    atomic_write(out / DATASET_NAME, (json.dumps(whole, indent=1) + "\n").encode("utf-8"))


def _with_images(provenance: Provenance, out: Path, lines: list[dict[str, Any]]) -> Provenance:
    """Add the images of the manifest; of very many, the manifest that holds their hashes."""
    images = {line["image_sha256"]: line["image"] for line in lines}
    if len(images) > _MOST_INPUTS:
        manifest = out / MANIFEST_NAME
        images = {hashlib.sha256(manifest.read_bytes()).hexdigest(): str(manifest)}
    added = tuple(InputFile(path=name, sha256=digest) for digest, name in images.items())
    encodings = sorted({line.get("encoding", "linear") for line in lines})
    return provenance.model_copy(
        update={
            "inputs": provenance.inputs + added,
            "encoding": encodings[0] if len(encodings) == 1 else tuple(encodings),
        }
    )


def manifest_lines(out: Path) -> list[dict[str, Any]]:
    """Read the lines of the manifest whose files exist.

    A line cut short by a power cut is removed, and so are all lines of an image with a file
    missing.
    """
    path = out / MANIFEST_NAME
    if not path.is_file():
        return []
    text = path.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if whole != text:
        atomic_write(path, whole)
    try:
        lines = [parse_json(line) for line in whole.splitlines()]
        broken = {
            line["image_sha256"]
            for line in lines
            if not all((out / line[side]).is_file() for side in ("high", "low"))
        }
    except (ValueError, KeyError, TypeError) as error:
        raise ApplicationError(f"{path}: not a manifest: {error}") from error
    if broken:
        lines = [line for line in lines if line["image_sha256"] not in broken]
        atomic_write(path, "".join(json.dumps(line) + "\n" for line in lines).encode("utf-8"))
    return lines


def _append(path: Path, lines: list[dict[str, Any]]) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write("".join(json.dumps(line) + "\n" for line in lines))
        file.flush()
        os.fsync(file.fileno())


def _write_image(
    out: Path, photograph: Photograph, digest: str, settings: SrDatasetSettings
) -> list[dict[str, Any]]:
    path = photograph.path
    pixels = photograph.colour_planes
    if settings.field is not None and settings.psf_of(pixels) is settings.psf:
        note(
            f"{on_one_line(path)}: the PSF's field belongs to frames of "
            f"{settings.field.width_px} x {settings.field.height_px} px; one PSF is used"
        )
    split = split_of(digest, settings)
    lines = []
    pairs = sr_pairs(
        pixels,
        settings.zoom,
        settings.psf_of(pixels),
        crop_px=settings.crop_px,
        stride_px=settings.stride_px,
        model=settings.model,
        threads=settings.threads,
    )
    for number, pair in enumerate(pairs):
        # The digest distinguishes photographs with the same name from different folders.
        stem = f"{path.stem}_{digest[:8]}_{number:05d}"
        files = _write_pair(out / split, stem, pair, photograph, settings.is_float)
        lines.append(
            {
                "split": split,
                "high": f"{split}/{files[0]}",
                "low": f"{split}/{files[1]}",
                "image": path.name,
                "image_sha256": digest,
                "encoding": photograph.encoding.name,
                "top_px": pair.top_px,
                "left_px": pair.left_px,
            }
        )
    return lines


def _write_pair(
    folder: Path, stem: str, pair: SrPair, photograph: Photograph, is_float: bool
) -> tuple[str, str]:
    """Write both images in the photograph's own encoding: PNGs, or float32 TIFFs."""
    stored = photograph.stored.dtype
    names = []
    for side, image in (("high", pair.high), ("low", pair.low)):
        encoded = photograph.encoding.encode(image, photograph.white_dn)
        if is_float or stored.kind != "u":
            name, data = f"{side}/{stem}.tif", tiff_bytes(encoded.astype(np.float32), "")
        else:
            name = f"{side}/{stem}.png"
            data = marked_png(_png(encoded, stored), photograph.encoding)
        atomic_write(folder / name, data)
        names.append(name)
    return names[0], names[1]


def _png(image: NDArray[Any], dtype: "np.dtype[Any]") -> bytes:
    levels = np.clip(np.rint(image), 0, np.iinfo(dtype).max).astype(dtype)
    if levels.ndim == 3:
        levels = levels[:, :, ::-1]  # OpenCV writes blue first
    return bytes(cv2.imencode(".png", levels)[1].tobytes())
