"""Computes a session's results, each by the command that an operator would type."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Lock
from typing import Literal

from acquisition.errors import OperatorStopError
from acquisition.session import CaptureRecord, Session
from standoff.console.jobs import Job
from standoff.console.results.command_process import (
    CommandProgress,
    CommandResult,
    run_command,
)
from standoff.console.results.lens_comparison import (
    calibration_of,
    earlier_calibration,
    lens_sentence,
)
from standoff.console.results.result_kinds import (
    FILES,
    TITLES,
    ResultFiles,
    ResultKind,
    missing_for,
    pair_files,
)
from standoff.errors import REPORTED_ERRORS, ApplicationError
from standoff.library import RESULTS_FOLDER, make_folder, write_file

ResultState = Literal["idle", "running", "done", "stopped", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultRequest:
    """A result to be computed.

    Parameters
    ----------
    session
        Folder of the session.
    kind
        The result.
    is_replacing
        Whether an earlier one may be overwritten.
    reference
        Capture that a pose or changes are judged against: path of its file, and what to call it.
    followup
        Record of the capture that is judged.
    """

    session: Path
    kind: ResultKind
    is_replacing: bool = False
    reference: tuple[Path, str] | None = None
    followup: CaptureRecord | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultProgress:
    """The result that is being computed, or the last one; ``message`` says how it ended.

    ``number`` counts the results since the console began, ``begun_s`` is on the monotonic clock.
    ``is_alarming`` says that the message calls for a look at the bench.
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
    remarks: tuple[str, ...] = ()


class ResultJobs:
    """Computes one result at a time; `view` shows its progress.

    Parameters
    ----------
    sessions
        Folder of the sessions, where earlier calibrations are looked for.
    curve_words
        Options of ``standoff pose`` that name the curve; empty if there is none.
    run
        Runs a command; replaced in tests.
    """

    def __init__(
        self,
        sessions: Path,
        curve_words: Sequence[str] = (),
        *,
        run: Callable[..., CommandResult] = run_command,
    ) -> None:
        self._sessions = sessions
        self._curve_words = tuple(curve_words)
        self._run = run
        self._lock = Lock()
        self._view = ResultProgress()

    @property
    def view(self) -> ResultProgress:
        """Progress of the result."""
        return self._view

    @property
    def has_curves(self) -> bool:
        """Whether poses can be judged."""
        return bool(self._curve_words)

    def judge_by(self, curve_words: Sequence[str]) -> None:
        """Judge poses by what these options name from now on; by nothing if there are none."""
        self._curve_words = tuple(curve_words)

    def refuse_impossible(self, request: ResultRequest) -> None:
        """Check that the session has what a result needs.

        Raises
        ------
        ApplicationError
            If not; it says what is missing.
        SessionError
            If the session cannot be read.
        """
        lack = missing_for(Session(request.session), has_curves=self.has_curves)[request.kind]
        if lack:
            raise ApplicationError(lack)
        if request.kind in ("pose", "changes") and None in (request.reference, request.followup):
            raise ApplicationError("Choose the two captures to compare.")
        if request.reference is not None and request.reference[0] == session_file(request):
            raise ApplicationError("Choose two captures: this would compare one with itself.")

    def name_of(self, request: ResultRequest) -> str:
        """Name of the job."""
        return f"{TITLES[request.kind][2]} {request.session.name}"

    def work(self, job: Job, request: ResultRequest) -> None:
        """Compute a result; after a calibration also whether the lens has moved.

        Raises
        ------
        ApplicationError, OperatorStopError
            If it fails or is stopped; `view` says so, too.
        """
        self._view = ResultProgress(
            number=self._view.number + 1,
            begun_s=time.monotonic(),
            session=request.session.name,
            kind=request.kind,
            title=self.name_of(request),
            state="running",
        )
        try:
            _refuse_links(request.session)
            make_folder(request.session / RESULTS_FOLDER)
            message = self._compute(job, request)
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
        done = self._run(words, check=job.check, tell=self._tell)
        self._show(remarks=done.remarks)
        if request.kind == "pose":
            path = request.session / RESULTS_FOLDER / self._pair(request).document
            write_file(path, json.dumps(done.document, allow_nan=False).encode("utf-8"))
        if request.kind != "calibrate":
            return ""
        (request.session / RESULTS_FOLDER / FILES["compare"].document).unlink(missing_ok=True)
        self._tell(CommandProgress(text="comparing with the last calibration of this camera"))
        return self._compare(job, request.session)

    def _compare(self, job: Job, session: Path) -> str:
        """Compare a calibration with the last one of its camera, and keep what was found."""
        earlier = earlier_calibration(self._sessions, session)
        if earlier is None:
            return (
                "There is no earlier calibration of this camera and lens among the sessions, so "
                "nothing says whether the lens has moved."
            )
        psf = session / RESULTS_FOLDER / FILES["calibrate"].document
        words = ("compare", "--", str(earlier.path), str(psf))
        document = self._run(words, check=job.check, tell=self._tell).document
        if not isinstance(document, dict):
            raise ApplicationError("standoff compare printed no result")
        own = calibration_of(session)
        sentence = lens_sentence(document, earlier, own)
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
        photographs = ["--", str(request.reference[0]), str(session_file(request))]
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
            self._view = replace(self._view, **changes)  # type: ignore[arg-type]  # names and types are ResultProgress's


def _refuse_links(session: Path) -> None:
    """Check that results are written into the session, and not where a link in it leads."""
    results = session / RESULTS_FOLDER
    for folder in (results, *(results / name for name in ("pose", "changes", "validation"))):
        if folder.is_symlink():
            raise ApplicationError(f"{folder} is a link, which is not followed: remove it")


def session_file(request: ResultRequest) -> Path:
    """Path of the follow-up's file."""
    assert request.followup is not None
    return request.session / request.followup.file
