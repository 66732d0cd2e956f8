"""By which curve of d' poses are judged: chosen from files that the console knows or is sent."""

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from threading import Lock

from acquisition.printable import on_one_line
from acquisition.session import MANIFEST_NAME
from analysis.detectability import DetectabilityCurve, DetectabilityCurves
from standoff.console.monitors import TrackerMaker, tracker_maker
from standoff.console.session_library import CURVES_FOLDER
from standoff.errors import REPORTED_ERRORS, ApplicationError, ArgumentError
from standoff.library import (
    CurveChoice,
    given_curve,
    make_folder,
    read_any_curves,
    write_file,
)

MOST_BYTES = 4 * 2**20
"""Of a file that is sent: hundreds of curves."""

MOST_CURVES = 500
MOST_FILES = 200
LONGEST_NAME_BYTES = 200
LONGEST_WORDS = 300
DEFAULT_MIN_DPRIME = 2.0

_OPTIONS = {
    "model": "model",
    "observer": "observer",
    "noise_dn": "noise",
    "contrast_dn": "contrast",
}
"""Options of ``standoff pose`` by the values of a choice."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenCurves:
    """What the console was started with; ``path`` is None if no file was named."""

    path: Path | None = None
    min_dprime: float = DEFAULT_MIN_DPRIME
    choice: CurveChoice = field(default_factory=CurveChoice)


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveView:
    """What was chosen: a file, one of its curves, the threshold of d'.

    ``file`` is empty if none is chosen, ``curves`` are its curves in words, and ``chosen`` is None
    while one of several is to be chosen. ``revision`` counts the choices of files, and the files
    that were sent.
    """

    revision: int = 0
    file: str = ""
    curves: tuple[str, ...] = ()
    chosen: int | None = None
    min_dprime: float = DEFAULT_MIN_DPRIME

    @property
    def name(self) -> str:
        """The curve in words; empty if there is none."""
        return "" if self.chosen is None else self.curves[self.chosen]


class PoseCurves:
    """The curve and the threshold by which poses are judged from now on, in ``view``.

    Files of curves are looked for in the folder of sessions. ``judge_by`` is called at each change
    with what makes a tracker, None if there is no curve, and the options of ``standoff pose`` that
    name the curve. What was given at the start must tell which curve is meant.
    """

    def __init__(
        self,
        sessions: Path,
        given: GivenCurves,
        judge_by: Callable[[TrackerMaker | None, tuple[str, ...]], None],
    ) -> None:
        self._sessions = sessions
        self._given = given.path
        self._judge_by = judge_by
        self._lock = Lock()
        self._document: DetectabilityCurves | None = None
        self._path: Path | None = None
        if not 0 < given.min_dprime < inf:
            raise ArgumentError(f"a threshold must be a number above 0, got {given.min_dprime:g}")
        self.view = CurveView(min_dprime=given.min_dprime)
        if given.path is not None:
            curve = given_curve(given.path, given.min_dprime, given.choice)
            document = read_any_curves(given.path)
            chosen = [each.choice for each in document.curves].index(curve.choice)
            self._use(on_one_line(str(given.path)), given.path, document, chosen)

    @property
    def curve(self) -> DetectabilityCurve | None:
        """The curve that is chosen; None without one."""
        chosen, document = self.view.chosen, self._document
        return None if chosen is None or document is None else document.curves[chosen]

    def files(self) -> tuple[str, ...]:
        """Names of the files to choose from: the one given at the start, those of the sessions."""
        return tuple(self._files())

    def choose(self, file: str, curve: int | None = None) -> None:
        """Judge by a curve of a file; by none while one of several is to be chosen."""
        if not file:
            self._use("", None, None, None)
            return
        path = self._files().get(file)
        if path is None:
            raise ApplicationError(f"There is no file {file!r} any more: choose one from the list.")
        document = read_any_curves(path)
        _refuse_too_many(file, document)
        names = _names(document)
        if file == self.view.file and curve is not None and names != self.view.curves:
            self._use(file, path, document, None)
            raise ApplicationError(
                f"{file} has been rewritten in the meantime: choose its curve again."
            )
        if curve is None and len(names) == 1:
            curve = 0
        if curve is not None and not curve < len(names):
            raise ApplicationError(f"{file} has only {len(names)} curves.")
        if (
            curve is not None
            and [each.choice for each in document.curves].count(document.curves[curve].choice) > 1
        ):
            raise ApplicationError(
                f"{file} has two curves called {names[curve]}: use another file."
            )
        self._use(file, path, document, curve)

    def set_threshold(self, min_dprime: float) -> None:
        """Demand another d', above 0, of a pose that is good enough."""
        with self._lock:
            self.view = replace(self.view, min_dprime=min_dprime)
        self._apply()

    def store(self, name: str, data: bytes) -> str:
        """Keep a file of curves among the sessions, and return its name for ``choose``."""
        _refuse_name(name)
        if len(data) > MOST_BYTES:
            raise ApplicationError(
                f"{name} is larger than {MOST_BYTES // 2**20} MiB: too large for a file of curves."
            )
        _refuse_too_many(name, _curves_in(name, data))
        folder = self._sessions / CURVES_FOLDER
        path = folder / name
        with self._lock:
            if folder.is_symlink() or (folder / MANIFEST_NAME).exists():
                raise ApplicationError(
                    f"{folder} is a link or a session: curves cannot be stored there."
                )
            make_folder(folder)
            if not os.path.lexists(path):
                write_file(path, data)
            elif path.is_symlink() or not path.is_file() or path.read_bytes() != data:
                raise ApplicationError(
                    f"There is already another file {CURVES_FOLDER}/{name}, which is not replaced: "
                    "give yours another name."
                )
            self.view = replace(self.view, revision=self.view.revision + 1)
        return f"{CURVES_FOLDER}/{name}"

    def _use(
        self,
        file: str,
        path: Path | None,
        document: DetectabilityCurves | None,
        chosen: int | None,
    ) -> None:
        self._path, self._document = path, document
        with self._lock:
            self.view = replace(
                self.view,
                revision=self.view.revision + 1,
                file=file,
                curves=() if document is None else _names(document),
                chosen=chosen,
            )
        self._apply()

    def _apply(self) -> None:
        view, document, path = self.view, self._document, self._path
        if document is None or path is None or view.chosen is None:
            self._judge_by(None, ())
            return
        curve = document.curves[view.chosen]
        words = [f"--curves={path}", f"--min-dprime={view.min_dprime}"]
        for value, option in _OPTIONS.items():
            if len({getattr(each, value) for each in document.curves}) > 1:
                words.append(f"--{option}={getattr(curve, value)}")
        self._judge_by(tracker_maker(curve, view.min_dprime), tuple(words))

    def _files(self) -> dict[str, Path]:
        found = {} if self._given is None else {on_one_line(str(self._given)): self._given}
        inside = self._sessions / CURVES_FOLDER
        files = [*self._sessions.glob("curves.json"), *sorted(self._sessions.glob("*.curves.json"))]
        if not inside.is_symlink():
            files += sorted(inside.glob("*.json"))
        for path in files:
            name = str(path.relative_to(self._sessions))
            is_given = self._given is not None and path.resolve() == self._given.resolve()
            if not is_given and name.isprintable() and not path.is_symlink() and path.is_file():
                found[name] = path
        return dict(list(found.items())[:MOST_FILES])


def _names(document: DetectabilityCurves) -> tuple[str, ...]:
    return tuple(on_one_line(each.name)[:LONGEST_WORDS] for each in document.curves)


def _refuse_name(name: str) -> None:
    if (
        not name.endswith(".json")
        or name.startswith(".")
        or any(mark in name for mark in "/\\:")
        or not name.isprintable()
        or len(name.encode("utf-8", "replace")) > LONGEST_NAME_BYTES
    ):
        raise ApplicationError(
            "A file of curves must be called NAME.json, such as curves.json, without folders."
        )


def _refuse_too_many(file: str, document: DetectabilityCurves) -> None:
    if len(document.curves) > MOST_CURVES:
        raise ApplicationError(
            f"{file} has {len(document.curves)} curves; at most {MOST_CURVES} can be listed."
        )


def _curves_in(name: str, data: bytes) -> DetectabilityCurves:
    """Curves in the bytes of a file; refuses in one line what is not a file of curves."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "curves.json"
        path.write_bytes(data)
        try:
            return read_any_curves(path)
        except REPORTED_ERRORS as error:
            words = on_one_line(str(error).replace(str(path), name))
            raise ApplicationError(words[:LONGEST_WORDS]) from error
