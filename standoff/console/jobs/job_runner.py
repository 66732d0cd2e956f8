"""One job at a time at the bench, and a stop that ends it from any thread."""

from collections.abc import Callable
from threading import Event, Lock, Thread

from acquisition.errors import OperatorStopError
from standoff.errors import REPORTED_ERRORS, ApplicationError


class BusyError(ApplicationError):
    """Another job is running on the bench; ``job`` is its name."""

    def __init__(self, job: str, text: str = "") -> None:
        super().__init__(text or f"Busy: {job} is still running. Wait, or stop it.")
        self.job = job


class Job:
    """One job: its name, whether it has been told to stop, and whether it has ended."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.ended = Event()
        self._is_stop_wanted = Event()

    @property
    def is_stopping(self) -> bool:
        """Whether it has been told to stop."""
        return self._is_stop_wanted.is_set()

    def ask_stop(self) -> None:
        """Make the next `check` raise."""
        self._is_stop_wanted.set()

    def check(self) -> None:
        """Raise if the job has been told to stop.

        Raises
        ------
        OperatorStopError
            If so.
        """
        if self._is_stop_wanted.is_set():
            raise OperatorStopError("stopped by the operator")


class JobRunner:
    """Runs each job in its own thread, never two at once.

    Parameters
    ----------
    report
        Called with one line when a job stops or fails.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._lock = Lock()
        self._job: Job | None = None

    @property
    def current(self) -> Job | None:
        """The job that is running, if any."""
        job = self._job
        return None if job is None or job.ended.is_set() else job

    def begin(self, name: str, work: Callable[[Job], None]) -> Job:
        """Start a job.

        Raises
        ------
        BusyError
            If another one is running.
        """
        with self._lock:
            busy = self.current
            if busy is not None:
                raise BusyError(busy.name)
            job = Job(name)
            self._job = job
        Thread(target=self._run, args=(job, work), name=name, daemon=True).start()
        return job

    def _run(self, job: Job, work: Callable[[Job], None]) -> None:
        try:
            work(job)
        except OperatorStopError:
            self._report(f"Stopped: {job.name}.")
        except REPORTED_ERRORS as error:
            self._report(f"{job.name[:1].upper()}{job.name[1:]} failed: {error}")
        except BaseException:
            self._report(f"{job.name[:1].upper()}{job.name[1:]} crashed; see the terminal.")
            raise
        finally:
            job.ended.set()
