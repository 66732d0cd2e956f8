"""Executes the commands that concern sessions, their results, and who is in control."""

from dataclasses import replace
from typing import Annotated, Any

from pydantic import Field

from acquisition.choices import CaptureKind, ExportFormat
from acquisition.session import CaptureRecord, Session, SessionNotes
from standoff.console.bench_hub import ConsoleHub
from standoff.console.photographs import ImportRequest, photograph_file
from standoff.console.result_jobs import ResultRequest
from standoff.console.results import ResultKind
from standoff.console.web._messages import (
    Finite,
    Index,
    Name,
    PageMessage,
    Person,
    Reason,
    Stop,
    command,
    commands_of,
)
from standoff.errors import ApplicationError
from standoff.library import login_name

Document = dict[str, Any]
MOST_IMPORTED = 50
"""Photographs of one message, each named by its hash."""

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Photographs = Annotated[list[Sha256], Field(min_length=1, max_length=MOST_IMPORTED)]
MOST_COMPARED = 20
"""Later photographs that are compared with an earlier one at a time."""

Sessions = Annotated[list[Name], Field(min_length=2, max_length=MOST_COMPARED)]
Captures = Annotated[list[Index], Field(min_length=2, max_length=MOST_COMPARED)]


class NotInControlError(ApplicationError):
    """Somebody else is in control; nothing was done."""


class SessionCommands:
    """Executes the messages of the pages of a console, one after the other; no bench is needed."""

    def __init__(self, hub: ConsoleHub) -> None:
        self._hub = hub
        self._commands = commands_of(type(self))

    def carry_out(self, viewer: str, message: PageMessage) -> Document | None:
        """Execute a message; return what to send to that page alone, if anything.

        What cannot be executed raises an error that says why.
        """
        if isinstance(message, Stop):
            self._hub.stop()
            return None
        asked = self._commands.get(message.do)
        needs_control = asked is None or asked.needs_control
        if needs_control and not self._hub.control.is_holder(viewer):
            raise NotInControlError("You are not in control: take control first.")
        if asked is None:
            raise ApplicationError("This console has no bench: start it with --bench.")
        page = {"viewer": viewer} if asked.wants_viewer else {}
        return asked.execute(self, **page, **message.arguments)

    @command("take", needs_control=False)
    def _take(self, viewer: str, name: Person = "") -> None:
        """Take control, or ask for it; ``name`` is the operator's, for the journal."""
        self._hub.control.join(viewer, name.strip() or login_name())
        self._hub.control.take(viewer)

    @command("release", needs_control=False)
    def _release(self, viewer: str) -> None:
        """Give up control."""
        self._hub.control.release(viewer)

    @command("grant", needs_control=False)
    def _grant(self, viewer: str) -> None:
        """Hand control to who asks for it."""
        self._hub.control.grant(viewer)

    @command("refuse", needs_control=False)
    def _refuse(self, viewer: str) -> None:
        """Keep control, or ask for it no more."""
        self._hub.control.refuse(viewer)

    @command("result")
    def _compute_result(
        self,
        session: Name,
        result: ResultKind,
        is_replacing: bool = False,
        reference_session: Name | None = None,
        reference: Index | None = None,
        followup: Index | None = None,
    ) -> None:
        """Compute a result of a session; a pose or changes compare two captures.

        The PSF can be that of two captures of one scene, the reference being the nearer.
        """
        opened = self._hub.sessions.open(session)
        request = ResultRequest(session=opened.path, kind=result, is_replacing=is_replacing)
        if result in ("pose", "changes") or (result == "calibrate" and followup is not None):
            request = self._of_pair(request, reference_session or session, reference, followup)
        self._begin_result(request)

    def _of_pair(
        self, request: ResultRequest, earlier: str, reference: int | None, followup: int | None
    ) -> ResultRequest:
        """The request for a capture of its session against one of another, or of its own."""
        opened, other = (
            self._hub.sessions.open(request.session.name),
            self._hub.sessions.open(earlier),
        )
        record = used_record(other, reference)
        name = f"{record.index}" if other.path == opened.path else f"{record.index} of {earlier}"
        return replace(
            request,
            reference=(photograph_file(other.path, record), name),
            followup=used_record(opened, followup),
        )

    @command("changes-of-several")
    def _compare_several(
        self,
        reference_session: Name,
        reference: Index,
        sessions: Sessions,
        followups: Captures,
        is_replacing: bool = False,
    ) -> None:
        """Find the changes of several photographs against one, one after the other.

        The number of ``followups`` is that of ``sessions``: each is a capture of its session.
        """
        hub = self._hub
        if len(sessions) != len(followups):
            raise ApplicationError("Choose the photographs again: some were not named.")
        requests = [
            self._of_pair(
                ResultRequest(
                    session=hub.sessions.open(session).path,
                    kind="changes",
                    is_replacing=is_replacing,
                ),
                reference_session,
                reference,
                followup,
            )
            for session, followup in zip(sessions, followups, strict=True)
        ]
        for request in requests:
            hub.results.refuse_impossible(request)
        name = f"finding changes in {len(requests)} photographs"
        hub.jobs.begin(name, lambda job: hub.results.work_through(job, requests))

    @command("export")
    def _export(self, session: Name, file_format: ExportFormat, is_replacing: bool = False) -> None:
        """Export a session into one file, which can be fetched."""
        path = self._hub.sessions.path_of(session)
        self._begin_result(
            ResultRequest(
                session=path, kind="export", is_replacing=is_replacing, file_format=file_format
            )
        )

    def _begin_result(self, request: ResultRequest) -> None:
        hub = self._hub
        hub.results.refuse_impossible(request)
        hub.jobs.begin(hub.results.name_of(request), lambda job: hub.results.work(job, request))

    @command("import")
    def _import(
        self, session: Name, photographs: Photographs, kind: CaptureKind, height_mm: Finite = 0.0
    ) -> None:
        """Make a session of photographs that have arrived, named by their hashes."""
        hub = self._hub
        path = hub.sessions.path_for(session)
        if path.exists():
            raise ApplicationError(f"There is already a session {session!r}: choose another name.")
        request = ImportRequest(
            session=path,
            photographs=tuple(hub.photographs.named(tuple(dict.fromkeys(photographs)))),
            kind=kind,
            height_mm=height_mm,
            operator=hub.operator,
        )
        hub.jobs.begin(
            f"importing photographs into {session}",
            lambda job: hub.results.import_photographs(job, hub.photographs, request),
        )

    @command("discard")
    def _discard(self, sha256: Sha256) -> Document:
        """Throw a photograph away that has arrived."""
        self._hub.photographs.discard(sha256)
        return {"type": "changed"}

    @command("cancel-result")
    def _cancel_result(self) -> None:
        """Cancel the result that is being computed."""
        job = self._hub.jobs.current
        if job is not None and self._hub.results.view.state == "running":
            job.ask_stop()

    @command("exclude")
    def _exclude(self, session: Name, index: Index, reason: Reason) -> Document:
        """Keep a capture out of calibration and analysis."""
        if not reason.strip():
            raise ApplicationError("Say why the capture is excluded.")
        self._notes(session).exclude(index, reason.strip())
        return {"type": "changed"}

    @command("include")
    def _include(self, session: Name, index: Index, reason: Reason = "") -> Document:
        """Use an excluded capture again."""
        self._notes(session).include(index, reason.strip())
        return {"type": "changed"}

    @command("note")
    def _write_note(self, session: Name, text: Reason) -> Document:
        """Add a note to a session's journal."""
        if not text.strip():
            raise ApplicationError("A note must not be empty.")
        self._notes(session).note(text.strip())
        return {"type": "changed"}

    @command("set-height")
    def _correct_height(
        self, session: Name, height_mm: Finite, reason: Reason, index: Index | None = None
    ) -> Document:
        """Correct the height of one imported photograph, or of all of a session."""
        if not reason.strip():
            raise ApplicationError("Say why the height is corrected.")
        records = self._hub.sessions.open(session).records
        indices = [record.index for record in records] if index is None else [index]
        self._notes(session).correct_height(indices, height_mm, reason.strip())
        return {"type": "changed"}

    def _notes(self, name: str) -> SessionNotes:
        """The journal of a session that is not running."""
        self._refuse_running(name)
        return SessionNotes(self._hub.sessions.path_of(name), operator=self._hub.operator)

    def _refuse_running(self, name: str) -> None:
        """Refuse to write into a session that is being captured; without a bench none is."""


def used_record(session: Session, index: int | None) -> CaptureRecord:
    """Find a capture that is neither superseded nor excluded."""
    record = next((r for r in session.records if r.index == index), None)
    if record is None:
        raise ApplicationError(f"{session.path.name} has no capture {index} to use.")
    return record
