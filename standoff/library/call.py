"""One call of the library: its arguments, the files that it reads, its remarks, its progress."""

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from itertools import chain, islice
from numbers import Number
from os import PathLike
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeAlias, TypeVar, cast

from numpy.typing import NDArray

from acquisition.files import Provenance
from acquisition.photographs import (
    BenchCapture,
    Inputs,
    Photograph,
    ReadOptions,
    photograph_of,
    read_photograph,
    taken_as,
)
from acquisition.printable import on_one_line
from acquisition.session import Session
from analysis.design_cache import keep_designs_on_disk
from calibration.files import read_noise
from calibration.noise import NoiseCalibration, NoiseMeasurement
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, MeasuredPsf, SeparablePsf, TabulatedPsf
from simulation.arguments import (
    ArgumentError,
    ArgumentTypeError,
    FilePath as FilePath,
    is_array_like,
    kind_of,
    output_path as output_path,
    path_of as path_of,
)
from simulation.arrays import AnyArray, FloatArray
from simulation.capture_noise import CaptureNoise
from standoff.compile_notice import announce_compiling
from standoff.library.caller import caller

ImageLike: TypeAlias = NDArray[Any] | Photograph | BenchCapture | FilePath
"""Levels linear in light, ``(rows, cols)`` or ``(rows, cols, channels)``, or an image file.

Whatever has ``__array__`` is an array.
"""

BarePsf: TypeAlias = GaussianPsf | MeasuredPsf | SeparablePsf | TabulatedPsf
PsfLike: TypeAlias = BarePsf | PsfCalibration | FilePath
"""A PSF, a calibration that holds one, or the path of a psf.json or of a PSF of one's own."""

NoiseLike: TypeAlias = CaptureNoise | NoiseCalibration | NoiseMeasurement | FilePath
"""The noise of a capture, what was measured of a camera's, or the path of a noise.json."""


def listed_paths(files: FilePath | Iterable[FilePath], name: str) -> Iterator[Path]:
    """Yield one path or several, which need not fit into memory; refuse anything but paths."""
    given = iter([files] if isinstance(files, str | PathLike) else files)
    first = next(given, None)
    if first is None:
        raise ArgumentError("expected at least one path, got none", argument=name)
    return (path_of(one, name) for one in chain((first,), given))


def opened_session(session: Session | FilePath) -> Session:
    """Return a capture session, opened if its folder is given."""
    return session if isinstance(session, Session) else Session(path_of(session, "session"))


def photograph(
    image: ImageLike, name: str = "image", options: ReadOptions | None = None
) -> Photograph:
    """Return an image with what its file, or the type of its array, says about its levels.

    The one way in for images, from wherever they come.
    """
    options = options or ReadOptions()
    if isinstance(image, BenchCapture):
        image = image.photograph
    if isinstance(image, Photograph):
        return taken_as(image, options)
    if isinstance(image, str | PathLike):
        return read_photograph(path_of(image, name), options)
    if is_array_like(image) or isinstance(image, list | tuple):
        return photograph_of(image, name, options)
    raise ArgumentTypeError(
        f"expected an array or the path of an image, got {kind_of(image)}", argument=name
    )


def colour_planes(
    image: ImageLike, name: str = "image", options: ReadOptions | None = None
) -> AnyArray:
    """Return the levels of an image without an opacity plane, grey or in colour."""
    return photograph(image, name, options).colour_planes


def grey_image(
    image: ImageLike, name: str = "image", options: ReadOptions | None = None
) -> FloatArray:
    """Return the grey levels of an image, shape ``(rows, cols)``; of a colour image the luma."""
    return photograph(image, name, options).grey_dn


def listed_images(images: object, name: str = "images") -> list[ImageLike]:
    """Return one image or several as a list.

    A three-dimensional array is one colour image; pass several images as a list. A column of paths
    is several files, and a list of rows of numbers one image.
    """
    if isinstance(images, Photograph | BenchCapture | str | PathLike):
        return [images]
    if is_array_like(images) and not _holds_paths(images):
        return [cast("ImageLike", images)]
    if isinstance(images, Mapping) or not isinstance(images, Iterable):
        raise ArgumentTypeError(
            f"expected arrays or paths of images, got {kind_of(images)}", argument=name
        )
    listed = list(images)
    if not listed:
        raise ArgumentError("expected at least one image, got none", argument=name)
    row = listed[0]
    if isinstance(row, list | tuple) and row and isinstance(row[0], Number):
        return [cast("ImageLike", listed)]
    return listed


def _holds_paths(images: object) -> bool:
    """Whether it is a column of text or of other objects, and no numbers."""
    kind = getattr(getattr(images, "dtype", None), "kind", None)
    return (
        isinstance(images, Iterable)
        and (kind in tuple("OUST") or str(kind) == "None")
        and all(isinstance(one, str | PathLike) for one in islice(images, 1))
    )


def with_white_level(reading: ReadOptions | None, white_level: float | None) -> ReadOptions:
    """Return the read options with ``white_level``, if it is stated, as the clipping level."""
    options = reading or ReadOptions()
    return options if white_level is None else replace(options, white_level=white_level)


def stored_noise(noise: NoiseLike | None) -> NoiseCalibration | CaptureNoise | None:
    """Return the noise of a camera, read from its noise.json if a path is given."""
    if noise is None or isinstance(noise, CaptureNoise | NoiseCalibration):
        return noise
    if isinstance(noise, NoiseMeasurement):
        return noise.calibration
    return read_noise(path_of(noise, "noise"))


def camera_noise(noise: NoiseLike | None) -> CaptureNoise | None:
    """Return the noise of a capture, however the noise of its camera is given."""
    known = stored_noise(noise)
    return known.capture_noise if isinstance(known, NoiseCalibration) else known


class Progress(Protocol):
    """Shows the progress of a call; ``docs/library.md`` has adapters for tqdm and rich.

    Examples
    --------
    >>> from contextlib import contextmanager
    >>> class Counted:
    ...     @contextmanager
    ...     def bar(self, task, total):
    ...         print(task)
    ...         yield lambda done: None
    ...
    ...     def note(self, text):
    ...         print(text)
    >>> geometry = standoff.calibrate_geometry("board", progress=Counted())
    matching captures
    the scale comes from the board 11x8:12:9:4X4_50; --board names another
    """

    def bar(self, task: str, total: int) -> AbstractContextManager[Callable[[int], None]]:
        """Begin a task of ``total`` steps; the block gets a function to call with those done."""
        ...

    def note(self, text: str) -> None:
        """Show a remark as soon as it is made; the ``notes`` of the result include it as well."""
        ...


class Silent:
    """The progress of a call whose caller gave no ``progress``."""

    def bar(self, task: str, total: int) -> AbstractContextManager[Callable[[int], None]]:
        """Show nothing."""
        return nullcontext(lambda _: None)

    def note(self, text: str) -> None:
        """Show nothing: the result has the remark."""


class Call:
    """What the parts of one public function share: its provenance, its remarks, its progress.

    ``function`` is its name in the provenance. ``files`` are its other arguments, of which the
    provenance lists the paths. ``white_level`` is the level at which photographs are clipped, if it
    is stated.
    """

    def __init__(
        self,
        function: str,
        progress: Progress | None = None,
        reading: ReadOptions | None = None,
        files: Iterable[object] = (),
        white_level: float | None = None,
    ) -> None:
        announce_compiling()
        keep_designs_on_disk()
        self._function = function
        self._progress = progress or Silent()
        self._notes: dict[str, None] = {}
        self.inputs = Inputs(with_white_level(reading, white_level), self.announce)
        for given in files:
            if isinstance(given, str | PathLike):
                self.inputs.add(Path(given))

    @property
    def notes(self) -> tuple[str, ...]:
        """Every remark so far, once each."""
        return tuple(self._notes)

    def note(self, text: str) -> None:
        """Make a remark that ``progress`` shows at once, the first time that it is made."""
        if on_one_line(text) not in self._notes:
            self.announce(text)
            self._progress.note(text)

    def announce(self, text: str) -> None:
        """Make a remark for the end, such as one about how a photograph was read."""
        self._notes[on_one_line(text)] = None

    def photograph(self, image: ImageLike, name: str = "image") -> Photograph:
        """Return an image with what is known of its levels; a file is listed."""
        if isinstance(image, str | PathLike):
            return self.inputs.photograph(path_of(image, name))
        found = photograph(image, name, self.inputs.options)
        if not isinstance(image, Photograph):
            self.inputs.add_given(found)
        return found

    @contextmanager
    def bar(self, task: str, total: int) -> Iterator[Callable[[int], None]]:
        """Give the block a function that shows how many of ``total`` steps are done."""
        with self._progress.bar(task, total) as advance_to:
            yield advance_to

    def provenance(self) -> Provenance:
        """Return the provenance of what is made from all that has been read."""
        return self.inputs.provenance(caller(self._function))

    def provenance_of(self, session: Session | None, *files: Path | None) -> Provenance:
        """Return the provenance of what is made from only a session, only files, or both."""
        inputs = Inputs()
        if session is not None:
            inputs.add_session(session)
        for path in files:
            inputs.add(path)
        return inputs.provenance(caller(self._function))


_P = ParamSpec("_P")
_R = TypeVar("_R")


def with_keywords_of(
    other: Callable[..., object],
) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Give a function that takes ``**how`` the keywords of another one, in addition to its own.

    They replace ``how`` in its signature and in its docstring.
    """

    def decorated(function: Callable[_P, _R]) -> Callable[_P, _R]:
        signature = inspect.signature(function)
        own = [one for one in signature.parameters.values() if one.kind is not one.VAR_KEYWORD]
        theirs = [
            one
            for one in inspect.signature(other).parameters.values()
            if one.kind is one.KEYWORD_ONLY and one.name not in signature.parameters
        ]
        vars(function)["__signature__"] = signature.replace(parameters=[*own, *theirs])
        annotations = {one.name: one.annotation for one in theirs}
        function.__annotations__ = {
            name: hint for name, hint in function.__annotations__.items() if name != "how"
        } | annotations
        names = ", ".join(one.name for one in theirs)
        function.__doc__ = re.sub(r"^( +)how$", rf"\1{names}", function.__doc__ or "", flags=re.M)
        return function

    return decorated
