"""Computes a session's results, each by the command that an operator would type."""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import isfinite
from pathlib import Path
from threading import Lock, Thread
from typing import IO, Any, Literal

from acquisition.choices import ExportFormat
from acquisition.errors import OperatorStopError
from acquisition.printable import on_one_line
from acquisition.session import CaptureRecord, Session
from acquisition.untrusted import parse_json
from standoff.console.jobs import Job
from standoff.console.photographs import (
    ImportRequest,
    PhotographInbox,
    import_arrived,
    photograph_file,
)
from standoff.console.results import (
    EXPORTS,
    FILES,
    TEXTURED,
    TITLES,
    ResultFiles,
    ResultKind,
    heights_of,
    key_figures,
    missing_for,
    pair_files,
    read_document,
)
from standoff.errors import REPORTED_ERRORS, ApplicationError
from standoff.library import RESULTS_FOLDER, make_folder, write_file
from standoff.terminal import PROGRESS_VARIABLE

NICENESS = 10
"""Below the console's own: the live picture and STOP come first."""

CHECK_S = 0.1
INTERRUPTED_S, TERMINATED_S = 5.0, 2.0
"""How long a process may take to end after SIGINT, and after SIGTERM."""

MAX_JSON_BYTES = 50 * 10**6
CHANGED = "the PSF has changed: "
OPTICS = ("lens", "focal_length_mm", "pixel_pitch_um")
SAME_HEIGHT = 0.01
"""Heights that differ by less, relative to themselves, are the same: defocus is hardly another."""

_PROGRESS = re.compile(r"(?P<what>.+): (?P<done>\d+) of (?P<total>\d+) after \d+ s")
_ERROR = "standoff: "


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandProgress:
    """What a command is doing; ``total`` is 0 while it does not say how much there is to do."""

    text: str
    done: int = 0
    total: int = 0


@dataclass(slots=True)
class _Said:
    """What a command says on stderr: how far it is, and why it failed; its remarks pass."""

    tell: Callable[[CommandProgress], None]
    fault: str = ""

    def hear(self, lines: IO[str]) -> None:
        for line in lines:
            text = on_one_line(line.strip())
            found = _PROGRESS.fullmatch(text)
            if found is not None:
                done, total = int(found["done"]), int(found["total"])
                self.tell(CommandProgress(text=found["what"], done=done, total=total))
            elif text.startswith(_ERROR):
                self.fault = text.removeprefix(_ERROR)
            elif text.startswith("note: compiling"):
                self.tell(CommandProgress(text=text.removeprefix("note: ")))
            elif text and not text.startswith("note: "):
                self.fault = self.fault or text


def run_command(
    words: Sequence[str],
    *,
    check: Callable[[], None],
    tell: Callable[[CommandProgress], None] = lambda _: None,
) -> object:
    """Run ``standoff`` with these words and ``--json``; return the document that it prints.

    It runs at low priority. ``check`` is called ten times a second, and what it raises ends the
    process, as Ctrl-C does; ``tell`` is called in another thread. A command that fails raises an
    `ApplicationError` with its own reason in one line.
    """
    said = _Said(tell)
    with tempfile.TemporaryFile() as out:
        process = subprocess.Popen(  # noqa: S603 - our own command, without a shell
            [sys.executable, "-m", "standoff", words[0], "--json", *words[1:]],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=os.environ | {PROGRESS_VARIABLE: "1", "NO_COLOR": "1"},
            start_new_session=True,  # Ctrl-C in the console's terminal ends the console in order
        )
        with suppress(OSError):  # it has ended already
            os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
        assert process.stderr is not None
        hearing = Thread(target=said.hear, args=(process.stderr,), name="stderr", daemon=True)
        hearing.start()
        try:
            status = _waited(process, check)
        finally:
            _end(process)
            hearing.join(TERMINATED_S)  # what it started may still hold the pipe
            process.stderr.close()
        if status in (130, -signal.SIGINT):
            raise OperatorStopError("interrupted")
        if status != 0:
            raise ApplicationError(said.fault or f"standoff {words[0]} ended with status {status}")
        out.seek(0)
        return _document(out)


def _waited(process: subprocess.Popen[str], check: Callable[[], None]) -> int:
    while True:
        check()
        with suppress(subprocess.TimeoutExpired):
            return process.wait(CHECK_S)


def _end(process: subprocess.Popen[str]) -> None:
    """End a process that still runs, and whatever it started."""
    for number, patience_s in ((signal.SIGINT, INTERRUPTED_S), (signal.SIGTERM, TERMINATED_S)):
        if process.poll() is not None:
            return
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(patience_s)
    if process.poll() is None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _document(out: IO[bytes]) -> object:
    data = out.read(MAX_JSON_BYTES + 1)
    if len(data) > MAX_JSON_BYTES:
        return None
    try:
        return parse_json(data)
    except ValueError:
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A psf.json and what it was calibrated on: camera, optics and time of the first capture.

    ``heights_mm`` are the least and largest height of its edges, None where it states none.
    """

    path: Path
    session: str
    serial: str
    captured_utc: str
    optics: tuple[tuple[str, object], ...]
    heights_mm: tuple[float, float] | None

    def is_of(self, other: "Calibration") -> bool:
        """Whether it is of the same camera, with the same optics as far as both state them."""
        mine, others = dict(self.optics), dict(other.optics)
        return self.serial == other.serial and all(
            mine[key] == others[key] for key in mine.keys() & others.keys()
        )

    def is_at_heights_of(self, other: "Calibration") -> bool:
        """Whether both were calibrated at the same heights, as far as both state them."""
        if self.heights_mm is None or other.heights_mm is None:
            return True
        pairs = zip(self.heights_mm, other.heights_mm, strict=True)
        return all(abs(mine - others) <= SAME_HEIGHT * mine for mine, others in pairs)


def calibration_of(session: Path) -> Calibration | None:
    """The calibration in a session's results; None if there is none that names its camera."""
    path = session / RESULTS_FOLDER / FILES["calibrate"].document
    try:
        if path.parent.is_symlink() or path.is_symlink():
            return None
        state = path.stat()
    except OSError:
        return None
    return _read(path, session.name, state.st_mtime_ns, state.st_size)


def _earlier_calibration(sessions: Path, session: Path) -> Calibration | None:
    """Find the newest calibration before that of a session, of the same camera and optics.

    One at the same heights goes before newer ones at others.
    """
    own = calibration_of(session)
    if own is None:
        return None
    others = (
        calibration_of(path)
        for path in sessions.iterdir()
        if path != session and path.is_dir() and not path.is_symlink()
    )
    earlier = [o for o in others if o and o.is_of(own) and o.captured_utc < own.captured_utc]
    return max(
        earlier, key=lambda each: (each.is_at_heights_of(own), each.captured_utc), default=None
    )


def _lens_sentence(
    document: Mapping[str, Any], earlier: Calibration, now: Calibration | None
) -> str:
    """Say what `standoff compare` found, which printed the document, in one sentence."""
    since = f"{earlier.session} ({earlier.captured_utc[:10]})"
    verdict = str(document["verdict"])
    if document["shared_inputs"]:
        return f"Against {since}: {verdict}."
    if document["is_changed"]:
        what = verdict.removeprefix(CHANGED)
        if now is not None and not now.is_at_heights_of(earlier):
            return (
                f"Not the same as {since}: {what}. But that calibration was at "
                f"{_range_text(earlier)} and this one at {_range_text(now)}, where the same lens "
                "focuses differently: calibrate at the same heights to tell whether it has moved."
            )
        return f"The lens has moved, or its focus has changed, since {since}: {what}."
    return f"The lens has not moved since {since}, as far as this shows: {verdict}."


def _range_text(calibration: Calibration) -> str:
    low_mm, high_mm = calibration.heights_mm or (0.0, 0.0)
    return f"{low_mm:g} mm" if low_mm == high_mm else f"{low_mm:g} to {high_mm:g} mm"


def _heights_of(document: Mapping[str, Any]) -> tuple[float, float] | None:
    edges = document.get("edges")
    stated = (
        [e.get("height_mm") for e in edges if isinstance(e, dict)]
        if isinstance(edges, list)
        else []
    )
    heights_mm = [float(h) for h in stated if isinstance(h, int | float) and isfinite(h)]
    return (min(heights_mm), max(heights_mm)) if heights_mm else None


@lru_cache(maxsize=1024)
def _read(path: Path, session: str, _changed_ns: int, _bytes: int) -> Calibration | None:
    document = read_document(path)
    camera, photograph = document.get("camera"), document.get("photograph")
    serial = camera.get("serial") if isinstance(camera, dict) else None
    captured_utc = document.get("captured_utc")
    if not (isinstance(serial, str) and serial and isinstance(captured_utc, str)):
        return None
    stated = photograph if isinstance(photograph, dict) else {}
    return Calibration(
        path=path,
        session=session,
        serial=serial,
        captured_utc=captured_utc,
        optics=tuple((key, stated[key]) for key in OPTICS if key in stated),
        heights_mm=_heights_of(document),
    )


ResultState = Literal["idle", "running", "done", "stopped", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultRequest:
    """A result to be computed; ``is_replacing`` says that an earlier one may be overwritten.

    A pose or changes are judged of the ``followup``'s record against the ``reference``: path of its
    file, and what to call it; a PSF of both is that of two distances, the reference the nearer. An
    export has a ``file_format``.
    """

    session: Path
    kind: ResultKind
    is_replacing: bool = False
    file_format: ExportFormat = "ome-tiff"
    reference: tuple[Path, str] | None = None
    followup: CaptureRecord | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultProgress:
    """The result that is being computed, or the last one; ``message`` says how it ended.

    ``number`` counts the results since the console began, ``begun_s`` is on the monotonic clock.
    ``is_alarming`` says that the message calls for a look at the bench, ``page`` is the name of the
    page of two captures' comparison.
    """

    number: int = 0
    begun_s: float = 0.0

    session: str = ""
    kind: str = ""
    title: str = ""
    state: ResultState = "idle"
    progress: CommandProgress = field(default_factory=lambda: CommandProgress(text=""))
    message: str = ""
    is_alarming: bool = False
    page: str = ""


class ResultJobs:
    """Computes one result at a time; ``view`` shows its progress, or how the last one ended.

    Earlier calibrations are looked for among the sessions. ``curve_words`` are the options of
    ``standoff pose`` that name the curve, none if there is none; ``run`` is replaced in tests.
    """

    def __init__(
        self,
        sessions: Path,
        curve_words: Sequence[str] = (),
        *,
        run: Callable[..., Any] = run_command,
    ) -> None:
        self._sessions = sessions
        self._curve_words = tuple(curve_words)
        self._run = run
        self._lock = Lock()
        self.view = ResultProgress()

    @property
    def has_curves(self) -> bool:
        """Whether poses can be judged."""
        return bool(self._curve_words)

    def judge_by(self, curve_words: Sequence[str]) -> None:
        """Judge poses by what these options name from now on; by nothing if there are none."""
        self._curve_words = tuple(curve_words)

    def refuse_impossible(self, request: ResultRequest) -> None:
        """Check that the session has what a result needs."""
        lack = missing_for(Session(request.session), has_curves=self.has_curves)[request.kind]
        if lack:
            raise ApplicationError(lack)
        if request.kind in ("pose", "changes") and None in (request.reference, request.followup):
            raise ApplicationError("Choose the two captures to compare.")
        if request.reference is not None and request.reference[0] == _followup_file(request):
            raise ApplicationError("Choose two captures: this would compare one with itself.")

    def name_of(self, request: ResultRequest) -> str:
        """Name of the job."""
        return f"{TITLES[request.kind][2]} {request.session.name}"

    def work(self, job: Job, request: ResultRequest) -> None:
        """Compute a result; after a calibration also whether the lens has moved."""

        def compute() -> str:
            _refuse_links(request.session)
            make_folder(request.session / RESULTS_FOLDER)
            return self._compute(job, request)

        self._show_through(self.name_of(request), request.session, request.kind, compute)

    def work_through(self, job: Job, requests: Sequence[ResultRequest]) -> None:
        """Compute results one after the other, and say what each one gave; one may fail."""
        title = f"{TITLES[requests[0].kind][2]} {len(requests)} photographs"

        def compute() -> str:
            told: list[str] = []
            failed = 0
            for number, request in enumerate(requests, start=1):
                assert request.followup is not None
                self._show(
                    title=f"{title}: {number} of {len(requests)}", session=request.session.name
                )
                try:
                    _refuse_links(request.session)
                    make_folder(request.session / RESULTS_FOLDER)
                    said = self._compute(job, request)
                except OperatorStopError:
                    raise
                except REPORTED_ERRORS as error:
                    said, failed = str(error), failed + 1
                told.append(f"{request.followup.target} of {request.session.name}: {said}")
            self._show(page="")  # each is on the page of its session
            if failed == len(requests):
                raise ApplicationError("; ".join(told))
            return "; ".join(told)

        self._show_through(title, requests[0].session, requests[0].kind, compute)

    def import_photographs(self, job: Job, inbox: PhotographInbox, request: ImportRequest) -> None:
        """Make a session of photographs that have arrived."""

        def run(words: Sequence[str], job: Job) -> object:
            return self._run(words, check=job.check, tell=self._tell)

        self._show_through(
            f"importing photographs into {request.session.name}",
            request.session,
            "import",
            lambda: import_arrived(inbox, request, job, run),
        )

    def _show_through(
        self, title: str, session: Path, kind: str, compute: Callable[[], str]
    ) -> None:
        """Do the work of a job, and show how it goes on and ends."""
        self.view = ResultProgress(
            number=self.view.number + 1,
            begun_s=time.monotonic(),
            session=session.name,
            kind=kind,
            title=title,
            state="running",
        )
        try:
            message = compute()
        except OperatorStopError:
            self._show(state="stopped", message="Cancelled.")
            raise
        except REPORTED_ERRORS as error:
            self._show(state="failed", message=str(error))
            raise
        self._show(state="done", message=message)

    def _compute(self, job: Job, request: ResultRequest) -> str:
        if request.kind == "compare":
            return self._compare(job, request.session)
        words = self._words(request)
        kept = self._kept(request)
        if kept is not None and request.kind == "verify":
            kept.unlink(missing_ok=True)  # if it fails now, what was right earlier does not stay
        document = self._run(words, check=job.check, tell=self._tell)
        if kept is not None:
            write_file(kept, json.dumps(document, allow_nan=False).encode("utf-8"))
        if request.kind in ("pose", "changes"):
            return self._compared(request)
        if request.kind != "calibrate":
            return ""
        (request.session / RESULTS_FOLDER / FILES["compare"].document).unlink(missing_ok=True)
        self._tell(CommandProgress(text="comparing with the last calibration of this camera"))
        return self._compare(job, request.session)

    def _compared(self, request: ResultRequest) -> str:
        """What was found of a pair, in its line of figures; its page can be opened."""
        files = self._pair(request)
        results = request.session / RESULTS_FOLDER
        if (results / files.page).is_file():
            self._show(page=files.page)
        told = key_figures(request.kind, results / files.document)
        return "" if told is None else told.text

    def _kept(self, request: ResultRequest) -> Path | None:
        """Where the document goes that a command prints and does not write."""
        results = request.session / RESULTS_FOLDER
        if request.kind == "pose":
            return results / self._pair(request).document
        return results / FILES["verify"].document if request.kind == "verify" else None

    def _compare(self, job: Job, session: Path) -> str:
        """Compare a calibration with the last one of its camera, and keep what was found."""
        earlier = _earlier_calibration(self._sessions, session)
        if earlier is None:
            return (
                "There is no earlier calibration of this camera and lens among the sessions, so "
                "it is not known whether the lens has moved."
            )
        psf = session / RESULTS_FOLDER / FILES["calibrate"].document
        words = ("compare", "--", str(earlier.path), str(psf))
        document = self._run(words, check=job.check, tell=self._tell)
        if not isinstance(document, dict):
            raise ApplicationError("standoff compare printed no result")
        own = calibration_of(session)
        sentence = _lens_sentence(document, earlier, own)
        is_telling = own is None or own.is_at_heights_of(earlier)
        self._show(is_alarming=is_telling and bool(document["is_changed"]))
        kept = document | {"earlier_session": earlier.session, "sentence": sentence}
        write_file(
            session / RESULTS_FOLDER / FILES["compare"].document,
            json.dumps(kept, allow_nan=False, indent=1).encode("utf-8"),
        )
        return sentence

    def _words(self, request: ResultRequest) -> list[str]:
        """The command line, without the program."""
        session, force = request.session, ["--force"] * request.is_replacing
        results = session / RESULTS_FOLDER
        match request.kind:
            case "calibrate" if request.reference is not None or not _has_edges(session):
                out = results / FILES["calibrate"].document
                return ["calibrate", *force, f"--out={out}", *_blind_words(request)]
            case "verify":
                return ["verify", "--", str(session)]
            case "export":
                out = results / EXPORTS[request.file_format]
                of = f"--format={request.file_format}"
                return ["export", *force, of, f"--out={out}", "--", str(session)]
            case "calibrate" | "geometry" | "noise" as kind:
                files = FILES[kind]
                return [
                    kind,
                    *force,
                    f"--session={session}",
                    f"--out={results / files.document}",
                    f"--report={results / files.page}",
                ]
            case "validate":
                return [
                    "validate",
                    *force,
                    f"--session={session}",
                    f"--psf={results / FILES['calibrate'].document}",
                    f"--out={(results / FILES['validate'].document).parent}",
                ]
            case "report":
                out = results / FILES["report"].page
                return ["report", *force, f"--out={out}", "--", str(session)]
        return self._pair_words(request, results, force)

    def _pair_words(self, request: ResultRequest, results: Path, force: list[str]) -> list[str]:
        assert request.reference is not None
        assert request.followup is not None
        files = self._pair(request)
        make_folder((results / files.document).parent)
        psf = results / FILES["calibrate"].document
        camera = [f"--psf={psf}"] if psf.is_file() else []
        photographs = ["--", str(request.reference[0]), str(_followup_file(request))]
        if request.kind == "pose":
            picture = f"--picture={results / files.page}"
            return ["pose", *force, *self._curve_words, *camera, picture, *photographs]
        out = f"--out={(results / files.document).parent}"
        return ["changes", *force, *camera, out, *photographs]

    def _pair(self, request: ResultRequest) -> ResultFiles:
        assert request.reference is not None
        assert request.followup is not None
        name = f"{request.followup.index} against {request.reference[1]}"
        safe = "".join(c if c.isalnum() or c in " ._-" else "-" for c in name)
        return pair_files(request.kind, safe[:150])

    def _tell(self, progress: CommandProgress) -> None:
        self._show(progress=progress)

    def _show(self, **changes: object) -> None:
        with self._lock:
            self.view = replace(self.view, **changes)  # type: ignore[arg-type]  # names and types are ResultProgress's


def _has_edges(session: Path) -> bool:
    return any(record.kind == "edge" for record in Session(session).records)


def _blind_words(request: ResultRequest) -> list[str]:
    """What to measure the PSF on without an edge target: a scene at two distances, else scenes."""
    if request.reference is not None:
        files = [str(request.reference[0]), str(_followup_file(request))]
        return ["--method=two-distance", "--", *files]
    opened = Session(request.session)
    scenes = [record for record in opened.records if record.kind in TEXTURED]
    if heights_of(scenes, TEXTURED) > 1:
        return ["--method=two-distance", f"--session={request.session}"]
    files = [str(photograph_file(request.session, record)) for record in scenes]
    return ["--method=single-image", "--", *files]


def _refuse_links(session: Path) -> None:
    """Check that results are written into the session, and not where a link in it leads."""
    results = session / RESULTS_FOLDER
    for folder in (results, *(results / name for name in ("pose", "changes", "validation"))):
        if folder.is_symlink():
            raise ApplicationError(f"{folder} is a link, which is not followed: remove it")


def _followup_file(request: ResultRequest) -> Path:
    """Path of the follow-up's file."""
    assert request.followup is not None
    return photograph_file(request.session, request.followup)
