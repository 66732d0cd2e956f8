"""What a detector of changes is, and how it is named: function, command, ONNX file, built in."""

import hashlib
import inspect
import re
import shlex
import shutil
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Final, Literal, Protocol
from uuid import uuid4

import cloudpickle

from acquisition.printable import on_one_line
from analysis.errors import DetectorError
from simulation.arrays import Float32Array, FloatArray


class Detector(Protocol):
    """A function that says how much changed between two photographs.

    Any function with these arguments is a detector. It may write into the arrays. If it has an
    attribute ``colour = True`` it is given colour photographs, otherwise grey levels.
    """

    def __call__(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray, /
    ) -> float | Float32Array:
        """Compare a follow-up with its reference.

        Parameters
        ----------
        reference, followup
            Levels linear in light, float32, of shape ``(rows, cols)``, or ``(rows, cols, 3)`` if
            the detector takes colours; the two may differ in size.
        homography
            Shape (3, 3): follow-up pixel centres ``(x, y, 1)`` to reference pixel centres.

        Returns
        -------
        float or array
            One score for the pair, or a score for each pixel of the follow-up, of shape
            ``(rows, cols)``. The higher, the more has changed; the scale is the detector's own.
        """
        ...


def takes_colour(detector: Detector) -> bool:
    """Whether a detector has an attribute ``colour`` that is True.

    Then both of its photographs have shape ``(rows, cols, 3)``: red, green and blue, three times
    the same plane of a grey one. Any other detector is given grey levels, of colours their luma.
    """
    return getattr(detector, "colour", False) is True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DetectorAnswer:
    """Answer of a detector for one pair.

    Parameters
    ----------
    score
        Score of the pair: the number that the detector returned, or the largest value of its map
        among the pixels that show the reference.
    map
        Score of each pixel of the follow-up, finite; for pixels that do not show the reference, the
        least value of those that do. None if the detector returned a number.
    """

    score: float
    map: Float32Array | None = field(default=None, repr=False)


BUILT_IN_DETECTORS: Final = (
    "absolute-difference",
    "colour-difference",
    "ncc",
    "ssim",
    "ir-mad",
    "changes",
)
"""Names of the detectors that come with the project."""

PLACEHOLDERS: Final = ("{reference}", "{followup}", "{homography}", "{out}")
_NEEDED: Final = ("{reference}", "{followup}", "{out}")
_FUNCTION = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*")
_NAME_LETTERS = 60

_DetectorKind = Literal["built-in", "function", "onnx", "learned", "command", "object"]

_FILES: Final[dict[str, _DetectorKind]] = {".onnx": "onnx", ".pt": "learned"}


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorSpec:
    """Which detector is meant; nothing of it has run yet. Made by `parse` or `of_callable`.

    Parameters
    ----------
    kind
        What ``text`` is; an ``object`` is the callable ``function`` itself.
    text
        Name of a built-in detector, ``module:function``, path of an ONNX file or of a learned
        detector, or command line.
    name
        Short and printable.
    identity
        Changes when the detector does, as far as its files show: the text and the SHA-256 of the
        module's file, the ONNX file, or the files that a command names.
    folder
        Working folder when it was named: relative paths and modules are looked for there first.
    function
        The callable, if there is one.
    """

    kind: _DetectorKind
    text: str
    name: str
    identity: str
    folder: str
    function: Detector | None = field(default=None, repr=False)

    @classmethod
    def parse(cls, text: str) -> "DetectorSpec":
        """Return the detector that a text names.

        Parameters
        ----------
        text
            A name of ``BUILT_IN_DETECTORS``; ``module:function``; the path of an ``.onnx`` file, or
            of the ``.pt`` file of a learned detector; or a command line with ``{reference}``,
            ``{followup}``, ``{out}`` and, if it wants it, ``{homography}``.

        Raises
        ------
        DetectorError
            With reason ``missing``, if it is none of them, the file is not there, or the command
            line lacks a placeholder.
        """
        if text in BUILT_IN_DETECTORS:
            return cls._named("built-in", text, name=text, files=())
        is_command = any(mark in text for mark in PLACEHOLDERS)
        of_file = _FILES.get(Path(text).suffix)
        if of_file is not None and not is_command:
            path = Path(text).expanduser().absolute()
            if not path.is_file():
                raise DetectorError(f"detector {text}: no such file", reason="missing")
            return cls._named(of_file, str(path), name=path.name, files=(path,))
        if _FUNCTION.fullmatch(text):
            source = _module_file(text.split(":")[0])
            return cls._named("function", text, name=text, files=(source,) if source else ())
        if is_command or len(text.split()) > 1:
            words = command_words(text)
            files = _named_files(words)
            script = next((path for path in files if path.name in _base_names(words[1:])), None)
            name = script.name if script else Path(words[0]).name
            return cls._named("command", text, name=name, files=files)
        raise DetectorError(
            f"detector {text!r}: not one of the built-in {', '.join(BUILT_IN_DETECTORS)}; a "
            "detector of your own is module:function, the path of an .onnx or .pt file, or a "
            "command with {reference}, {followup} and {out}",
            reason="missing",
        )

    @classmethod
    def of_callable(cls, function: Detector) -> "DetectorSpec":
        """Return the detector that a callable is. It runs in this process.

        What it raises, NaN and wrong shapes are caught; a crash or a hang of it is one of this
        process. Its identity is that of its code and of the state that it is pickled with; of one
        that cannot be pickled, it is new each time.
        """
        if not callable(function):
            raise TypeError(f"detector: expected a callable, got {type(function).__name__}")
        name = getattr(function, "__qualname__", type(function).__qualname__)
        module = getattr(function, "__module__", type(function).__module__)
        digest = hashlib.sha256()
        try:
            digest.update(cloudpickle.dumps(function))
        except Exception:  # noqa: BLE001 - objects refuse to be pickled with any error
            digest.update(uuid4().bytes)
        if takes_colour(function):
            digest.update(b"colour")  # what is pickled by its name may lack its attributes
        with suppress(TypeError, OSError):
            plain = function if inspect.isroutine(function) else type(function)
            digest.update(Path(inspect.getsourcefile(plain) or "").read_bytes())
        return cls(
            kind="object",
            text=f"{module}:{name}",
            name=_short(name),
            identity=f"object {module}:{name} {digest.hexdigest()}",
            folder=str(Path.cwd()),
            function=function,
        )

    @classmethod
    def _named(
        cls, kind: _DetectorKind, text: str, *, name: str, files: tuple[Path, ...]
    ) -> "DetectorSpec":
        hashes = [f"{path} {_file_hash(path)}" for path in files]
        return cls(
            kind=kind,
            text=text,
            name=_short(name),
            identity="\n".join([f"{kind} {text}", *hashes]),
            folder=str(Path.cwd()),
        )


def command_words(text: str) -> list[str]:
    """Split a command line as a shell does, without running one.

    Raises
    ------
    DetectorError
        If a quotation is not closed, or a placeholder is missing.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise DetectorError(
            f"detector {on_one_line(text)!r}: {str(error).lower()}; check its quotation marks",
            reason="missing",
        ) from error
    lacking = [mark for mark in _NEEDED if not any(mark in word for word in words)]
    if lacking:
        raise DetectorError(
            f"detector {on_one_line(text)!r}: the command lacks {' and '.join(lacking)}; it reads "
            "two TIFF files at {reference} and {followup} and writes a TIFF or a number to {out}",
            reason="missing",
        )
    return words


def _short(name: str) -> str:
    shown = on_one_line(name)
    return shown if len(shown) <= _NAME_LETTERS else f"{shown[: _NAME_LETTERS - 3]}..."


def _module_file(module: str) -> Path | None:
    """File of a module, found without importing anything, in the working folder first."""
    search: list[str] | None = None
    parts = module.split(".")
    for number in range(len(parts)):
        found = None
        with suppress(ImportError, ValueError):
            at = [str(Path.cwd())] if search is None else search
            found = PathFinder.find_spec(".".join(parts[: number + 1]), at)
            if found is None and search is None:
                found = PathFinder.find_spec(parts[0])
        if found is None:
            return None
        search = list(found.submodule_search_locations or ())
    origin = found.origin if found is not None else None
    return Path(origin) if origin and Path(origin).is_file() else None


def _named_files(words: list[str]) -> tuple[Path, ...]:
    """Files that a command's words name, its program first; also those of ``--option=FILE``."""
    program = shutil.which(words[0])
    parts = [part for word in words[1:] for part in (word, word.partition("=")[2])]
    others = [Path(part).absolute() for part in parts if part]
    named = [Path(program).absolute()] if program else []
    return tuple(path for path in (*named, *others) if _is_file(path))


def _base_names(words: list[str]) -> set[str]:
    return {Path(word).name for word in words}


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a word too long for a name
        return False


def _file_hash(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        return f"unread ({error.strerror})"
