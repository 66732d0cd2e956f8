"""Commands about sessions that are on the disk: results, and captures that do not count."""

from collections.abc import Callable
from typing import Any

from acquisition.session import CaptureRecord, Session, SessionNotes
from standoff.console.bench_hub import BenchHub
from standoff.console.jobs import BusyError, Job
from standoff.console.results import ResultRequest
from standoff.console.web import messages
from standoff.errors import ApplicationError

SessionCommand = Callable[[Any], dict[str, Any] | None]


class SessionCommands:
    """Executes the messages about sessions.

    Parameters
    ----------
    hub
        The bench.
    """

    def __init__(self, hub: BenchHub) -> None:
        self._hub = hub

    def by_message(self) -> dict[type[Any], SessionCommand]:
        """The command of each kind of message."""
        return {
            messages.ComputeResult: self._compute,
            messages.CancelResult: self._cancel,
            messages.Exclude: self._exclude,
            messages.Include: self._include,
        }

    def _compute(self, message: messages.ComputeResult) -> None:
        hub = self._hub
        session = hub.sessions.open(message.session)
        request = ResultRequest(
            session=session.path,
            kind=message.result,
            is_replacing=message.is_replacing,
        )
        if message.result in ("pose", "changes"):
            request = self._of_a_pair(message, session)
        hub.results.refuse_impossible(request)

        def work(job: Job) -> None:
            hub.results.work(job, request)

        hub.jobs.begin(hub.results.name_of(request), work)

    def _of_a_pair(self, message: messages.ComputeResult, session: Session) -> ResultRequest:
        other = message.reference_session or message.session
        reference = self._hub.sessions.open(other)
        earlier = _used(reference, message.reference)
        name = f"{earlier.index}"
        if other != message.session:
            name += f" of {other}"
        return ResultRequest(
            session=session.path,
            kind=message.result,
            is_replacing=message.is_replacing,
            reference=(reference.path / earlier.file, name),
            followup=_used(session, message.followup),
        )

    def _cancel(self, _: messages.CancelResult) -> None:
        job = self._hub.jobs.current
        if job is not None and self._hub.results.view.state == "running":
            job.ask_stop()

    def _exclude(self, message: messages.Exclude) -> dict[str, Any]:
        reason = message.reason.strip()
        if not reason:
            raise ApplicationError("Say why the capture is excluded.")
        self._notes(message.session).exclude(message.index, reason)
        return {"type": "changed"}

    def _include(self, message: messages.Include) -> dict[str, Any]:
        self._notes(message.session).include(message.index, message.reason.strip())
        return {"type": "changed"}

    def _notes(self, name: str) -> SessionNotes:
        """The journal of a session that is not running."""
        hub, path = self._hub, self._hub.sessions.path_of(name)
        job = hub.jobs.current
        if job is not None and hub.run.view.session == name and hub.run.is_under_way:
            raise BusyError(job.name, "The session is running: wait for its end, or stop it.")
        return SessionNotes(path, operator=hub.operator)


def _used(session: Session, index: int | None) -> CaptureRecord:
    """Find a capture that is neither superseded nor excluded."""
    record = next((r for r in session.records if r.index == index), None)
    if record is None:
        raise ApplicationError(f"{session.path.name} has no capture {index} to use.")
    return record
