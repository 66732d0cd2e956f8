"""Blocking work in a thread, as Bluesky waits for it."""

from collections.abc import Callable
from threading import Event, Lock, Thread


class WorkStatus:
    """Runs a blocking call in a thread of its own; Bluesky's protocol ``Status``.

    Parameters
    ----------
    work
        Done once; an exception it raises is the status's.
    name
        Of the thread.
    """

    def __init__(self, work: Callable[[], object], name: str) -> None:
        self._work = work
        self._error: BaseException | None = None
        self._is_over = Event()
        self._callbacks: list[Callable[[WorkStatus], None]] = []
        self._lock = Lock()
        Thread(target=self._run, name=name, daemon=True).start()

    @property
    def done(self) -> bool:
        """Whether the work has ended, well or not."""
        return self._is_over.is_set()

    @property
    def success(self) -> bool:
        """Whether it has ended without an error."""
        return self.done and self._error is None

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Return the error of the work, None if it went well.

        Raises
        ------
        TimeoutError
            If it has not ended within ``timeout`` seconds; None waits for ever.
        """
        if not self._is_over.wait(timeout):
            raise TimeoutError(f"not done within {timeout} s")
        return self._error

    def add_callback(self, callback: Callable[["WorkStatus"], None]) -> None:
        """Call this with the status once the work has ended, at once if it has."""
        with self._lock:
            if not self.done:
                self._callbacks.append(callback)
                return
        callback(self)

    def _run(self) -> None:
        try:
            self._work()
        except BaseException as error:  # noqa: BLE001  # whoever waits raises it
            self._error = error
        with self._lock:
            self._is_over.set()
        for callback in self._callbacks:
            callback(self)
