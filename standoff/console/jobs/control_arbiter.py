"""Who is in control: one viewer at a time, while the others watch; taking over is explicit."""

from dataclasses import dataclass
from threading import Lock


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlView:
    """Control as one viewer sees it.

    ``holder`` is a name, empty if nobody is in control; ``is_away`` says that the holder's
    page is not connected at the moment.
    """

    is_mine: bool
    holder: str
    is_away: bool
    viewers: int


class ControlArbiter:
    """Knows who is connected and who is in control; a lost page keeps its control."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._present: dict[str, str] = {}
        self._holder: str | None = None
        self._holder_name = ""

    def join(self, viewer: str, name: str) -> None:
        """Connect a page; it gets control if nobody has it."""
        with self._lock:
            self._present[viewer] = name
            if self._holder is None:
                self._hold(viewer)

    def leave(self, viewer: str) -> None:
        """Disconnect a page; it keeps control until somebody takes over."""
        with self._lock:
            self._present.pop(viewer, None)

    def take(self, viewer: str) -> None:
        """Take control from whoever has it."""
        with self._lock:
            if viewer in self._present:
                self._hold(viewer)

    def release(self, viewer: str) -> None:
        """Give up control; then nobody has it."""
        with self._lock:
            if self._holder == viewer:
                self._holder, self._holder_name = None, ""

    def is_holder(self, viewer: str) -> bool:
        """Whether this page is in control."""
        return self._holder == viewer

    def operator(self) -> str:
        """Name of whoever is in control; empty if nobody is."""
        return self._holder_name

    def view(self, viewer: str) -> ControlView:
        """Control as a page sees it."""
        with self._lock:
            return ControlView(
                is_mine=self._holder == viewer,
                holder=self._holder_name,
                is_away=self._holder is not None and self._holder not in self._present,
                viewers=len(self._present),
            )

    def _hold(self, viewer: str) -> None:
        self._holder, self._holder_name = viewer, self._present[viewer]
