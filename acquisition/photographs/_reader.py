"""The one way in for photographs: files of every format, and arrays of every library."""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

import numpy as np
from PIL.Image import Image
from scipy.ndimage import distance_transform_edt

from acquisition.errors import ApplicationError, ImageFileError
from acquisition.files import InputFile, Provenance, utc_now
from acquisition.photographs._decoding import DecodingError, is_swollen, read_file, refuse_unusable
from acquisition.photographs._encoding import LINEAR, Encoding
from acquisition.photographs._photograph import (
    Photograph,
    PhotographHead,
    as_numbers,
    full_scale_dn,
    light_planes,
    saturation_dn,
)
from acquisition.photographs._raster import (
    is_exr,
    is_fits,
    read_exr_image,
    read_fits_image,
    read_raster_image,
    stored_picture,
)
from acquisition.photographs._stored_image import PhotographFacts, StoredImage
from acquisition.photographs._tiff import (
    RAW_SUFFIXES,
    is_camera_raw,
    is_tiff,
    read_camera_raw,
    read_tiff_image,
    tiff_facts,
)
from acquisition.printable import on_one_line
from acquisition.remote_files import is_url, remote_files_in, remote_status, url_of
from acquisition.session import JOURNAL_NAME, Session
from simulation.arguments import ArgumentError, given_array, whole_array
from simulation.arrays import AnyArray, BoolArray, FloatArray

IMAGE_SUFFIXES = frozenset(
    """.avif .bmp .exr .fit .fits .fts .gif .jp2 .jpeg .jpg .pgm .png .ppm .tif .tiff
    .webp""".split()  # noqa: SIM905 - a list is longer
) | (RAW_SUFFIXES - {".raw"})
"""Of the files of a folder that are taken for photographs."""

_COLOUR_PLANES = 4
_WHITE_OF_FLOATS = 1.5  # encoded floats run from 0 to 1, and little beyond


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadOptions:
    """Options for reading images; ``standoff.reading`` makes them.

    Parameters
    ----------
    encoding
        Encoding of every file; None for the one that each file states or that is usual for its
        format.
    page
        Number of the image to take from a stack, from 1.
    is_mean
        Whether a stack is one capture: its mean is taken, with the temporal variance.
    white_level
        Level, as it is stored, at which files are clipped; None for each file's own.
    """

    encoding: Encoding | None = None
    page: int | None = None
    is_mean: bool = False
    white_level: float | None = None

    def __str__(self) -> str:
        encoding = "auto" if self.encoding is None else self.encoding.name
        said = f"encoding {encoding}, page {self.page}, mean {self.is_mean}"
        return said if self.white_level is None else f"{said}, white {self.white_level:g}"

    def __post_init__(self) -> None:
        if self.page is not None and self.is_mean:
            raise ValueError("a page or the mean of all pages, not both")
        if self.page is not None and self.page < 1:
            raise ValueError(f"pages count from 1, got {self.page}")
        if self.white_level is not None and not 0 < self.white_level < np.inf:
            raise ValueError(f"white is a level above 0, got {self.white_level:g}")


_AS_STATED = ReadOptions()


def read_photograph(path: Path, options: ReadOptions = _AS_STATED) -> Photograph:
    """Read a photograph: TIFF, PNG, JPEG, camera raw, OpenEXR, FITS, or any file that Pillow opens.

    An `ImageFileError` says what is wrong with the file or its levels.
    """
    data = read_file(path)
    with _naming(on_one_line(path)):
        stored = _stored(data, path)
        digest = sha256(data).hexdigest()
        return _photograph(stored, options, _Source(path, digest, len(data)))


def read_frames(path: Path, options: ReadOptions = _AS_STATED) -> Iterator[Photograph]:
    """Read every image of a file, one page in memory at a time: the frames of a stack."""
    data = read_file(path)
    with _naming(on_one_line(path)):
        _refuse_chosen_page(options)
        stored = _stored(data, path)
        source = _Source(path, sha256(data).hexdigest(), len(data))
        for page in range(1, stored.count + 1):
            yield _photograph(stored, replace(options, page=page), source)


def each_image(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield the images of files and folders, for very many: in any order, one by one."""
    for path in paths:
        if is_url(path):
            yield from _images_of_url(path)
            continue
        if not is_folder(path):
            yield path
            continue
        is_empty = True
        try:
            with os.scandir(path) as entries:
                for entry in entries:
                    if _is_listed(Path(entry.name)):
                        is_empty = False
                        yield path / entry.name
        except OSError as error:
            raise ApplicationError(f"cannot read the folder {path}: {error.strerror}") from error
        if is_empty:
            raise ApplicationError(f"{path}: the folder contains no image")


def _is_listed(path: Path) -> bool:
    """Whether a file of a folder counts as a photograph: hidden ones are none.

    On disks that others read as well, macOS keeps a ``._name.jpg`` beside each ``name.jpg``.
    """
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")


def is_folder(path: Path) -> bool:
    """Whether a folder is there; what cannot be reached is left to whoever reads it as a file."""
    try:
        return path.is_dir()
    except OSError:
        return False


def _images_of_url(path: Path) -> Iterator[Path]:
    url = url_of(path)
    try:
        if not remote_status(path).is_folder:
            yield path
            return
        is_empty = True
        for file in remote_files_in(path):
            if _is_listed(file):
                is_empty = False
                yield file
    except OSError as error:
        raise ApplicationError(f"cannot read {url}: {error.strerror}") from error
    if is_empty:
        raise ApplicationError(f"{url}: the folder contains no image")


def image_files_in(folder: Path) -> list[Path]:
    """Return the images in a folder, sorted by name."""
    try:
        return sorted(path for path in folder.iterdir() if _is_listed(path))
    except OSError as error:
        raise ApplicationError(f"cannot read the folder {folder}: {error.strerror}") from error


def frames_of(value: object, name: str, options: ReadOptions = _AS_STATED) -> Iterator[Photograph]:
    """Take an array for a frame, shape ``(rows, cols)``, or frames, ``(frames, rows, cols)``."""
    with _naming(name):
        _refuse_chosen_page(options)
    values = whole_array(value, name)
    if values.ndim not in (2, 3) or min(values.shape[-2:]) <= _COLOUR_PLANES:
        raise ArgumentError(
            f"frames are an array of (frames, rows, cols) or (rows, cols), not {values.shape}",
            argument=name,
        )
    for frame in values if values.ndim == 3 else values[np.newaxis]:
        yield photograph_of(frame, name, options)


def _refuse_chosen_page(options: ReadOptions) -> None:
    if options.page is not None or options.is_mean:
        raise DecodingError(
            "every page is a frame here: choose no page, and do not take the mean of the pages"
        )


def photograph_of(value: object, name: str, options: ReadOptions = _AS_STATED) -> Photograph:
    """Return anything that holds an array as a photograph, with the same options as for files.

    An array of any library is linear in light, its pages along the first axis; a picture of Pillow
    is encoded as those of its format.
    """
    source = _Source(Path(name))
    with _naming(name):
        if isinstance(value, Image):
            return _photograph(stored_picture(value), options, source)
        given = given_array(value, name)
        pages, masked = given.values, given.masked
        if options.page is None and not options.is_mean:
            pages, masked = pages[np.newaxis], None if masked is None else masked[np.newaxis]
        elif pages.ndim < 3:
            raise DecodingError(
                f"a stack has its pages along the first of 3 axes, not {pages.ndim}"
            )
        if masked is not None:
            masked = _masked_pixels(masked, options, name)
            pages = np.stack([_filled(page, masked) for page in pages])
        stored = StoredImage(
            count=len(pages), page=lambda index: pages[index], unmarked=(LINEAR, "")
        )
        return replace(_photograph(stored, options, source), masked=masked)


def taken_as(photograph: Photograph, options: ReadOptions) -> Photograph:
    """Return a photograph that was read before as these options would have read it."""
    if options.page is not None or options.is_mean:
        raise ImageFileError(
            f"{photograph.name}: it has been read already; to choose a page, give its file instead"
        )
    if options.encoding is not None:
        photograph = photograph.taken_as(options.encoding, "reading")
    if options.white_level is None:
        return photograph
    return replace(photograph, saturation_dn=photograph.white_level_dn(options.white_level))


@dataclass(frozen=True, slots=True)
class _Source:
    """Where pixels come from; the hash and the size of a file."""

    path: Path
    sha256: str | None = None
    file_bytes: int | None = None


@contextmanager
def _naming(shown: str) -> Iterator[None]:
    try:
        yield
    except DecodingError as error:
        raise ImageFileError(f"{shown}: {on_one_line(error)}") from error


def _photograph(stored: StoredImage, options: ReadOptions, source: _Source) -> Photograph:
    """The photograph that is chosen of what a file or an array holds."""
    shown = on_one_line(source.path)
    number = _page_number(stored, options)
    pixels, holds_more = _planes(stored, number, shown)
    encoding, encoding_from, is_stated = _encoding(
        stored, options, is_file=source.sha256 is not None
    )
    _refuse_other_channels(encoding, pixels)
    white = stored.white_dn or full_scale_dn(pixels)
    if white is None and not encoding.is_linear:
        _refuse_levels_beyond_white(float(pixels.max()), encoding)
    saturation = stored.saturation_dn or saturation_dn(pixels, white)
    variance, frames = stored.variance_dn2, stored.frames
    if options.is_mean and stored.count > 1:
        if source.file_bytes is not None:
            _refuse_swollen_stack(stored.count, pixels.nbytes, source.file_bytes)
        mean, variance = _mean(stored, encoding, white or 1.0, shown)
        frames, pixels = stored.count, encoding.encode(mean, white or 1.0)
    if saturation is not None:
        top = np.full((1, 1, max(len(encoding.curves), 1)), saturation)
        saturation = float(encoding.decode(top, white or 1.0).max())
    read = Photograph(
        path=source.path,
        stored=pixels,
        encoding=encoding,
        encoding_from=encoding_from,
        is_encoding_stated=is_stated,
        full_scale_dn=white,
        saturation_dn=saturation,
        is_jpeg=stored.is_jpeg,
        luma_steps=stored.luma_steps,
        jpeg_coding=stored.jpeg_coding,
        pattern=stored.pattern,
        facts=stored.facts,
        variance_dn2=variance,
        frames=frames,
        has_modelled_variance=stored.has_modelled_variance and encoding.is_linear,
        sha256=source.sha256,
        left_out=stored.left_out or ("its opacity" if holds_more else ""),
    )
    stated = options.white_level
    return read if stated is None else replace(read, saturation_dn=read.white_level_dn(stated))


def _masked_pixels(masked: BoolArray, options: ReadOptions, name: str) -> BoolArray:
    """Pixels that are masked in any channel of the pages that count, shape ``(rows, cols)``."""
    pages = masked if options.page is None else masked[options.page - 1 : options.page]
    axes = (0, *range(3, pages.ndim))
    found = np.asarray(pages.any(axis=axes))
    if found.all():
        raise ArgumentError("all of its pixels are masked", argument=name)
    return found


def _filled(page: AnyArray, masked: BoolArray) -> AnyArray:
    """A page with the nearest measured level where there is none: no edge, and no false level."""
    nearest = distance_transform_edt(masked, return_distances=False, return_indices=True)
    return np.asarray(page[tuple(nearest)])


def _stored(data: bytes, path: Path) -> StoredImage:
    if is_tiff(data):
        facts, tags = tiff_facts(data)
        if is_camera_raw(data, path, tags):
            return read_camera_raw(data, facts)
        return read_tiff_image(data)
    if is_exr(data):
        return read_exr_image(data)
    if is_fits(data):
        return read_fits_image(data)
    if is_camera_raw(data, path, frozenset()):
        return read_camera_raw(data, PhotographFacts())
    return read_raster_image(data)


def _levels(stored: StoredImage, number: int, shown: str) -> AnyArray:
    return _planes(stored, number, shown)[0]


def _planes(stored: StoredImage, number: int, shown: str) -> tuple[AnyArray, bool]:
    """The planes of light of a page, and whether there is an opacity that varies."""
    pixels = as_numbers(stored.page(number))
    refuse_unusable(pixels, shown)
    light, holds_more = light_planes(pixels)
    if holds_more and not stored.has_opacity:
        planes = pixels.shape[2]
        raise DecodingError(
            f"{planes} planes are neither grey nor RGB, and the last is not constant, as opacity "
            f"would be; give {'one' if planes == 2 else 'the three that are RGB'}"
        )
    return light, holds_more


def _refuse_swollen_stack(count: int, page_bytes: int, file_bytes: int) -> None:
    if is_swollen(count * page_bytes, file_bytes):
        raise DecodingError(
            f"{count} pages in a file of {file_bytes} bytes cannot be photographs; "
            "choose one with --page N"
        )


def _refuse_other_channels(encoding: Encoding, pixels: AnyArray) -> None:
    if len(encoding.curves) > 1 and pixels.ndim == 2:
        raise DecodingError(
            "its colour profile is for RGB and its pixels are grey; "
            "say with --encoding what its levels are"
        )


def _refuse_levels_beyond_white(highest: float, encoding: Encoding) -> None:
    if highest > _WHITE_OF_FLOATS:
        raise DecodingError(
            f"{encoding.name} levels in floating point run from 0 to 1, not to {highest:.3g}: "
            "give --encoding linear, or scale them"
        )


def _page_number(stored: StoredImage, options: ReadOptions) -> int:
    """The page that is asked for, from 0; the first one of several where their mean is."""
    if options.page is not None and options.page > stored.count:
        pages = "page" if stored.count == 1 else "pages"
        raise DecodingError(
            f"--page {options.page} was asked for, but the file has {stored.count} {pages}"
        )
    if stored.count > 1 and options.page is None and not options.is_mean:
        raise DecodingError(
            f"a stack of {stored.count} pages; choose one with --page N, or --mean if they are "
            "frames of one scene"
        )
    return (options.page or 1) - 1


def _mean(
    stored: StoredImage, encoding: Encoding, white_dn: float, shown: str
) -> tuple[FloatArray, FloatArray]:
    """Mean and unbiased variance of the linear levels of all pages, one page in memory at a time.

    Welford, "Note on a method for calculating corrected sums of squares and products",
    Technometrics 4 (1962) 419.
    """
    mean = encoding.decode(_levels(stored, 0, shown), white_dn)
    squares = np.zeros_like(mean)
    for count in range(2, stored.count + 1):
        page = encoding.decode(_levels(stored, count - 1, shown), white_dn)
        if page.shape != mean.shape:
            raise DecodingError(
                f"pages of {mean.shape} and {page.shape} pixels cannot be averaged; choose one "
                "with --page N"
            )
        deviation = page - mean
        mean = mean + deviation / count
        squares += deviation * (page - mean)
    return mean, squares / (stored.count - 1)


def _encoding(
    stored: StoredImage, options: ReadOptions, *, is_file: bool
) -> tuple[Encoding, str, bool]:
    """The encoding, what decided it, and whether anybody states it."""
    if options.encoding is not None:
        return options.encoding, "--encoding" if is_file else "", True
    marked = stored.marked()
    if marked is not None:
        return *marked, True
    encoding, kind = stored.unmarked
    return encoding, f"usual for {kind} without a mark" if kind else "", False


class Inputs:
    """Reads photographs in one way, lists all that was read, and announces each kind's encoding."""

    def __init__(
        self,
        options: ReadOptions | None = None,
        announce: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.options = options or ReadOptions()
        self._announce = announce
        self._files: dict[str, str] = {}
        self._encodings: list[str] = []
        self._announced: set[str] = set()

    def photograph(self, path: Path) -> Photograph:
        """Read a photograph and list it."""
        photograph = read_photograph(path, self.options)
        self._add_head(photograph)
        return photograph

    def frames(self, path: Path) -> Iterator[Photograph]:
        """Read every image of a file, one after the other, and list the file."""
        for frame in read_frames(path, self.options):
            self._add_head(frame)
            yield frame

    def add_given(self, photograph: Photograph) -> None:
        """Say what there is to say of a photograph that no file holds."""
        self._say(photograph)

    def grey(self, path: Path) -> FloatArray:
        """Read the linear grey levels of a photograph, shape ``(rows, cols)``, and list it."""
        return self.photograph(path).grey_dn

    def add(self, path: Path | None) -> None:
        """List a file that another reader reads: a PSF, curves, a table of noise."""
        if path is None:
            return
        self._list(path, sha256(read_file(path)).hexdigest(), None)

    def add_session(self, session: Session) -> None:
        """List a capture session by its journal, which holds the hashes of the captures."""
        self.add(session.path / JOURNAL_NAME)
        self._list_encoding("linear")

    def announce(self, sentence: str) -> None:
        """Say what another process found out about photographs."""
        self._announce(sentence)

    def add_known(self, path: str, sha256: str, encoding: str | None) -> None:
        """List a file whose hash and encoding another process found out."""
        self._list(Path(path), sha256, encoding)

    def add_all(self, made: Provenance | None) -> None:
        """List the files that another result was made from."""
        for one in () if made is None else made.inputs:
            self.add_known(one.path, one.sha256, None)

    def provenance(self, command: str) -> Provenance:
        """Return the provenance of what is made from all that has been read."""
        return Provenance(
            version=version("standoff"),
            created=utc_now(),
            command=on_one_line(command),
            inputs=tuple(
                InputFile(path=path, sha256=digest) for path, digest in self._files.items()
            ),
            encoding=self._encodings[0] if len(self._encodings) == 1 else tuple(self._encodings),
        )

    def leave_unsaid(self, kind: str) -> None:
        """Make no remark of a kind: the caller has been told already."""
        self._announced.add(kind)

    def _add_head(self, head: PhotographHead) -> None:
        if head.sha256 is not None:
            self._list(head.path, head.sha256, head.encoding.name)
        self._say(head)

    def _list(self, path: Path, digest: str, encoding: str | None) -> None:
        self._files[on_one_line(path)] = digest
        if encoding is not None:
            self._list_encoding(encoding)

    def _list_encoding(self, encoding: str) -> None:
        if encoding not in self._encodings:
            self._encodings.append(encoding)

    def _say(self, photograph: PhotographHead) -> None:
        for kind, sentence in photograph.remarks.items():
            if kind not in self._announced:
                self._announced.add(kind)
                self._announce(sentence)
